"""Promises of the worker pool: every frame handed out comes back once, done, failed or lost; nobody is left behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zmq

from annulus_pipe.stream import workers
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.pool_events import Died, Done, FrameFailed, FrameLost, PoolEvent, Ready, Report
from annulus_pipe.stream.ring import FrameRing
from annulus_pipe.stream.workers import HUNG_S, Shared, WorkerKind, WorkerPool
from annulus_pipe.vocabulary import AnnulusError, Label

WORKER = [sys.executable, str(Path(__file__).with_name("worker_for_tests.py"))]


def left_in_shm() -> set[str]:
    """Files in shared memory, but for the semaphores of tests that run beside this one."""
    return {name for name in os.listdir("/dev/shm") if not name.startswith("sem.mp-")}


class Yard:
    """A ring, a pool of workers and the loop around them."""

    def __init__(
        self,
        folder: Path,
        setup: object = "hello",
        count: int = 2,
        *,
        clock=time.monotonic,
        hung_s: float = HUNG_S,
        spares: int = 0,
        eager: bool = False,
    ) -> None:
        self.context, self.ring = zmq.Context(), FrameRing(8, 30 * 40)
        self.folder, self.index = folder, 0
        kind = WorkerKind("w", WORKER, setup, count, 2, hung_s, spares, eager)
        self.pool = WorkerPool(kind, Shared(self.ring, self.context, folder), clock)
        self.seen: list[PoolEvent] = []

    def until(self, done) -> None:
        end = time.monotonic() + 60
        while not done():
            assert time.monotonic() < end, self.seen
            self.pool.results.poll(20)
            self.seen += self.pool.poll()

    def all_ready(self, count: int = 2) -> "Yard":
        self.until(lambda: self.pool.ready == count)
        return self

    def hand_out(self, extra: object = None) -> bool:
        header = FrameHeader(self.index, 0, 0, Label.PROJECTOR, "", None, None, None, 0.0, "mono8", 40, 30)  # type: ignore[arg-type]
        place = self.ring.claim()
        assert place is not None
        self.ring.write(place, np.full((30, 40), self.index, np.uint8))
        self.index += 1
        taken = self.pool.offer(header, place, extra)
        self.ring.release(place)
        return taken

    def of(self, kind: type) -> list:
        return [happening for happening in self.seen if isinstance(happening, kind)]

    def close(self) -> None:
        pids = self.pool.pids + self.pool.spare_pids
        self.seen += self.pool.stop(5.0)
        self.context.destroy(linger=0)
        assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
        assert self.ring.free == len(self.ring), "a slot is still held"
        assert not list(self.folder.iterdir()), "a socket is left"
        self.ring.close()


@pytest.fixture
def yard(tmp_path: Path) -> Iterator[Yard]:
    yard = Yard(tmp_path)
    yield yard.all_ready()
    yard.close()


def test_every_frame_comes_back_with_its_own_answer(yard: Yard) -> None:
    while len(yard.of(Done)) < 20:
        if yard.index < 20 and yard.ring.free:
            yard.until(lambda: yard.pool.in_hand < 4)
            assert yard.hand_out(extra=yard.index)
        yard.pool.results.poll(5)
        yard.seen += yard.pool.poll()
    assert sorted(d.header.index for d in yard.of(Done)) == list(range(20))
    for done in yard.of(Done):
        assert done.body == [1200 * done.header.index, done.header.index]


@pytest.mark.deep(gate="tests/unit/stream/test_workers.py::test_notes_reach_every_worker_and_last_words_come_back")
def test_frames_of_one_flash_come_to_one_worker_and_their_slots_back_whatever_it_does(tmp_path: Path) -> None:
    yard = Yard(tmp_path, "flashes").all_ready()
    for extra in (None, "raise", "die"):
        places = [yard.ring.claim(), yard.ring.claim()]
        frames = []
        for camera, place in enumerate(places):
            assert place is not None
            header = FrameHeader(7, 0, 0, Label.PROJECTOR, "", None, None, None, 0.0, "mono8", 40, 30, camera=camera)  # type: ignore[arg-type]
            yard.ring.write(place, np.full((30, 40), camera + 1, np.uint8))
            frames.append((header, place))
        assert yard.pool.offer(*frames[0], extra, frames[1:])
        for _, place in frames:
            yard.ring.release(place)
        yard.until(lambda: yard.pool.in_hand == 0)
        assert yard.ring.free == len(yard.ring)
    assert [done.body for done in yard.of(Done)] == [[[0, 1200], [1, 2400]]]
    assert "asked to" in yard.of(FrameFailed)[0].why and yard.of(FrameLost)[0].header.camera == 0
    yard.close()


def test_a_job_of_single_frames_refuses_several(yard: Yard) -> None:
    header = FrameHeader(7, 0, 0, Label.PROJECTOR, "", None, None, None, 0.0, "mono8", 40, 30)  # type: ignore[arg-type]
    places = [yard.ring.claim(), yard.ring.claim()]
    for place in places:
        assert place is not None
        yard.ring.write(place, np.zeros((30, 40), np.uint8))
    assert yard.pool.offer(header, places[0], None, [(header, places[1])])
    for place in places:
        yard.ring.release(place)
    yard.until(lambda: yard.of(FrameFailed))
    assert "a job that takes one" in yard.of(FrameFailed)[0].why


@pytest.mark.deep(
    gate="tests/unit/stream/test_workers.py::test_a_hang_is_twenty_times_what_frames_usually_take_and_a_second_at_least"
)
def test_busy_workers_say_no_and_it_is_counted(yard: Yard) -> None:
    taken = [yard.hand_out("hang") for _ in range(6)]
    assert taken == [True] * 4 + [False] * 2
    assert yard.pool.counts["refused"] == 2
    for pid in yard.pool.pids:
        os.kill(pid, signal.SIGKILL)
    yard.until(lambda: len(yard.of(FrameLost)) == 4)


def test_a_frame_the_method_cannot_take_costs_that_frame_only(yard: Yard) -> None:
    yard.hand_out("raise")
    yard.hand_out("fine")
    yard.until(lambda: yard.of(FrameFailed) and yard.of(Done))
    assert yard.of(FrameFailed)[0].why == "RuntimeError: asked to"
    assert yard.pool.counts["died"] == 0


@pytest.mark.deep(
    gate="tests/unit/stream/test_workers.py::test_a_stopped_worker_is_replaced_and_one_that_goes_on_in_time_is_not"
)
def test_a_killed_worker_is_replaced_and_its_frames_are_reported(yard: Yard) -> None:
    yard.hand_out("die")
    yard.until(lambda: yard.of(Died))
    assert [lost.header.index for lost in yard.of(FrameLost)] == [0]
    assert yard.of(FrameLost)[0].why == "killed by SIGKILL"
    assert yard.of(Died)[0].replaced
    yard.all_ready()
    assert len(yard.of(Ready)) == 3
    for _ in range(4):
        assert yard.hand_out("after")
    yard.until(lambda: len(yard.of(Done)) == 4)


@pytest.mark.deep(
    gate="tests/unit/stream/test_workers.py::test_a_stopped_worker_is_replaced_and_one_that_goes_on_in_time_is_not"
)
def test_a_worker_told_to_end_by_a_stranger_is_replaced_too(yard: Yard) -> None:
    os.kill(yard.pool.pids[0], signal.SIGTERM)
    yard.until(lambda: yard.of(Died))
    yard.all_ready()


@pytest.mark.deep(
    gate="tests/unit/stream/test_workers.py::test_a_stopped_worker_ends_in_order_when_its_owner_is_killed"
)
def test_a_hung_worker_is_killed_and_its_frames_are_reported(tmp_path: Path) -> None:
    now = [0.0]
    yard = Yard(tmp_path, count=1, clock=lambda: now[0], hung_s=10.0).all_ready(1)
    yard.hand_out("hang")
    yard.seen += yard.pool.poll()
    assert not yard.of(FrameLost)
    now[0] = 10.5
    yard.until(lambda: yard.of(Died))
    assert [lost.why for lost in yard.of(FrameLost)] == ["hung for 10 s"]
    yard.close()


def test_notes_reach_every_worker_and_last_words_come_back(tmp_path: Path) -> None:
    yard = Yard(tmp_path, setup={"a": b"\x00\xff"}).all_ready()
    yard.pool.tell("pose", [1, 2])
    yard.until(lambda: len(yard.of(Report)) == 2)
    assert {(r.worker, str(r.body)) for r in yard.of(Report)} == {(n, str([["pose", [1, 2]]])) for n in (0, 1)}
    yard.close()
    assert [r.body for r in yard.of(Report) if r.final] == [{"a": b"\x00\xff"}] * 2
    assert yard.pool.counts["killed"] == 0


def test_a_worker_that_cannot_live_is_given_up_not_started_for_ever(tmp_path: Path) -> None:
    yard = Yard(tmp_path, setup="stillborn", count=1)
    yard.until(lambda: yard.pool.alive == 0)
    assert [died.replaced for died in yard.of(Died)] == [True] * 3 + [False]
    assert yard.of(Died)[0].why == "exit status 3"
    yard.close()


def test_stopping_a_hung_pool_is_quick_and_says_what_was_lost(tmp_path: Path) -> None:
    yard = Yard(tmp_path, count=1).all_ready(1)
    yard.hand_out("hang")
    lost = [h for h in yard.pool.stop(0.2) if isinstance(h, FrameLost)]
    assert [one.header.index for one in lost] == [0]
    assert yard.pool.counts["killed"] == 1
    yard.close()


def test_a_command_that_is_not_there_is_one_clear_line(tmp_path: Path) -> None:
    ring = FrameRing(2, 100)
    with zmq.Context() as context:
        with pytest.raises(AnnulusError, match="cannot start /no/such"):
            WorkerPool(WorkerKind("w", ["/no/such"], None, 1, 1), Shared(ring, context, tmp_path))
        context.destroy(linger=0)
    assert not list(tmp_path.iterdir())
    ring.close()


_OWNER = """
import os, signal, sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from test_workers import Yard
yard = Yard(Path({folder!r})).all_ready()
print(*yard.pool.pids, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_workers_end_when_their_owner_is_killed(tmp_path: Path) -> None:
    shm = left_in_shm()
    code = _OWNER.format(tests=str(Path(__file__).parent), folder=str(tmp_path))
    owner = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pids = owner.stdout.split()
    assert owner.returncode == -signal.SIGKILL and len(pids) == 2
    end = time.monotonic() + 60
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < end
        time.sleep(0.02)
    assert left_in_shm() == shm


def test_a_stopped_worker_ends_in_order_when_its_owner_is_killed(tmp_path: Path) -> None:
    (sockets := tmp_path / "sockets").mkdir()
    code = _OWNER.format(tests=str(Path(__file__).parent), folder=str(sockets)).replace(
        "os.kill(os.getpid()", "[os.kill(pid, signal.SIGSTOP) for pid in yard.pool.pids]; os.kill(os.getpid()"
    )
    owner = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    end = time.monotonic() + 60
    while any(alive(pid) for pid in owner.stdout.split()) or sockets.exists():
        assert time.monotonic() < end
        time.sleep(0.02)


def alive(pid: str) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1][0] != "Z"
    except FileNotFoundError:
        return False


def test_what_a_user_can_mend_is_said_and_not_tried_again(tmp_path: Path) -> None:
    yard = Yard(tmp_path, setup="broken", count=1)
    yard.until(lambda: yard.pool.alive == 0)
    assert yard.of(Died) == [Died(0, "/etc/x: mend it", False)]
    yard.close()


def test_a_hang_is_twenty_times_what_frames_usually_take_and_a_second_at_least(tmp_path: Path) -> None:
    now = [0.0]
    yard = Yard(tmp_path, count=1, clock=lambda: now[0]).all_ready(1)
    assert yard.pool.hung_s == HUNG_S, "nothing is known yet"
    for took_s in (0.2, 0.1, 0.1):
        yard.hand_out("fine")
        now[0] += took_s
        done = len(yard.of(Done)) + 1
        yard.until(lambda done=done: len(yard.of(Done)) == done)
    assert yard.pool.hung_s == pytest.approx(2.0)
    for _ in range(10):
        yard.hand_out("fine")
        done = len(yard.of(Done)) + 1
        yard.until(lambda done=done: len(yard.of(Done)) == done)
    assert yard.pool.hung_s == 1.0
    yard.hand_out("hang")
    now[0] += 0.9
    yard.seen += yard.pool.poll()
    assert not yard.of(Died)
    now[0] += 0.2
    yard.until(lambda: yard.of(Died))
    yard.close()


def test_who_waited_for_a_disk_has_its_time_from_when_the_disk_lets_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, letter = [0.0], ["D"]
    monkeypatch.setattr(workers, "process_state", lambda pid: letter[0])
    yard = Yard(tmp_path, count=1, clock=lambda: now[0]).all_ready(1)
    yard.hand_out("fine")
    yard.until(lambda: yard.of(Done))
    yard.hand_out("hang")
    for at_s, state in ((3.0, "D"), (3.9, "S")):
        now[0], letter[0] = at_s, state
        yard.seen += yard.pool.poll()
        assert not yard.of(Died)
    now[0] = 4.1
    yard.until(lambda: yard.of(Died))
    assert yard.of(Died)[0].why == "hung for 4 s"
    yard.all_ready(1).close()


def test_a_stopped_worker_is_replaced_and_one_that_goes_on_in_time_is_not(tmp_path: Path) -> None:
    now = [0.0]
    yard = Yard(tmp_path, count=1, clock=lambda: now[0]).all_ready(1)
    victim = yard.pool.pids[0]

    def look(number: signal.Signals | None = None) -> None:
        if number is not None:
            os.kill(victim, number)
            while (Path(f"/proc/{victim}/stat").read_text().rsplit(") ")[1][0] == "T") != (number == signal.SIGSTOP):
                time.sleep(0.001)
        now[0] += 0.5
        yard.seen += yard.pool.poll()

    look(signal.SIGSTOP)
    look(signal.SIGCONT)
    assert yard.pool.pids == [victim]
    look(signal.SIGSTOP)
    look()
    assert [died.why for died in yard.of(Died)] == ["stopped by a signal"]
    yard.all_ready(1).close()


@pytest.mark.deep(
    gate="tests/unit/stream/test_workers.py::test_a_hang_is_twenty_times_what_frames_usually_take_and_a_second_at_least"
)
def test_a_spare_takes_over_and_another_spare_is_made(tmp_path: Path) -> None:
    now = [0.0]
    yard = Yard(tmp_path, count=1, spares=1, clock=lambda: now[0]).all_ready(1)
    yard.until(lambda: yard.pool.spare_pids)
    first, spares = yard.pool.pids, yard.pool.spare_pids
    assert len(spares) == 1 and yard.pool.alive == 1
    os.kill(first[0], signal.SIGKILL)
    yard.until(lambda: yard.of(Died))
    assert yard.pool.pids == spares
    yard.all_ready(1)
    assert yard.pool.spare_pids == [], "not one after the other as fast as they die"
    now[0] += 1.1
    yard.until(lambda: len(yard.pool.spare_pids) == 1)
    os.kill(yard.pool.spare_pids[0], signal.SIGKILL)
    yard.until(lambda: yard.pool.counts["spares_died"] == 1)
    assert yard.pool.counts["died"] == 1 and yard.hand_out("fine")
    yard.until(lambda: yard.of(Done))
    yard.close()


@pytest.mark.deep(
    gate="tests/unit/stream/test_workers.py::test_a_hang_is_twenty_times_what_frames_usually_take_and_a_second_at_least"
)
def test_an_eager_spare_is_ready_at_once(tmp_path: Path) -> None:
    yard = Yard(tmp_path, count=1, spares=1, eager=True).all_ready(1)
    yard.until(lambda: yard.pool.spare_pids)
    assert yard.pool.ready == yard.pool.alive == len(yard.of(Ready)) == 1
    spares = yard.pool.spare_pids
    os.kill(yard.pool.pids[0], signal.SIGKILL)
    while not yard.of(Died):
        yard.seen += yard.pool.poll()
    assert yard.pool.pids == spares and yard.pool.ready == 1 and len(yard.of(Ready)) == 2
    assert yard.hand_out("fine")
    yard.until(lambda: yard.of(Done))
    yard.close()


@pytest.mark.deep(
    gate="tests/unit/stream/test_workers.py::test_a_worker_that_cannot_live_is_given_up_not_started_for_ever"
)
def test_those_given_up_can_be_started_again(tmp_path: Path) -> None:
    yard = Yard(tmp_path, setup="broken", count=2)
    yard.until(lambda: yard.pool.alive == 0)
    yard.pool.revive()
    assert yard.pool.alive == 2
    yard.until(lambda: yard.pool.alive == 0)
    yard.close()
