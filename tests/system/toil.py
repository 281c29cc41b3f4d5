"""Work that fails as it is told to, for executors. In a module of its own: worker processes import it by its name."""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from annulus_pipe.vocabulary import AnnulusError


class TwoPartError(Exception):
    """One that does not come out of a pickle."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(f"{one} {other}")


@dataclass(frozen=True)
class Toil:
    """Squares numbers. kills, raises : of which numbers; the first `for_times` times that one is tried, counted in
    files of `folder`."""

    folder: Path
    kills: frozenset[int] = frozenset()
    raises: frozenset[int] = frozenset()
    for_times: int = 1 << 30

    def ready(self) -> Callable[[int], int]:
        return self._do

    def _do(self, item: int) -> int:
        with (self.folder / str(item)).open("a+") as file:
            file.write("x")
            times = file.tell()
        if item in self.kills and times <= self.for_times:
            os.kill(os.getpid(), signal.SIGKILL)
        if item in self.raises and times <= self.for_times:
            raise AnnulusError(f"item {item} cannot be done") if item % 2 else TwoPartError("item", f"{item} is a bug")
        return item * item

    def tried(self, item: int) -> int:
        return (self.folder / str(item)).stat().st_size
