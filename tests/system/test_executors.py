"""Promises of local executors: an item that raises or kills costs itself and nothing else, however often it is tried.

Few workers are started here: each takes seconds of processor before it can do anything.
"""

import multiprocessing
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from toil import Toil

from annulus_pipe.reprocess import executors
from annulus_pipe.reprocess.executors import STILLBORN_MOST, Failed, Processes, _Crew, _Hand, in_process
from annulus_pipe.vocabulary import AnnulusError

ITEMS = tuple(range(12))
SQUARES = {n: n * n for n in ITEMS}


@pytest.mark.deep(gate="tests/system/test_executors.py::test_what_raises_here_fails_after_its_tries")
def test_local_workers_do_all_but_what_always_fails(tmp_path: Path) -> None:
    """3 kills once, 5 always; 4 (a bug) and 9 (a known error) always raise."""
    passing, lasting = tmp_path / "passing", tmp_path / "lasting"
    passing.mkdir()
    lasting.mkdir()
    assert dict(Processes(2, tries=2)(Toil(passing, kills=frozenset({3}), for_times=1), ITEMS)) == SQUARES
    assert [(passing / str(n)).stat().st_size for n in ITEMS] == [2 if n == 3 else 1 for n in ITEMS]
    work = Toil(lasting, kills=frozenset({5}), raises=frozenset({4, 9}))
    told = dict(Processes(1, tries=2, apart=True)(work, ITEMS))
    dead, bug, known = (told.pop(n) for n in (5, 4, 9))
    assert told == {n: n * n for n in ITEMS if n not in (4, 5, 9)}
    assert [work.tried(n) for n in ITEMS] == [2 if n in (4, 5, 9) else 1 for n in ITEMS]
    assert isinstance(dead, Failed) and dead.tries == 2 and "died" in dead.why
    assert isinstance(dead.raised(), AnnulusError) and "Out of memory?" in str(dead.raised())
    assert isinstance(bug, Failed) and bug.why == "TwoPartError: item 4 is a bug"
    assert isinstance(known, Failed) and known.why == "item 9 cannot be done"
    assert isinstance(known.raised(), AnnulusError)
    assert not multiprocessing.active_children()


def test_what_raises_here_fails_after_its_tries(tmp_path: Path) -> None:
    work, executor = Toil(tmp_path, raises=frozenset({4, 9})), partial(in_process, tries=3)
    told = dict(executor(work, ITEMS))
    bug, known = told.pop(4), told.pop(9)
    assert isinstance(bug, Failed) and bug.why == "TwoPartError: item 4 is a bug" and bug.tries == 3
    assert isinstance(known, Failed) and known.why == "item 9 cannot be done"
    assert work.tried(4) == work.tried(9) == 3 and told == {n: n * n for n in ITEMS if n not in (4, 9)}
    (tmp_path / "again").mkdir()
    assert dict(executor(Toil(tmp_path / "again", raises=frozenset({4, 9}), for_times=2), ITEMS)) == SQUARES


@pytest.mark.parametrize(
    ("clock", "left", "slow"),
    [
        ([], 90, False),  # no worker is there yet
        ([0.0, 1.0], 90, False),  # it sets itself up, or is at the first item ..
        ([0.0, 1.6], 1, True),  # .. for too long
        ([0.0, 0.3, 0.34, 0.38, 0.42, 0.42], 30, False),  # 40 ms each: 1.2 s
        ([0.0, 0.3, 0.34, 0.38, 0.42, 0.42], 40, True),  # 1.6 s
        ([0.0, 0.3, 0.34, 0.38, 0.42, 0.42], 0, False),
        ([0.0, 0.3, *(0.3 + 0.04 * n for n in range(1, 60))], 5, False),  # long at it, and soon done
    ],
)
def test_other_workers_come_when_they_are_worth_their_start(
    clock: list[float], left: int, slow: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    crew = _Crew(Toil(Path()), ITEMS, 1, reported_s=clock[:-1])
    monkeypatch.setattr(executors.time, "monotonic", lambda: clock[-1])
    assert crew._slow(left) == slow


def test_what_is_soon_done_starts_one_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors.os, "cpu_count", lambda: 8)
    monkeypatch.setattr(_Crew, "_slow", lambda crew, left: False)  # whatever the machine is at
    done = Processes()(Toil(tmp_path), ITEMS)
    first = next(done)
    assert len(multiprocessing.active_children()) == 1
    assert dict([first, *done]) == SQUARES


class Imagined:
    """A worker's process, and its line, that there is not."""

    exitcode = 1

    def close(self) -> None: ...
    def join(self) -> None: ...


def crew_of(*alive: bool) -> _Crew:
    thing: Any = Imagined()
    return _Crew(Toil(Path()), ITEMS, 1, [_Hand(thing, thing, None, one) for one in alive])


def test_no_more_workers_come_than_have_something_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Crew, "_hired", lambda crew: crew.hands[0])
    for left, workers, there in ((3, 8, 4), (2, 8, 3), (9, 8, 8), (9, 4, 4)):
        crew = crew_of(True, False, False)  # two are still to come
        crew._hire_others(workers, left)
        assert len(crew.hands) == there


def test_who_is_there_goes_on_where_no_other_can_come(monkeypatch: pytest.MonkeyPatch) -> None:
    def hired(crew: _Crew) -> _Hand:
        raise BlockingIOError("no process left")

    monkeypatch.setattr(_Crew, "_hired", hired)
    crew = crew_of(True)
    crew._hire_others(8, 12)
    assert len(crew.hands) == 1
    crew = crew_of(True, *[False] * STILLBORN_MOST)
    monkeypatch.setattr(_Crew, "_hired", lambda crew: crew_of(False).hands[0])
    for _ in range(2 * STILLBORN_MOST):
        dead = next((hand for hand in crew.hands if not hand.alive), None)
        assert dead is None or crew._dead(dead) is None
    assert [hand.alive for hand in crew.hands] == [True]
    crew._hire_others(8, 12)
    assert len(crew.hands) == 1  # not before one has done something
    alone = crew_of(False)
    with pytest.raises(AnnulusError, match="end as they begin"):
        for _ in range(STILLBORN_MOST):
            alone._dead(alone.hands[0])


@pytest.mark.deep(gate="tests/system/test_executors.py::test_what_raises_here_fails_after_its_tries")
def test_who_stops_asking_leaves_no_process_behind(tmp_path: Path) -> None:
    told = Processes(2)(Toil(tmp_path), ITEMS)
    next(told)
    told.close()
    assert not multiprocessing.active_children()
