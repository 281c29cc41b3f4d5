"""How this room compiles its per-pixel loops."""

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile on first call, keep the machine code on disk: beside the module, or in the user's cache if that is
    read-only. Where nothing can be written the function still works, compiled anew in each process."""
    try:
        return cast(F, numba.njit(cache=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, nogil=True)(function))
    except RuntimeError:  # numba: "no locator available"
        return cast(F, numba.njit(fastmath={"contract", "reassoc", "nsz", "arcp"}, nogil=True)(function))
