"""Two tiers, what a test costs, and no skips under `make test`.

Every promise has one case in the gate, `make test`. Its other sizes, seeds and parameters are `deep`, `make test-deep`:

    @pytest.mark.deep(but=1)             # of a parametrized test the first case stays in the gate; but="id": that one
    @pytest.mark.deep(gate="tests/unit/wall/test_axis.py::test_a_bend_is_named")    # who keeps this promise in the gate
    pytest.param(8.0, marks=pytest.mark.deep)                            # one case of a test that has others

`tests/unit/test_house.py` fails for a deep case that no gate test stands for, and for a file that costs more than its
budget: durations.json, which `make durations` renews. Files that cost most begin first, so that no worker is left with
one while the others have nothing to do.

`stalls` knows whether this machine stood still: a bound in seconds that is a promise holds only where it did not.
"""

import contextlib
import os
import resource
import signal
import threading
import time
from collections import defaultdict, deque
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
import tiers
from hypothesis import settings

ALLOWED = ("../shared", "too busy")  # scenes that only the authors have; a machine that cannot emulate in real time
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

CLOCK_HZ = os.sysconf("SC_CLK_TCK")  # of /proc

COSTS = pytest.StashKey[dict[str, dict[str, float]]]()  # by file, then "gate" or "deep": processor seconds


def _strict(report: pytest.TestReport | pytest.CollectReport) -> None:
    why = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    if "ANNULUS_NO_SKIPS" in os.environ and report.skipped and not any(word in why for word in ALLOWED):
        report.outcome, report.longrepr = "failed", f"make test takes no skips: {why}"


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


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--renew-durations", action="store_true", help="write what each file cost into durations.json")


def pytest_configure(config: pytest.Config) -> None:
    settings.register_profile("unhurried", settings(), deadline=None)  # 0.2 s a draw: the machine may have other work
    settings.load_profile("unhurried")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # begun by a shell with `&`: our children would ignore Ctrl-C
        signal.signal(signal.SIGINT, signal.default_int_handler)
    config.stash[COSTS] = defaultdict(lambda: defaultdict(float))
    config.option.loadscopereorder = False  # xdist's own order: files of few tests last, and those take longest
    if config.getoption("numprocesses", None):  # one process a core: threads would only fight over them
        os.environ.update(ONE_THREAD)


def _tiers_of(expression: str) -> list[str]:
    if "deep or not deep" in expression or "deep" not in expression:
        return ["gate", "deep"]
    return ["gate"] if "not deep" in expression else ["deep"]


@pytest.hookimpl(tryfirst=True)  # before -m and -k look at the marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    tiers.part(items)
    gate = {tiers.file_of(item) for item in items if item.get_closest_marker("deep") is None}
    for name in {tiers.file_of(item) for item in items} - gate:  # a file that left the gate costs it nothing any more
        config.stash[COSTS][name]["gate"] = 0.0
    whole = not any("::" in argument for argument in config.args)
    config.stash[tiers.UNSPOKEN] = tiers.unspoken(items) if whole else []
    costs, ran = tiers.read_durations(), _tiers_of(config.option.markexpr)
    cost = {
        path: sum(costs[path][tier] for tier in ran) if path in costs else 0.0 for path in map(tiers.file_of, items)
    }
    items.sort(key=lambda item: -cost[tiers.file_of(item)])  # files stay whole, and in their order


def _processor_s() -> float:
    """Ours, that of children that ended, and of those that live: an emulator outlives the test that it worked for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used) + _living_s("self")


def _living_s(pid: str) -> float:
    """Of all that descend from a process and have not ended, with what they waited for."""
    seconds = 0.0
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # one that ends just now
            for child in task.read_text().split():
                times = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11:15]
                seconds += sum(map(int, times)) / CLOCK_HZ + _living_s(child)
    return seconds


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    began = _processor_s()
    done = yield
    tier = "deep" if item.get_closest_marker("deep") else "gate"
    item.config.stash[COSTS][tiers.file_of(item)][tier] += _processor_s() - began
    return done


def pytest_sessionfinish(session: pytest.Session) -> None:
    if (output := getattr(session.config, "workeroutput", None)) is not None:  # one of xdist's workers
        output["costs"] = {name: dict(cost) for name, cost in session.config.stash[COSTS].items()}
    elif session.config.getoption("--renew-durations"):
        tiers.renew(session.config.stash[COSTS])


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: object, error: object) -> None:
    output = getattr(node, "workeroutput", {})
    for name, cost in output.get("costs", {}).items():
        for tier, seconds in cost.items():
            node.config.stash[COSTS][name][tier] += seconds  # type: ignore[attr-defined]


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
