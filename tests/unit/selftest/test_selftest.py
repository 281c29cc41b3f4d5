"""The self-test as a command, on the firmware's native board: what it says, what it leaves behind, whom it refuses."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from annulus_pipe.link.client import Client
from annulus_pipe.link.codec import TO_CONTROLLER, Decoder
from annulus_pipe.link.messages import Arm, ArmFlag, Commit, StateFlag, Status, StatusReply
from annulus_pipe.link.stage import stage_from_us
from annulus_pipe.selftest.promise import PromiseVerdict
from annulus_pipe.selftest.run import run_selftest
from annulus_pipe.testing.heads import ScriptedHead, SimulatedHead
from annulus_pipe.vocabulary import AnnulusError

STEP_TO_SYNC = (8, 2)


def annulus(*arguments: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", "from annulus_pipe.cli import main; main()", "head", "selftest", *arguments]
    return subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)


def test_a_board_that_keeps_its_promises_ends_with_status_0_and_a_page(tmp_path: Path) -> None:
    run = annulus("--port", "native://", "--edges", "40", "--json", "-o", str(tmp_path / "out"))
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout)
    assert told == json.loads((tmp_path / "out/selftest.json").read_text())
    assert (told["board"], told["broken"]) == ("native", 0)
    assert told["kept"] >= 24
    assert "none broken" in (tmp_path / "out/selftest.html").read_text()


def test_nothing_fires_before_somebody_says_that_all_is_unplugged() -> None:
    with SimulatedHead() as head, head.live() as url:
        run = annulus("--port", url)
    assert run.returncode != 0
    assert "Unplug the lamps" in run.stderr
    assert "Traceback" not in run.stderr
    assert head.changes() == []


def test_a_broken_promise_is_status_1(monkeypatch: pytest.MonkeyPatch) -> None:
    """A board whose lamps come 9 ticks after what is expected of it."""
    monkeypatch.setattr("annulus_pipe.selftest.lamps.LATENCY", {"native": 9, "rp2040": 9})
    with SimulatedHead(wires=(STEP_TO_SYNC,)) as head:
        test = run_selftest(head.url, name="", edges=40, move_wire=lambda _: False)
    broken = [row.what for row in test.rows if row.verdict is PromiseVerdict.BROKEN]
    assert broken == ["Falling edge of sync to LED on", "Falling edge of sync to projector on"]


def test_a_head_is_left_dark_standing_and_counting() -> None:
    with SimulatedHead(wires=(STEP_TO_SYNC,)) as head:
        run_selftest(head.url, name="", edges=20, move_wire=lambda _: False)
        with Client(head.url) as client:
            status = client.request(Status())
        assert isinstance(status, StatusReply)
        assert status.fault == 0
        assert not status.state & (StateFlag.LAMPS_ARMED | StateFlag.MICROWAVE_ARMED | StateFlag.TURNTABLE_MOVING)
        assert {head.board.level(pin) for pin in (3, 4, 5, 6)} == {0}


def test_a_head_at_work_is_left_alone() -> None:
    stage = stage_from_us(
        ratio=0, period_us=20000, exposure_us=19000, readout_us=10000, projector_us=(0, 0), led_us=(2000, 1000)
    )
    with SimulatedHead(camera_fps=50.0) as head, Client(head.url) as client:
        for command in (stage, Commit(stage.generation), Arm(ArmFlag.LAMPS)):
            client.request(command)
        with pytest.raises(AnnulusError, match="the head is at work"):
            run_selftest(head.url, name="", edges=20, move_wire=lambda _: False)


def test_a_firmware_that_cannot_measure_is_told_so_in_one_line() -> None:
    head = ScriptedHead()
    head.controller._decoder = Decoder({id_: kind for id_, kind in TO_CONTROLLER.items() if kind.SINCE == 1})
    with pytest.raises(AnnulusError, match="this firmware cannot measure itself"):
        run_selftest(head.url, name=head.url, edges=20, move_wire=lambda _: False)
    head.close()
