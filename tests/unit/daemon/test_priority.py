"""Promises of real-time priority: taken where allowed, told where wanted and refused, never handed on."""

import os
import threading

import pytest

from annulus.daemon.priority import raise_priority


def in_a_thread(work: object) -> list[object]:
    got: list[object] = []
    thread = threading.Thread(target=lambda: got.append(work()))  # type: ignore[operator]
    thread.start()
    thread.join()
    return got


def test_refused_is_a_remark_only_when_it_was_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert raise_priority(None) == raise_priority(False) == ""
    told = raise_priority(True)
    assert told.startswith("no real-time priority (Operation not permitted)") and "\n" not in told


def test_what_is_granted_is_for_this_thread_and_not_for_those_it_starts() -> None:
    def raised() -> tuple[str, int, list[object]]:
        remark = raise_priority(True)
        mine = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        return remark, mine, in_a_thread(lambda: os.sched_getscheduler(0))

    before = os.sched_getscheduler(0)
    ((remark, mine, started),) = in_a_thread(raised)  # type: ignore[misc]
    assert (mine == os.SCHED_FIFO) == (remark == "")
    assert started == [os.SCHED_OTHER]
    assert os.sched_getscheduler(0) == before
