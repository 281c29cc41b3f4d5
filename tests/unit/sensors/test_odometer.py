"""Promises about how far along the pipe."""

import pytest

from annulus.sensors.odometer import EXPECT_NS, SAMPLE_NS, Odometer
from annulus.vocabulary import EdgeFlag, EdgeIndex, Flash, Lamp, Slot, Tick

PERIOD = 40_000_000


def flash(odometer: int, boot: int = 1, edge: int = 0) -> Flash:
    return Flash(EdgeIndex(edge), Tick(0), Slot(0), Lamp.PROJECTOR, 1, 1, odometer, 1, boot, EdgeFlag(0))


def hear(place: Odometer, one: Flash, host_ns: int) -> float:
    place.edge(one, host_ns)
    z = place.z_mm(one)
    assert z is not None
    return z


def test_counts_become_millimetres_forwards_and_backwards() -> None:
    place = Odometer(-0.05)
    zs = [hear(place, flash(-20 * count, edge=i), i) for i, count in enumerate((0, 1, 2, 1))]
    assert zs == pytest.approx([0.0, 1.0, 2.0, 1.0])
    assert place.gaps == 0 and place.here_mm == pytest.approx(1.0)


def test_a_restart_of_the_controller_does_not_send_the_head_back_to_the_start() -> None:
    place, speed = Odometer(0.05), 22.0  # mm/s
    for i in range(50):
        z = hear(place, flash(round(speed * i / 25 / 0.05), edge=i), i * PERIOD)
    lost_s = 0.5  # from the last edge before to the first one after
    after = hear(place, flash(3, boot=2), round((49 / 25 + lost_s) * 1e9))
    assert after == pytest.approx(z + speed * lost_s)
    assert hear(place, flash(23, boot=2, edge=1), round((50 / 25 + lost_s) * 1e9)) == pytest.approx(after + 1.0)
    assert place.gaps == 1
    assert place.z_mm(flash(round(speed * 49 / 25 / 0.05), edge=49)) == z  # a frame of before that waited


def test_a_restart_after_the_first_edge_stands_still() -> None:
    place = Odometer(0.05)
    assert hear(place, flash(100), 0) == 5.0
    assert hear(place, flash(0, boot=9), 10**9) == 5.0


def test_a_head_that_was_not_heard_of_for_long_is_not_taken_to_have_gone_on_for_ever() -> None:
    place = Odometer(0.05)
    for i in range(50):
        z = hear(place, flash(20 * i, edge=i), i * PERIOD)
    assert hear(place, flash(0, boot=2), 3600 * 10**9) == pytest.approx(z + 25.0 * EXPECT_NS / 1e9)


def test_zeroed_at_the_next_edge_and_frames_lit_before_keep_their_place() -> None:
    place = Odometer(0.05)
    for i in range(10):
        hear(place, flash(20 * i, edge=i), i * PERIOD)
    place.zero()
    assert [hear(place, flash(20 * i, edge=i), i * PERIOD) for i in (10, 11)] == pytest.approx([0.0, 1.0])
    assert place.zeroed_mm == pytest.approx(10.0) and place.gaps == 0
    assert place.z_mm(flash(20 * 9, edge=9)) == pytest.approx(9.0)
    after = hear(place, flash(0, boot=2), 12 * PERIOD)  # and a restart goes on from there
    assert after == pytest.approx(2.0)


def test_an_edge_that_was_read_again_places_its_frame_and_moves_nothing() -> None:
    place = Odometer(0.05)
    for i in (0, 1, 3):
        hear(place, flash(20 * i, edge=i), i * PERIOD)
    assert hear(place, flash(40, edge=2), 2 * PERIOD) == pytest.approx(2.0)
    assert place.here_mm == pytest.approx(3.0)
    assert place.z_mm(flash(0, boot=7)) is None


def test_it_is_a_sensor_at_a_modest_rate() -> None:
    place = Odometer(0.05)
    for i in range(51):
        hear(place, flash(20 * i, edge=i), i * PERIOD)
    samples = place.poll()
    assert len(samples) == 50 * PERIOD // SAMPLE_NS + 1 and place.poll() == []
    assert samples[1].values == {"counts": 100.0, "z_mm": pytest.approx(5.0)}
    assert samples[1].units == {"counts": "counts", "z_mm": "mm"}
