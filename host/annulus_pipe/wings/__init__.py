"""Methods beside the rings, each in a folder of its own: one physics, from its files to its pictures and commands.

Found by their folders when the core asks for a hook (`annulus_pipe.hooks`, which says what a wing is to it).
"""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType


@cache
def found() -> tuple[ModuleType, ...]:
    """In the order of their names."""
    return tuple(import_module(f"{__name__}.{one.name}") for one in iter_modules(__path__) if one.ispkg)
