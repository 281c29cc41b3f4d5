"""Promises about how far along the pipe."""

import pytest

from annulus.daemon.odometer import Odometer
from annulus.vocabulary import EdgeFlag, EdgeIndex, Flash, Lamp, Slot, Tick


def flash(odometer: int, boot: int = 1) -> Flash:
    return Flash(EdgeIndex(0), Tick(0), Slot(0), Lamp.PROJECTOR, 1, 1, odometer, 1, boot, EdgeFlag(0))


def test_counts_become_millimetres_forwards_and_backwards() -> None:
    place = Odometer(-0.05)
    assert [place.z_mm(flash(-20 * i), i) for i in (0, 1, 2, 1)] == pytest.approx([0.0, 1.0, 2.0, 1.0])
    assert place.gaps == 0


def test_a_restart_of_the_controller_does_not_send_the_head_back_to_the_start() -> None:
    place, speed = Odometer(0.05), 22.0  # mm/s
    for i in range(50):
        z = place.z_mm(flash(round(speed * i / 25 / 0.05)), i * 40_000_000)
    lost_s = 0.5  # from the last frame before to the first one after
    after = place.z_mm(flash(3, boot=2), round((49 / 25 + lost_s) * 1e9))
    assert after == pytest.approx(z + speed * lost_s, abs=0.1)
    assert place.z_mm(flash(23, boot=2), round((50 / 25 + lost_s) * 1e9)) == pytest.approx(after + 1.0)
    assert place.gaps == 1


def test_a_restart_after_the_first_frame_stands_still() -> None:
    place = Odometer(0.05)
    assert place.z_mm(flash(100), 0) == 5.0
    assert place.z_mm(flash(0, boot=9), 10**9) == 5.0
