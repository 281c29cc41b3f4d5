"""The soak is an honest judge: nothing wrong where labels are sound, and every frame in its account."""

from dataclasses import replace

import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.labelling.labelling import FrameSeen, Labelling
from annulus_pipe.link.pins import pins_of
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.soak import soak
from annulus_pipe.vocabulary import AnnulusError, Slot


def test_no_label_is_wrong_under_drops_lost_events_jitter_and_two_resets() -> None:
    result = soak(300, seed=5)
    assert result["wrong"] == 0
    assert result["relock_frames_max"] <= 5
    assert result["unknown"] - result["unlit"] <= 15 and result["led"] >= 45 and result["projector"] >= 200
    assert sum(result[key] for key in ("projector", "led", "unknown", "dropped")) == 300
    assert result["disturbances"]["reset"] == 2 and result["link"]["reboots"] == 2
    assert not any(result["board_lost"].values())


def test_no_label_is_wrong_on_a_rough_line_with_missing_and_doubled_sync_edges() -> None:
    faults = Faults(0.03, 0.03, 3e-4, 3000.0, 0.01, 0.01, resets=(150,))
    result = soak(250, seed=6, faults=faults)
    assert result["wrong"] == 0
    assert result["projector"] > 120


@pytest.mark.deep(
    gate="tests/unit/twin/test_soak.py::test_no_label_is_wrong_on_a_rough_line_with_missing_and_doubled_sync_edges"
)
def test_a_soak_of_several_worlds_is_the_same_on_any_number_of_processes() -> None:
    alone, shared = (soak(240, seed=2, faults="rough", jobs=jobs, world_frames=120) for jobs in (1, 2))
    assert alone.pop("seconds") and shared.pop("seconds")
    assert alone == shared and alone["worlds"] == 2


def test_what_a_soak_cannot_run_is_refused() -> None:
    with pytest.raises(AnnulusError, match="expected 100 or more"):
        soak(50)
    with pytest.raises(AnnulusError, match="no such fault file"):
        soak(100, faults="bad-luck")


@pytest.mark.parametrize("command", ["soak", "run"])
@pytest.mark.parametrize("wrong", ["--trigger=maybe", "--inverted=led,led", "--inverted=interlock"])
def test_wiring_that_nothing_takes_is_refused(command: str, wrong: str) -> None:
    done = CliRunner().invoke(app, ["twin", command, wrong])
    assert isinstance(done.exception, AnnulusError) and "expected" in str(done.exception)


def test_no_label_is_wrong_where_lamps_are_active_low_and_the_sync_rises() -> None:
    result = soak(250, seed=5, faults="rough", pins=pins_of("sync,projector,led"))
    assert result["wrong"] == 0 and result["projector"] > 100 and result["led"] > 20


SLIDES = Faults(0.02, 0.01, 1e-4, 1000.0, 0.01, 0.005, resets=(180,), disconnects=((260, 400.0),), stalls=((320, 0.6),))


@pytest.mark.parametrize("seed", [2, 5])
def test_no_slot_is_wrong_where_slides_are_lit_in_turn(seed: int) -> None:
    """Of a camera that sees a quarter of them: dropped frames, lost edges, a restart, a line and a host held up."""
    result = soak(450, seed, faults=SLIDES, head="fringe-modules")
    assert (result["wrong"], result["wrong_slots"]) == (0, 0)
    assert result["projector"] > 200 and result["led"] > 50
    assert {"reset", "disconnect", "stall", "dropped"} <= set(result["disturbances"])


def test_a_slot_that_is_off_by_one_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    right = Labelling.header

    def off(self: Labelling, frame: FrameSeen) -> FrameHeader:
        header = right(self, frame)
        return header if header.slot is None else replace(header, slot=Slot((header.slot + 1) % 5))

    monkeypatch.setattr(Labelling, "header", off)
    result = soak(150, 3, faults="none", head="fringe-modules")
    assert result["wrong_slots"] > 30 and result["wrong"] == result["wrong_slots"]


@pytest.mark.deep(gate="tests/unit/twin/test_soak.py::test_no_slot_is_wrong_where_slides_are_lit_in_turn")
@pytest.mark.parametrize("faults", ["all", "rough"])
def test_no_slot_is_wrong_in_twenty_thousand_frames(faults: str) -> None:
    result = soak(20_000, 12, faults=faults, head="fringe-modules", world_frames=2500, jobs=None)
    assert (result["wrong"], result["wrong_slots"], result["untold"]) == (0, 0, 0)
    assert result["projector"] > 12_000


@pytest.mark.parametrize("trigger", ["xtrig", "xtrig_on_sync"])
def test_no_label_is_wrong_where_the_controller_triggers_a_camera_that_misses_some(trigger: str) -> None:
    result = soak(250, seed=6, faults=Faults(sync_missing=0.01, sync_glitches=0.01, resets=(120,)), trigger=trigger)
    assert result["wrong"] == 0 and result["projector"] > 100 and result["led"] > 20


def test_no_label_is_wrong_where_an_interrupt_sets_the_sync_some_tens_of_us_late() -> None:
    result = soak(250, seed=5, faults=Faults(sync_late_us=40.0, frames_dropped=0.02, resets=(120,)))
    assert result["wrong"] == 0 and result["projector"] > 100 and result["led"] > 20
    assert "irregular edge" not in result["reasons"] or result["reasons"]["irregular edge"] <= 4
