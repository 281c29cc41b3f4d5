"""Promises of what operators do between start and stop: trials, lamps, pauses. The simulated head in real time."""

import contextlib
import random
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from test_control import WORLD, Bystander, frames_are_what_they_are_called, head, until  # noqa: F401

from annulus_pipe.daemon.command import Operator
from annulus_pipe.daemon.config import HeadConfig, SocketConfig
from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.daemon.controller_line import ControllerLine
from annulus_pipe.daemon.session import Session
from annulus_pipe.daemon.state import State
from annulus_pipe.demo import demo_config
from annulus_pipe.job import JobSheet
from annulus_pipe.record.recording import open_recording
from annulus_pipe.reprocess.relabel import audit
from annulus_pipe.twin.head import HeadHandle
from annulus_pipe.vocabulary import AnnulusError, Label

pytestmark = [
    pytest.mark.alone,
    pytest.mark.deep(gate="tests/system/test_control.py::test_a_scan_that_cannot_begin_is_told_and_the_daemon_stays"),
]

STALL_S = 0.1  # a machine that stood still for longer keeps no promise in seconds


def operated(head: HeadHandle, folder: Path, operate: Callable[[ControlClient, Session], None]) -> Bystander:
    """The simulated head, run by its control socket."""
    config = replace(
        demo_config(head, WORLD, folder),
        calibration=None,
        autostart=False,
        control=SocketConfig(f"ipc://{folder}/control"),
    )
    return run(config, operate)


def run(config: HeadConfig, operate: Callable[[ControlClient, Session], None]) -> Bystander:
    """A session that somebody runs, from idle to the end of what he does."""
    assert config.control is not None
    address, failed = config.control.address, []
    seen = Bystander()
    session = Session(config, observer=seen, name="scan")
    done = threading.Event()

    def work() -> None:
        try:
            with ControlClient(address) as client:
                until(lambda: session.state is State.IDLE)
                operate(client, session)
        except BaseException as error:
            failed.append(error)
        finally:
            done.set()

    operator = threading.Thread(target=work)
    operator.start()
    session.run(done.is_set)
    operator.join()
    if failed:
        raise failed[0]
    return seen


def test_a_trial_that_nobody_holds_is_dark_and_its_lamps_are_the_former_ones(
    head: HeadHandle, tmp_path: Path, stalls: Any
) -> None:
    def operate(client: ControlClient, session: Session) -> None:
        before = dict(client.about()["lamps"])
        with pytest.raises(AnnulusError, match="leaves the window"):
            client.lamps(commit=False, projector_delay_us=1.0)
        with pytest.raises(AnnulusError, match="no longer than"):
            client.lamps(commit=True, led_width_us=21_000.0)
        with pytest.raises(AnnulusError, match="no trial"):
            client.hold()
        client.trial(hold_s=20.0)
        until(lambda: session.state is State.SCANNING)
        tried = client.lamps(commit=True, trial=True, projector_delay_us=1.0, projector_width_us=900.0)
        assert tried["projector_delay_us"] == 1.0, "a trial may look outside the window"
        until(lambda: session.labelled > 12)
        asked = time.monotonic()
        client.hold(2.0)
        until(lambda: session.state is State.IDLE)
        held_s = time.monotonic() - asked
        assert held_s >= 1.9
        if stalls.since(asked) < STALL_S:
            assert held_s <= 4.0
        assert head.counters()["lamps_on"] == [] and not list(tmp_path.glob("*.mcap"))
        assert dict(client.about()["lamps"]) == before
        client.lamps(commit=True, projector_width_us=4000.0)  # and these stay
        assert client.about()["lamps"]["projector_width_us"] == 4000.0

    seen = operated(head, tmp_path, operate)
    assert any("nobody asked for more" in text for text in seen.told)


def test_a_paused_scan_goes_on_in_its_recording_and_every_label_is_right(
    head: HeadHandle, tmp_path: Path, stalls: Any
) -> None:
    def operate(client: ControlClient, session: Session) -> None:
        client.job(JobSheet(client="The Waterworks"))
        client.start()
        until(lambda: session.labelled >= 15)
        before = client.health()
        assert client.pause() is State.PAUSED
        assert head.counters()["lamps_on"] == []
        at, z_mm = session.labelled, session.telemetry()["z_mm"]
        with pytest.raises(AnnulusError, match="only while it is"):
            client.pause()
        with pytest.raises(AnnulusError, match="only while it is"):
            client.start()
        with pytest.raises(AnnulusError, match="a scan is under way"):
            client.lamps(commit=True, led_width_us=900.0)
        time.sleep(2.5)
        assert session.labelled == at and (client.health() == "ok" or before != "ok"), "a pause is no trouble"
        until(lambda: session.telemetry()["z_mm"] > z_mm + 10.0)  # the cable is counted on
        assert client.resume() is State.ARMED
        client.job(JobSheet(site="Elm Street"))
        until(lambda: session.labelled >= at + 25)
        client.pause()
        assert client.stop() is State.IDLE

    begun = time.monotonic()
    seen = operated(head, tmp_path, operate)
    report = seen.reports[0]
    assert not report.findings and report.ledger.problem == ""
    recording = open_recording(tmp_path / "scan.mcap")
    called = frames_are_what_they_are_called(recording)
    assert called
    known = [frame for frame in recording.frames if frame.label is not Label.UNKNOWN]
    if stalls.since(begun) < STALL_S:
        assert report.ledger.taken == report.ledger.labelled == report.ledger.recorded
        assert not report.drops.get("camera") and not report.drops.get("camera_away"), "nothing was missed"
        assert called >= 35 and len(known) >= 0.6 * len(recording.frames)
    assert not audit(tmp_path / "scan.mcap").changed, "the evidence says the same over a pause"
    told = list(recording.notes("/job"))
    assert [one.get("site") for one in told] == ["Elm Street"]
    assert told[0]["client"] == "The Waterworks"


def test_three_operators_who_ask_at_random_break_nothing(head: HeadHandle, tmp_path: Path) -> None:
    def operate(client: ControlClient, session: Session) -> None:
        wrong: list[BaseException] = []

        def ask(number: int) -> None:
            rng, end = random.Random(number), time.monotonic() + 15.0
            try:
                with ControlClient(client.address, who=Operator(f"id{number}", f"operator {number}")) as mine:
                    asks: list[Callable[[], object]] = [
                        mine.start,
                        mine.start,
                        lambda: mine.trial(2.0),
                        mine.hold,
                        mine.stop,
                        mine.pause,
                        mine.resume,
                        mine.zero,
                        mine.about,
                        mine.state,
                        lambda: mine.mark("x", 90.0, b"\xff\xd8\xff" + bytes(1000)),
                        lambda: mine.command(take=rng.random() < 0.3),
                        mine.release,
                        lambda: mine.lamps(commit=True, trial=rng.random() < 0.5, led_width_us=rng.choice((9e2, 5e4))),
                        lambda: mine.job(JobSheet(client=str(rng.random()))),
                        lambda: time.sleep(2 * rng.random()),
                    ]
                    while time.monotonic() < end:
                        with contextlib.suppress(AnnulusError):
                            rng.choice(asks)()
                        time.sleep(0.3 * rng.random())
            except BaseException as error:
                wrong.append(error)

        operators = [threading.Thread(target=ask, args=(number,)) for number in range(3)]
        for one in operators:
            one.start()
        for one in operators:
            one.join()
        assert not wrong
        until(lambda: client.state() is State.IDLE or bool(client.stop()))
        assert head.counters()["lamps_on"] == []

    seen = operated(head, tmp_path, operate)
    assert seen.reports and not [finding.text for report in seen.reports for finding in report.findings]
    assert not any(text.startswith("ending,") for text in seen.told), seen.told


def test_lamps_that_nobody_confirms_are_refused_and_the_trial_of_them_ends_dark(
    head: HeadHandle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def operate(client: ControlClient, session: Session) -> None:
        before = dict(client.about()["lamps"])
        client.trial(hold_s=20.0)
        until(lambda: session.state is State.SCANNING)
        client.lamps(commit=True, trial=True, projector_delay_us=1.0, projector_width_us=900.0)
        with monkeypatch.context() as patched:
            patched.setattr(ControllerLine, "refusal", "not now")
            client.hold(1.0)
            until(lambda: session.state is State.IDLE)
            assert client.state() is State.IDLE, "the session goes on, whatever the controller says of its lamps"
        assert dict(client.about()["lamps"]) == before and head.counters()["lamps_on"] == []
        with monkeypatch.context() as patched:
            patched.setattr(ControllerLine, "settled", False)
            with pytest.raises(AnnulusError, match="did not confirm"):
                client.lamps(commit=True, led_width_us=900.0)
            assert dict(client.about()["lamps"]) == before

    seen = operated(head, tmp_path, operate)
    assert any("not confirmed yet: " in text for text in seen.told)


def test_photos_as_fast_as_twenty_clients_can_send_cost_the_scan_nothing(
    head: HeadHandle, tmp_path: Path, stalls: Any
) -> None:
    photo, seconds, took_s = b"\xff\xd8\xff" + random.Random(3).randbytes(48_000), 5.0, 0.0

    def operate(client: ControlClient, session: Session) -> None:
        client.start()
        until(lambda: session.labelled >= 15)
        nonlocal took_s
        sent, begun = 0, time.monotonic()
        with zmq.Context() as context:
            flood = [context.socket(zmq.DEALER) for _ in range(20)]
            for one in flood:
                one.setsockopt(zmq.LINGER, 0)
                one.setsockopt(zmq.SNDHWM, 2)
                one.connect(client.address)
            while (took_s := time.monotonic() - begun) < seconds or (sent <= 1000 and took_s < 60.0):
                for one in flood:
                    with contextlib.suppress(zmq.Again):
                        one.send(msgpack.packb({"do": "mark", "text": "x", "photo": photo}), zmq.NOBLOCK)
                        sent += 1
                asked = time.monotonic()
                client.state()
                answered_s = time.monotonic() - asked
                assert answered_s < 0.5 or stalls.since(asked) > STALL_S, "others are answered"
            for one in flood:
                one.close(0)
        assert sent > 1000
        client.stop()

    started = time.monotonic()
    seen = operated(head, tmp_path, operate)
    report = seen.reports[0]
    assert 1 <= len(seen.marks) <= took_s + 3
    assert not report.findings and report.ledger.problem == ""
    if stalls.since(started) < STALL_S:
        assert report.ledger.labelled == report.ledger.recorded
        assert not report.drops.get("recorder_notes") and not report.drops.get("recorder_busy")
