"""Whoever waits for compiled loops is told.

with telling(print): ...                 # one line, once, where compiling takes longer than a moment
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LINE = "compiling the measuring loops, once: about a minute, longer on a Raspberry Pi"
MOMENT_S = 1.0  # of compiling that nobody needs to be told of: a rare loop, or one more type

_say: Callable[[str], None] | None = None
_announced = False
_depth, _began_s, _spent_s = 0, 0.0, 0.0


@contextmanager
def telling(say: Callable[[str], None]) -> Iterator[None]:
    """Meanwhile `say` is given LINE, once a process, when compiling in this process takes longer than MOMENT_S."""
    global _say
    before, _say = _say, say
    try:
        yield
    finally:
        _say = before


def begins() -> None:
    """A kernel begins to be compiled, perhaps within another's. Called by numeric.jit, under numba's own lock."""
    global _depth, _began_s, _announced
    now = time.monotonic()
    if _depth == 0:
        _began_s = now
    _depth += 1
    if not _announced and _say is not None and _spent_s + now - _began_s > MOMENT_S:
        _announced = True
        _say(LINE)


def ends() -> None:
    global _depth, _spent_s
    _depth -= 1
    if _depth == 0:
        _spent_s += time.monotonic() - _began_s
