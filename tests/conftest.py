"""Under `make test` a skip is a failure: all that tests need is part of set-up, and what did not run proves nothing.

Files that take longest begin first, so that no worker is left with one while the others have nothing to do: a file says
so by `pytest.mark.slow(seconds=..)`, of processor, roughly. Workers inherit that BLAS has one thread.

`stalls` knows whether this machine stood still: a bound in seconds that is a promise holds only where it did not.
"""

import os
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

ALLOWED = ("../shared", "too busy")  # scenes that only the authors have; a machine that cannot emulate in real time


def _strict(report: pytest.TestReport | pytest.CollectReport) -> None:
    why = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    if "ANNULUS_NO_SKIPS" in os.environ and report.skipped and not any(word in why for word in ALLOWED):
        report.outcome, report.longrepr = "failed", f"make test takes no skips: {why}"


SCENES = Path(__file__).with_name("scenes")  # whole methods: slow, all of them
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    _strict(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    _strict(report)
    return report


def pytest_configure(config: pytest.Config) -> None:
    config.option.loadscopereorder = False  # xdist's own order: files of few tests last, and those take longest
    if config.getoption("numprocesses", None):  # one process a core: threads would only fight over them
        os.environ.update(ONE_THREAD)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    seconds: dict[Path, float] = {}
    for item in items:
        mark = item.get_closest_marker("slow")
        if mark is None and SCENES in item.path.parents:
            item.add_marker("slow")
        told = float(mark.kwargs.get("seconds", 0.0)) if mark else 0.0
        seconds[item.path] = max(told, seconds.get(item.path, 0.0))
    items.sort(key=lambda item: -seconds[item.path])  # files stay whole, and in their order


class Stalls:
    """A thread that wants to go on every 2 ms, and remembers how late it was let."""

    EVERY_S = 0.002

    def __init__(self) -> None:
        self._late: deque[tuple[float, float]] = deque(maxlen=100_000)  # when, and by how many seconds
        self._last, self._over = time.monotonic(), threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._over.wait(self.EVERY_S):
            now = time.monotonic()
            if (late := now - self._last - self.EVERY_S) > self.EVERY_S:
                self._late.append((now, late))
            self._last = now

    def since(self, begun: float) -> float:
        """The longest since then (monotonic), s; one that is still going on counts."""
        now = time.monotonic()
        return max([now - self._last, *(late for when, late in self._late.copy() if when >= begun)])

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@pytest.fixture
def stalls() -> Iterator[Stalls]:
    """For bounds on real time: `if stalls.since(begun) < 0.05: assert took_s < 1.0`."""
    one = Stalls()
    yield one
    one.close()
