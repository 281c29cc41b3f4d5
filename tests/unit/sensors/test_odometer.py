"""Promises about how far along the pipe."""

from dataclasses import replace

import pytest

from annulus_pipe.sensors.odometer import EXPECT_NS, MAX_SPEED_MM_S, SAMPLE_NS, FlashPosition, Odometer
from annulus_pipe.vocabulary import EdgeFlag, EdgeIndex, Flash, Lamp, Slot, Tick

PERIOD = 40_000_000


def flash(odometer: int, epoch: int = 1, edge: int = 0, tick_s: float = 0.0) -> Flash:
    """Every boot has the same byte."""
    tick = Tick(round(tick_s * 1e8))
    return Flash(EdgeIndex(edge), tick, Slot(0), Lamp.PROJECTOR, 1, 1, odometer, 1, 7, EdgeFlag(0), epoch)


def hear(odometer: Odometer, one: Flash, host_ns: float, nonce: int | None = None) -> float:
    odometer.edge(one, round(host_ns), nonce)
    return placed(odometer, one).z_mm


def placed(odometer: Odometer, one: Flash) -> FlashPosition:
    place = odometer.place(one)
    assert place is not None
    return place


def travelled(mm_per_edge: float, edges: int = 50) -> Odometer:
    """A head that went so far between edges, and was last heard of at the end of edges - 1 periods."""
    odometer = Odometer(0.05)
    for i in range(edges):
        hear(odometer, flash(round(mm_per_edge * i / 0.05), edge=i), i * PERIOD)
    return odometer


def test_counts_become_millimetres_forwards_and_backwards() -> None:
    place = Odometer(-0.05)
    zs = [hear(place, flash(-20 * count, edge=i), i) for i, count in enumerate((0, 1, 2, 1))]
    assert zs == pytest.approx([0.0, 1.0, 2.0, 1.0])
    assert place.gaps == 0 and place.here_mm == pytest.approx(1.0)


def test_a_restart_of_the_controller_does_not_send_the_head_back_to_the_start() -> None:
    speed, lost_s, up_s = 22.0, 0.5, 0.2  # mm/s; from the last edge before to the reset; and to the first edge after
    place = travelled(speed / 25)
    z, last_s = place.here_mm, 49 / 25
    assert z is not None
    moved = round(speed * up_s / 0.05)
    after = hear(place, flash(moved, epoch=2, tick_s=up_s), (last_s + lost_s + up_s) * 1e9)
    assert after == pytest.approx(z + speed * (lost_s + up_s), abs=0.1)
    assert hear(place, flash(moved + 20, epoch=2, edge=1), (last_s + lost_s + 0.3) * 1e9) == pytest.approx(after + 1.0)
    assert place.gaps == 1
    assert placed(place, flash(round(speed * last_s / 0.05), edge=49)) == FlashPosition(pytest.approx(z), 0, 0.0)


def test_what_was_not_counted_is_assumed_and_bounded_and_told() -> None:
    place = travelled(1.0)
    hear(place, flash(0, epoch=2), 49 * PERIOD + 3.2e9)
    assumed = placed(place, flash(40, epoch=2, edge=2))
    assert assumed.assumed and assumed.segment == 1
    assert assumed.bound_mm == pytest.approx(3.2 * (MAX_SPEED_MM_S + 25.0))  # it may have been pulled back as fast
    assert place.gap is not None and place.gap.seconds == pytest.approx(3.2)
    assert str(place.gap) == (
        "the controller restarted; 3.2 s without odometer; z is assumed to go on at 129.0 mm (+- 1680 mm, from 49.0); "
        "zero it or mark the place"
    )
    assert not placed(place, flash(20 * 49, edge=49)).assumed  # a frame of before that waited


def test_a_second_gap_makes_the_first_ones_bound_no_narrower() -> None:
    place = travelled(0.0)
    hear(place, flash(0, epoch=2), 49 * PERIOD + 1e9)
    hear(place, flash(0, epoch=3), 49 * PERIOD + 3e9)
    assert place.here == FlashPosition(0.0, 2, pytest.approx(3 * MAX_SPEED_MM_S)) and place.gaps == 2


def test_zero_ends_the_assumption_and_begins_a_segment() -> None:
    place = travelled(1.0)
    hear(place, flash(0, epoch=2), 49 * PERIOD + 1e9)
    place.zero()
    hear(place, flash(20, epoch=2, edge=1), 50 * PERIOD + 1e9)
    assert place.here == FlashPosition(0.0, 2, 0.0)
    assert placed(place, flash(0, epoch=2)).assumed  # what was lit before stays what it was
    assert hear(place, flash(40, epoch=2, edge=2), 51 * PERIOD + 1e9) == pytest.approx(1.0)


@pytest.mark.parametrize("counts", [[0], [0] * 50, [i % 2 for i in range(50)]])
def test_a_head_at_rest_is_assumed_to_stay(counts: list[int]) -> None:
    place = Odometer(0.05)
    for i, count in enumerate(counts):
        z = hear(place, flash(100 + count, edge=i), i * PERIOD)
    assert hear(place, flash(0, epoch=9), 60e9) == z
    assert placed(place, flash(0, epoch=9)).bound_mm == pytest.approx(MAX_SPEED_MM_S * 60, rel=0.04)


def test_a_head_that_was_not_heard_of_for_long_is_not_taken_to_have_gone_on_for_ever() -> None:
    place = travelled(1.0)
    assert hear(place, flash(0, epoch=2), 3600e9) == pytest.approx(49.0 + 25.0 * EXPECT_NS / 1e9)
    assert placed(place, flash(0, epoch=2)).bound_mm > 3590 * MAX_SPEED_MM_S


def test_nothing_is_assumed_to_go_faster_than_the_winch() -> None:
    place = travelled(36.0)  # 900 mm/s
    assert hear(place, flash(0, epoch=2), 49 * PERIOD + 60e9) == pytest.approx(49 * 36.0 + MAX_SPEED_MM_S * 5)


def test_within_a_boot_z_is_counted_however_many_edges_are_lost() -> None:
    place = travelled(1.0)
    assert hear(place, flash(20 * 100_000, edge=100_000), 4000e9) == pytest.approx(100_000.0)
    assert place.here == FlashPosition(pytest.approx(100_000.0), 0, 0.0) and place.gaps == 0


def test_a_restart_that_was_none_costs_nothing() -> None:
    """The line said something impossible, the host took it for another boot, and the boot's own number says not so."""
    place = Odometer(0.05)
    for i in range(50):
        hear(place, flash(20 * i, edge=i), i * PERIOD, nonce=77)
    hear(place, flash(20 * 90, epoch=2, edge=90), 90 * PERIOD, nonce=77)
    assert place.here == FlashPosition(pytest.approx(90.0), 0, 0.0) and place.gaps == 0 and place.gap is None
    hear(place, flash(0, epoch=3), 100 * PERIOD, nonce=78)
    assert placed(place, flash(0, epoch=3)).assumed


def test_a_tick_from_before_the_gap_says_nothing_of_it() -> None:
    """A restart that was none, of a controller that does not tell its number: its count is not of the gap."""
    place = travelled(1.0)
    assert hear(place, flash(20 * 60, epoch=2, edge=60, tick_s=100.0), 49 * PERIOD + 1e9) == pytest.approx(74.0)
    assert placed(place, flash(20 * 60, epoch=2, edge=60)).bound_mm == pytest.approx(MAX_SPEED_MM_S + 25.0)


def test_counts_that_the_controller_lost_make_the_place_assumed_by_as_much() -> None:
    place = travelled(1.0)
    place.lost(10)
    assert place.here == FlashPosition(pytest.approx(49.0), 0, pytest.approx(0.5))
    place.lost(10)  # told again
    place.lost(14)
    hear(place, flash(1000, edge=50), 50 * PERIOD)
    assert place.here == FlashPosition(pytest.approx(50.0), 0, pytest.approx(0.7))
    assert not placed(place, flash(400, edge=20)).assumed  # long before


def test_what_a_measurement_kept_from_being_counted_is_a_gap() -> None:
    """The counts of its edges stand still while the head goes on: they used to be places like any other."""
    place = travelled(1.0)
    frozen = replace(flash(980, edge=50), flags=EdgeFlag.ODOMETER_FROZEN)
    place.edge(frozen, 50 * PERIOD)
    assert place.place(frozen) is None and place.gaps == 0
    after = flash(980, edge=60)
    assert hear(place, after, 60 * PERIOD) == pytest.approx(60.0, abs=0.1)  # gone on at 25 mm/s since edge 49
    assert placed(place, after).segment == 1 and placed(place, after).bound_mm > MAX_SPEED_MM_S * 11 * PERIOD / 1e9
    assert place.gaps == 1 and "measured its own pins" in str(place.gap)
    assert hear(place, flash(1000, edge=61), 61 * PERIOD) == pytest.approx(61.0, abs=0.1)
    place.edge(frozen, 50 * PERIOD)  # read again, late
    hear(place, flash(1020, edge=62), 62 * PERIOD)
    assert place.gaps == 1


def test_a_boot_that_was_first_heard_while_it_measured_counts_from_later_on() -> None:
    place = travelled(0.0)
    place.edge(replace(flash(0, epoch=2), flags=EdgeFlag.ODOMETER_FROZEN), 50 * PERIOD)
    assert placed(Odometer.recalled(place.remembered()), flash(0, edge=49)).segment == 0
    assert hear(place, flash(400, epoch=2, edge=1, tick_s=0.05), 51 * PERIOD) == pytest.approx(0.0)
    assert place.gaps == 1


def test_zeroed_at_the_next_edge_and_frames_lit_before_keep_their_place() -> None:
    place = Odometer(0.05)
    for i in range(10):
        hear(place, flash(20 * i, edge=i), i * PERIOD)
    place.zero()
    assert [hear(place, flash(20 * i, edge=i), i * PERIOD) for i in (10, 11)] == pytest.approx([0.0, 1.0])
    assert place.zeroed_mm == pytest.approx(10.0) and place.gaps == 0
    assert placed(place, flash(20 * 9, edge=9)).z_mm == pytest.approx(9.0)
    after = hear(place, flash(0, epoch=2), 12 * PERIOD)  # and a restart goes on from there
    assert after == pytest.approx(2.0)


def test_an_edge_that_was_read_again_places_its_frame_and_moves_nothing() -> None:
    place = Odometer(0.05)
    for i in (0, 1, 3):
        hear(place, flash(20 * i, edge=i), i * PERIOD)
    assert hear(place, flash(40, edge=2), 2 * PERIOD) == pytest.approx(2.0)
    assert place.here_mm == pytest.approx(3.0)
    assert place.place(flash(0, epoch=7)) is None


def test_it_is_a_sensor_at_a_modest_rate() -> None:
    place = Odometer(0.05)
    for i in range(51):
        hear(place, flash(20 * i, edge=i), i * PERIOD)
    samples = place.poll()
    assert len(samples) == 50 * PERIOD // SAMPLE_NS + 1 and place.poll() == []
    assert samples[1].values == {"counts": 100.0, "z_mm": pytest.approx(5.0)}
    assert samples[1].units == {"counts": "counts", "z_mm": "mm"}
