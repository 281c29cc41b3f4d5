"""Promises of local executors: an item that raises or kills costs itself and nothing else, however often it is tried.

Few workers are started here: each takes seconds of processor before it can do anything.
"""

import multiprocessing
from functools import partial
from pathlib import Path

import pytest
from toil import Toil

from annulus_pipe.reprocess.executors import Failed, Processes, in_process
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


@pytest.mark.deep(gate="tests/system/test_executors.py::test_what_raises_here_fails_after_its_tries")
def test_who_stops_asking_leaves_no_process_behind(tmp_path: Path) -> None:
    told = Processes(2)(Toil(tmp_path), ITEMS)
    next(told)
    told.close()
    assert not multiprocessing.active_children()
