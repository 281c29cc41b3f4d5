"""Methods beside the rings, each in a folder of its own: one physics, from its files to its pictures and commands.

Found by their folders when the core asks for a hook (`annulus_pipe.hooks`, which says what a wing is to it).
"""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType

from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError


@cache
def found() -> tuple[ModuleType, ...]:
    """In the order of their names. Raises AnnulusError, one line, for one that cannot be imported."""
    return tuple(_loaded(one.name) for one in iter_modules(__path__) if one.ispkg)


def _loaded(name: str) -> ModuleType:
    try:
        return import_module(f"{__name__}.{name}")
    except Exception as error:  # a syntax error, a package that is missing
        raise AnnulusError(
            f"wings/{name}: cannot be loaded ({one_line(f'{type(error).__name__}: {error}')})"
        ) from error
