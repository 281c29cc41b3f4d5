"""Packages that only some forms need."""

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from annulus.vocabulary import AnnulusError


def is_there(packages: tuple[str, ...]) -> bool:
    return all(find_spec(name) is not None for name in packages)


def load(package: str, extra: str, form: str) -> Any:
    """The package. Raises AnnulusError with the command that adds it."""
    try:
        return import_module(package)
    except ImportError as error:
        raise AnnulusError(
            f"{form} needs {package.partition('.')[0]} ({error}): pip install 'annulus[{extra}]'"
        ) from None
