"""How this room compiles its per-pixel loops."""

from collections.abc import Callable
from typing import Any, cast

import numba

# Sums may be regrouped and contracted; NaN keeps its meaning, the loops mark "nothing here" with it.
# Dividing by zero is no exception but inf or NaN, as in numpy: checks for it would keep loops from using vectors.
OPTIONS: dict[str, Any] = {
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
    "error_model": "numpy",
    "nogil": True,
}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile on first call, keep the machine code on disk: beside the module, or in the user's cache if that is
    read-only. Where nothing can be written the function still works, compiled anew in each process."""
    try:
        return cast(Callable[..., Any], numba.njit(cache=True, **OPTIONS)(function))
    except RuntimeError:  # numba: "no locator available"
        return cast(Callable[..., Any], numba.njit(**OPTIONS)(function))
