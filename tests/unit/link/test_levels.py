"""Host and controller of different levels: each does fully what both know, and takes nothing new for damage."""

import os
import pty
import threading
import time
import tty
from contextlib import suppress
from dataclasses import replace

import pytest

from annulus_pipe.link.client import Client
from annulus_pipe.link.codec import Corrupt, Decoder, Unknown, crc16
from annulus_pipe.link.head import EdgeSeen, HeadControl
from annulus_pipe.link.messages import (
    LEVEL,
    BootCause,
    Booted,
    Configuration,
    Edge,
    Fault,
    Info,
    Ping,
    Stage,
    Status,
    TurntableDone,
)
from annulus_pipe.link.phase import Phase
from annulus_pipe.link.session import Answer, EventReceived, EventsLost, LinkSession, Rebooted, identify
from annulus_pipe.testing.scripted import ScriptedController
from annulus_pipe.vocabulary import AnnulusError, EdgeFlag, Lamp

MS = 1_000_000
STAGE = Stage(1, 4, 4_000_000, 3_800_000, 2_800_000, 50, 0, 450_000, 500_000, 575_000, 250_000)


class Bench:
    """A head and a scripted controller, one millisecond a step."""

    def __init__(self, controller: ScriptedController) -> None:
        self.head, self.controller = HeadControl(STAGE), controller
        self.now = 10**12
        self.news: list[object] = []

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += MS
            self.controller.receive(self.head.pending(self.now), self.now)
            self.news += self.head.receive(self.controller.take(), self.now)

    def edge(self, number: int) -> None:
        tick = (self.now - (self.controller.tick_origin_ns or 0)) // 10
        self.controller.emit(Edge(number, tick, 0, Lamp.PROJECTOR, 450_000, 500_000, 0, 1, EdgeFlag(0)))

    def all(self, kind: type) -> list:
        return [news for news in self.news if isinstance(news, kind)]


def stuffed(body: bytes, schema_byte: int) -> bytes:
    whole = body + crc16(body, schema_byte).to_bytes(2, "little")
    return b"".join(bytes((len(run) + 1,)) + run for run in whole.split(b"\0")) + b"\0"


# ---- an older controller ----


def test_a_controller_of_level_1_is_brought_into_service_all_the_same() -> None:
    bench = Bench(ScriptedController(level=1))
    bench.run(60)
    assert bench.head.phase is Phase.RUNNING and bench.controller.armed
    assert bench.head.session.informed and bench.head.session.info is None
    assert not bench.head.session.knows(Configuration) and bench.head.session.knows(Status)
    assert not any(isinstance(command, Info | Configuration) for command in bench.controller.executed)
    bench.edge(0)
    bench.run(50)
    assert len(bench.all(EdgeSeen)) == 1
    assert bench.head.session.counters.unanswered == 0


def test_what_an_older_controller_lacks_is_one_line_that_says_what_to_do() -> None:
    controller = ScriptedController(level=1)
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    done = threading.Event()

    def serve() -> None:
        while not done.wait(0.001):
            with suppress(BlockingIOError):
                controller.receive(os.read(master, 4096), time.monotonic_ns())
            os.write(master, controller.take())

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        with Client(os.ttyname(slave)) as client:
            client.request(Status())
            with pytest.raises(
                AnnulusError, match=r"older than this annulus and has no configuration. `annulus firmware"
            ):
                client.request(Configuration())
    finally:
        done.set()
        thread.join()
        os.close(master)
        os.close(slave)


# ---- a newer controller ----


def test_messages_nobody_here_knows_are_passed_over_and_counted_not_taken_for_damage() -> None:
    session = LinkSession()
    session.send(identify())
    controller = ScriptedController()
    now = 10**12

    def step(extra: bytes = b"") -> list:
        controller.receive(session.pending(now), now)
        return session.receive(controller.take() + extra, now)

    step()
    step()
    controller.emit(TurntableDone(0, 1))
    controller._next += 1  # number 1 is of a kind nobody here knows
    later = stuffed(bytes((0x9F, 1, 0, controller.boot)) + bytes(range(1, 12)), 0x3C)
    first = step(later)
    controller.emit(TurntableDone(0, 2))
    second = step(stuffed(bytes((0x83, 3, 0, controller.boot)) + bytes(4) + b"\x63" + bytes(4), Fault.SCHEMA_BYTE))
    events = [h.event for h in first + second if isinstance(h, EventReceived)]
    assert [event.position for event in events] == [1, 2]
    assert session.counters.unknown == 2 and session.counters.corrupt == {}
    assert not [h for h in first + second if isinstance(h, EventsLost | Corrupt)]
    assert session.counters.events_missed == 0  # its place in the sequence counts


def test_damage_is_still_damage() -> None:
    frame = bytearray(stuffed(bytes((0x9F, 1, 0, 7)) + bytes(range(1, 12)), 0x3C))
    (whole,) = Decoder().feed(bytes(frame))
    assert whole == Unknown(0x9F, 1, 7)
    passed = 0
    for at in range(1, len(frame) - 1):
        for bit in range(8):
            damaged = bytearray(frame)
            damaged[at] ^= 1 << bit
            if 0 not in damaged[:-1]:
                passed += any(isinstance(found, Unknown) for found in Decoder().feed(bytes(damaged)))
    assert passed <= 3  # one in 256: nobody knows the schema byte


# ---- what is in force ----


def test_a_configuration_that_is_not_the_one_asked_for_is_never_armed() -> None:
    bench = Bench(ScriptedController())
    bench.run(2)
    honest = bench.controller._execute

    def other(command: object, now: int) -> object:
        reply = honest(command, now)
        return replace(reply, projector_width=400_000) if isinstance(command, Configuration) else reply

    bench.controller._execute = other  # type: ignore[method-assign, assignment]
    bench.run(40)
    assert bench.head.phase is Phase.REFUSED and not bench.controller.armed
    assert bench.head.problem == (
        "the configuration in force is not the one asked for: projector_width is 400000, expected 500000"
    )


# ---- another boot with the same byte ----


def told_by(bench: Bench) -> str:
    again = bench.all(Rebooted)[-1]
    assert again.previous == again.boot
    return str(again.why)


def running() -> Bench:
    bench = Bench(ScriptedController())
    bench.run(900)
    bench.edge(20)
    bench.run(300)
    bench.news.clear()
    bench.controller.power_cycle()
    bench.controller.tick_origin_ns = bench.now
    return bench


def test_a_clock_that_jumped_is_another_boot() -> None:
    bench = running()
    bench.run(120)
    assert told_by(bench) == "its clock jumped"
    assert bench.head.phase is Phase.RUNNING and bench.head.boot_epoch == 2 and bench.controller.armed


def test_an_event_sequence_that_begins_anew_is_another_boot() -> None:
    bench = running()
    bench.edge(0)  # number 1: `booted` was lost
    bench.run(1)
    assert told_by(bench) == "its events begin anew" or told_by(bench).startswith("edge 0")
    bench.run(60)
    (seen,) = bench.all(EdgeSeen)
    assert seen.boot_epoch == 2


def test_booted_amid_a_session_is_another_boot() -> None:
    bench = running()
    bench.controller._ring.clear()
    bench.controller._next = 0
    bench.controller.emit(Booted(BootCause.POWER_ON, 0))
    bench.run(1)
    assert told_by(bench) == "its events begin anew"


def test_another_nonce_behind_the_same_byte_is_another_boot() -> None:
    """The line was closed while the power was off: nothing but the nonce tells."""
    bench = running()
    bench.controller.tick_origin_ns = bench.now - 10**9
    bench.head.reopened()
    bench.run(3)
    assert told_by(bench) == "another nonce"
    bench.run(30)
    assert bench.head.phase is Phase.RUNNING and bench.head.session.info is not None


def test_a_suspicion_without_ground_costs_a_new_start_and_is_counted() -> None:
    bench = Bench(ScriptedController())
    bench.run(500)
    bench.controller.tick_origin_ns = (bench.controller.tick_origin_ns or 0) + 10**9  # nobody's clock does that
    bench.run(200)
    assert bench.head.session.counters.reboots_unfounded == 1
    assert bench.head.phase is Phase.RUNNING and bench.head.boot_epoch == 2


def test_the_level_is_told_after_every_identify() -> None:
    session, controller = LinkSession(), ScriptedController()
    heard: list[object] = []
    for now in range(10**12, 10**12 + 6 * MS, MS):
        if (now - 10**12) % (3 * MS) == 0:
            session.send(identify())
        controller.receive(session.pending(now), now)
        heard += session.receive(controller.take(), now)
    assert [command.level for command in controller.executed if isinstance(command, Info)] == [LEVEL, LEVEL]
    assert len([h for h in heard if isinstance(h, Answer)]) == 2  # the question is the session's own
    assert session.info is not None and session.knows(Ping)
