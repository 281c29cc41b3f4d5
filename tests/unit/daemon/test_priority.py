"""Promises of real-time priority: taken where allowed, told where wanted and refused, never handed on."""

import os
import threading
import time

import pytest
import zmq

from annulus_pipe.daemon import priority
from annulus_pipe.daemon.priority import ProcessorAllowance, is_realtime, prompt, raise_priority, share_priority


def in_a_thread(work: object) -> list[object]:
    got: list[object] = []
    thread = threading.Thread(target=lambda: got.append(work()))  # type: ignore[operator]
    thread.start()
    thread.join()
    return got


def test_refused_is_a_remark_unless_nobody_wanted_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert raise_priority(False) == ""
    told = raise_priority(True)
    assert raise_priority(None) == told
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


def policies() -> dict[int, int]:
    """Of all threads of this process."""
    tasks = [int(name) for name in os.listdir("/proc/self/task")]
    return {task: os.sched_getscheduler(task) & ~os.SCHED_RESET_ON_FORK for task in tasks}


@pytest.fixture
def allowed() -> None:
    if in_a_thread(lambda: raise_priority(True)) != [""]:
        pytest.skip("this system allows no real-time priority")


def test_threads_that_share_the_interpreters_lock_share_the_priority(allowed: None) -> None:
    over = threading.Event()
    other = threading.Thread(target=over.wait)
    other.start()

    def shared() -> tuple[int, int]:
        share_priority()  # of an ordinary thread: nothing to share
        before = policies()[other.native_id or 0]
        raise_priority(True)
        share_priority()
        after = policies()[other.native_id or 0]
        for thread in threading.enumerate():
            os.sched_setscheduler(thread.native_id or 0, os.SCHED_OTHER, os.sched_param(0))
        return before, after

    assert in_a_thread(shared) == [(os.SCHED_OTHER, os.SCHED_FIFO)]
    over.set()
    other.join()


def test_a_context_of_our_own_is_as_prompt_as_its_maker_and_no_other(allowed: None) -> None:
    def of_new(before: set[int]) -> list[int]:
        return [policy for task, policy in policies().items() if task not in before]

    def made() -> tuple[int, int]:
        counts = []
        raise_priority(True)
        for context in (zmq.Context(), prompt(zmq.Context())):
            before = set(policies())
            context.socket(zmq.PULL).close()
            end = time.monotonic() + (0.1 if not counts else 20.0)  # its threads see to it themselves
            while time.monotonic() < end and os.SCHED_FIFO not in (new := of_new(before)):
                time.sleep(0.001)
            counts.append(new.count(os.SCHED_FIFO))
            context.destroy()
        assert is_realtime()
        return counts[0], counts[1]

    ((ordinary, ours),) = in_a_thread(made)  # type: ignore[misc]
    assert ordinary == 0 and ours > 0


def test_whoever_is_made_to_work_hard_is_an_ordinary_process_until_it_is_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    set_to: list[int] = []
    monkeypatch.setattr(priority, "raise_priority", lambda *_: "")
    monkeypatch.setattr(priority, "_tasks", lambda: [1])
    monkeypatch.setattr(priority.resource, "setrlimit", lambda *_: None)
    monkeypatch.setattr(priority, "_set", lambda tasks, policy, param: set_to.append(policy & ~os.SCHED_RESET_ON_FORK))
    now, used = [0.0], [0.0]
    allowance = ProcessorAllowance(True, lambda: now[0], lambda: used[0])
    raised = []
    for share in (0.05, 0.2, 0.9, 0.9, 0.1):
        now[0], used[0] = now[0] + 1.0, used[0] + share
        allowance.look()
        raised.append(allowance.raised)
    assert raised == [True, True, False, False, True] and allowance.exceeded == 1
    assert set_to == [os.SCHED_FIFO] * 3 + [os.SCHED_OTHER, os.SCHED_FIFO]


def test_without_permission_or_wish_nothing_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(priority, "_set", lambda *_: pytest.fail("raised all the same"))
    monkeypatch.setattr(priority, "raise_priority", lambda *_: "refused")
    for wanted in (False, None, True):
        assert not ProcessorAllowance(wanted).raised
