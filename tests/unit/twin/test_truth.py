"""Promises of the judge: what it calls wrong is wrong, and what it calls right was lit by that lamp at that place."""

from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.twin.cable import Cable
from annulus_pipe.twin.driver import Delivered, PicturePart
from annulus_pipe.twin.image_sensor import Exposure
from annulus_pipe.twin.truth import LabelVerdict, Relock, Truth, relocks
from annulus_pipe.twin.worlds import clean_world
from annulus_pipe.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Label, Lamp, Slot, Tick

PERIOD = 4_000_000
WORLD = clean_world()
ALL, NONE = np.ones(8, np.float32), np.zeros(8, np.float32)
BOOTED = 1000


def exposure(number: int, z_mm: float = 10.0, lamp: Lamp = Lamp.PROJECTOR) -> Exposure:
    """Lit by the flash of edge `number`."""
    rows = (ALL, NONE) if lamp is Lamp.PROJECTOR else (NONE, ALL)
    return Exposure(CameraSequence(number), BOOTED + (number + 1) * PERIOD, 0, z_mm, WORLD, *rows, dropped=False)


def delivered(*parts: PicturePart) -> Delivered:
    return Delivered(int(parts[0].exposure.sequence), CameraSequence(0), 0, 0, parts)


def whole(number: int, z_mm: float = 10.0, lamp: Lamp = Lamp.PROJECTOR) -> Delivered:
    return delivered(PicturePart(exposure(number, z_mm, lamp), 0.0, 1.0))


def header(edge: int, z_mm: float = 10.0, label: Label = Label.PROJECTOR) -> FrameHeader:
    return FrameHeader(0, None, 0, label, "", EdgeIndex(edge), None, 200, z_mm, "bayer_rggb8", 8, 8)


def flash(edge: int, boot: int = 7) -> Flash:
    return Flash(EdgeIndex(edge), Tick(edge * PERIOD), Slot(0), Lamp.PROJECTOR, 0, 0, 200, 1, boot, EdgeFlag(0))


@pytest.fixture
def truth() -> Truth:
    judge = Truth(PERIOD, 0.05, Cable(400.0, 0.05, 0, 2.0))
    judge.life(BOOTED, 7)
    for edge in range(1, 30):
        judge.heard(flash(edge), 10**9)
    return judge


def test_the_lamp_and_the_edge_that_lit_a_frame_are_right(truth: Truth) -> None:
    assert truth.verdict(header(9), whole(9)) is LabelVerdict.RIGHT
    assert truth.verdict(header(9, label=Label.UNKNOWN), whole(9)) is LabelVerdict.UNKNOWN


def test_another_lamp_in_any_row_is_a_wrong_lamp(truth: Truth) -> None:
    assert truth.verdict(header(9, label=Label.LED), whole(9)) is LabelVerdict.WRONG_LAMP
    torn = delivered(PicturePart(exposure(9), 0.0, 0.8), PicturePart(exposure(8, lamp=Lamp.LED), 0.8, 1.0))
    assert truth.verdict(header(9), torn) is LabelVerdict.WRONG_LAMP
    cut = replace(exposure(9), projector=np.array([1, 1, 1, 1, 1, 1, 1, 0.5], np.float32))
    assert truth.verdict(header(9), delivered(PicturePart(cut, 0.0, 1.0))) is LabelVerdict.WRONG_LAMP


def test_another_edge_or_another_z_is_a_wrong_place(truth: Truth) -> None:
    assert truth.verdict(header(14), whole(9)) is LabelVerdict.WRONG_PLACE
    assert truth.verdict(header(9, z_mm=10.14), whole(9)) is LabelVerdict.RIGHT
    assert truth.verdict(header(9, z_mm=10.16), whole(9)) is LabelVerdict.WRONG_PLACE
    far, near = (replace(header(9, z_mm=z), z_assumed=True, z_bound_mm=50.0) for z in (4797.0, 59.0))
    assert truth.verdict(far, whole(9)) is LabelVerdict.WRONG_PLACE, "the bound that was told did not hold"
    assert truth.verdict(near, whole(9)) is LabelVerdict.RIGHT
    assert (truth.assumed, truth.assumed_error_mm, truth.beyond_bound) == (2, 4787.0, 1)


def test_a_tear_between_two_frames_of_one_lamp_is_a_wrong_place_when_the_head_has_moved(truth: Truth) -> None:
    still = delivered(PicturePart(exposure(9), 0.0, 0.5), PicturePart(exposure(8, z_mm=9.95), 0.5, 1.0))
    moved = delivered(PicturePart(exposure(9), 0.0, 0.5), PicturePart(exposure(8, z_mm=9.5), 0.5, 1.0))
    assert truth.verdict(header(9), still) is LabelVerdict.RIGHT
    assert truth.verdict(header(9), moved) is LabelVerdict.WRONG_PLACE


def test_an_edge_of_another_life_is_a_wrong_place_though_its_number_and_boot_byte_are_the_same(truth: Truth) -> None:
    began = BOOTED + 20 * PERIOD + PERIOD // 2
    truth.life(began, 7)
    lit = replace(exposure(23), edge_tick=began + 10 * PERIOD)  # by edge 9 of the second life
    truth.heard(flash(9), began + 11 * PERIOD)
    assert truth.verdict(header(9), delivered(PicturePart(lit, 0.0, 1.0))) is LabelVerdict.RIGHT
    assert truth.verdict(header(23), delivered(PicturePart(lit, 0.0, 1.0))) is LabelVerdict.WRONG_PLACE


def test_z_is_judged_from_where_it_was_said_to_be_zero(truth: Truth) -> None:
    at = BOOTED + 5 * PERIOD
    truth.zeroed(at)
    assert truth.verdict(header(9, z_mm=10.0), whole(9)) is LabelVerdict.WRONG_PLACE
    assert truth.verdict(header(9, z_mm=10.0 - at * 2.0 * 1e-8), whole(9)) is LabelVerdict.RIGHT
    assert truth.verdict(header(3, z_mm=10.0), whole(3)) is LabelVerdict.RIGHT  # lit before


def test_a_relock_counts_from_the_end_of_the_disturbance_to_the_next_right_label() -> None:
    found = relocks([("drop", 10), ("drop", 20)], [9, 10, 23, 24], 30)
    assert found == [Relock("drop", 10, 1, 1), Relock("drop", 20, 4, 4)]
    assert relocks([("reset", 100)], [9], 200) == [Relock("reset", 100, 100, 100)]  # never: everything that was left


def test_where_disturbances_mix_a_relock_counts_from_the_end_of_the_last_and_tells_the_whole() -> None:
    found = relocks([("step", 10), ("late", 18), ("drop", 22)], [9, 21, 22], 30)
    assert found == [Relock("step", 10, 12, 4), Relock("late", 18, 4, 4), Relock("drop", 22, 1, 1)]
