"""The camera's clockwork against hand-made gate pins: what the firmware does not fire is not in the picture."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.controller import PIN_LED, PIN_ODOMETER_A, PIN_ODOMETER_B, PIN_PROJECTOR, PIN_SYNC, TICKS_PER_US
from annulus_pipe.twin.faults import Faults, LossyLine
from annulus_pipe.twin.image_sensor import Exposure, HostClock, ImageSensor
from annulus_pipe.twin.profiles import load_faults
from annulus_pipe.twin.worlds import World, clean_world
from annulus_pipe.vocabulary import AnnulusError, Lamp

TIMING = FrameTiming(25.0, 38_000.0, 28_000.0)  # window 2..12 ms after the edge
WORLD = clean_world(travel_mm=50.0).scaled(104)


def flashes(sensor: ImageSensor, frame: int, pin: int, delay_us: float, width_us: float) -> list[tuple[int, int, int]]:
    on = sensor.edge(frame) + round(delay_us * TICKS_PER_US)
    return [(on, pin, 1), (on + round(width_us * TICKS_PER_US), pin, 0)]


def expose(sensor: ImageSensor, pins: list[tuple[int, int, int]], frames: int) -> list[Exposure]:
    return sensor.exposures(sensor.edge(frames - 1), pins)


def test_a_flash_after_edge_k_lights_every_row_of_frame_k_plus_1_and_no_other() -> None:
    sensor = ImageSensor(WORLD, TIMING)
    pins = flashes(sensor, 2, PIN_PROJECTOR, 3000, 5000) + flashes(sensor, 4, PIN_LED, 2500, 2500)
    lit = [exposure.lamps for exposure in expose(sensor, pins, 7)]
    assert lit == [
        frozenset({Lamp.PROJECTOR}) if n == 3 else frozenset({Lamp.LED}) if n == 5 else frozenset() for n in range(7)
    ]
    frame = expose(ImageSensor(WORLD, TIMING), pins, 7)[3]
    np.testing.assert_allclose(frame.projector, 1.0)
    assert not frame.led.any()


def test_a_flash_too_early_leaves_the_last_rows_dark_and_one_too_late_cuts_the_first() -> None:
    sensor = ImageSensor(WORLD, TIMING)
    early = expose(sensor, flashes(sensor, 0, PIN_PROJECTOR, 0, 2000), 2)
    # the last row opens 2 ms after the edge, the first 28 ms before it: of 0..2 ms row r sees what it is open for
    rows = np.linspace(0, 1, WORLD.camera.height)
    opens_ms = np.maximum(-26.0 + 28.0 * rows, 0.0)
    np.testing.assert_allclose(early[1].projector, (2.0 - opens_ms) / 5.0, atol=3e-6)
    sensor = ImageSensor(WORLD, TIMING)
    late = expose(sensor, flashes(sensor, 0, PIN_PROJECTOR, 11_000, 3000), 3)
    assert late[1].projector[0] == pytest.approx(1.0 / 5.0)
    assert late[1].projector[-1] == pytest.approx(3.0 / 5.0)
    assert not late[2].projector.any()  # its first row opens 14 ms after the edge, when the flash is over
    sensor = ImageSensor(WORLD, TIMING)
    later = expose(sensor, flashes(sensor, 0, PIN_PROJECTOR, 15_000, 5000), 3)
    assert later[1].projector[0] == 0 and later[1].projector[-1] == pytest.approx(1.0)
    assert (
        later[2].projector[0] == pytest.approx(1.0) and later[2].projector[-1] == 0
    )  # half of each: two banded frames


def test_a_lamp_that_never_goes_off_lights_every_row_for_its_whole_exposure() -> None:
    sensor = ImageSensor(WORLD, TIMING)
    frames = expose(sensor, [(10, PIN_LED, 1)], 4)
    np.testing.assert_allclose(frames[3].led, 38_000 / WORLD.led.nominal_us)


def test_sync_rises_at_the_first_line_and_falls_at_the_end_of_the_last() -> None:
    sensor = ImageSensor(WORLD, TIMING)
    sync = [(tick, level) for tick, pin, level in sensor.stimuli(sensor.edge(2)) if pin == PIN_SYNC]
    assert sync == [(0, 0)] + [
        pulse for n in range(3) for pulse in ((sensor.edge(n) - 2_800_000, 1), (sensor.edge(n), 0))
    ]


def test_stimuli_are_the_same_however_finely_they_are_asked_for() -> None:
    whole = ImageSensor(WORLD, TIMING, speed_mm_s=60.0, seed=4)
    fine = ImageSensor(WORLD, TIMING, speed_mm_s=60.0, seed=4)
    end = whole.edge(9)
    in_one = whole.stimuli(end)
    in_bits = [s for until in [*range(0, end, 77_777), end] for s in fine.stimuli(until)]
    assert sorted(in_one) == sorted(in_bits)


def counts(stimuli: Iterator[tuple[int, int, int]] | list[tuple[int, int, int]]) -> int:
    """A quadrature decoder: four counts a cycle, A before B counts up."""
    a = b = count = 0
    for _, pin, level in stimuli:
        if pin == PIN_ODOMETER_A and level != a:
            count += 1 if (level != b) else -1
            a = level
        elif pin == PIN_ODOMETER_B and level != b:
            count += 1 if (level == a) else -1
            b = level
    return count


@pytest.mark.parametrize("speed", [12.5, 60.0])
def test_the_cable_counter_says_where_the_head_is(speed: float) -> None:
    sensor = ImageSensor(WORLD, TIMING, speed_mm_s=speed)
    told = sensor.stimuli(sensor.edge(19))
    assert counts(told) * WORLD.mm_per_count == pytest.approx(
        sensor.cable.z_mm(sensor.edge(19)), abs=WORLD.mm_per_count
    )


def test_the_head_waits_moves_back_and_forth_and_stops_at_the_end() -> None:
    sensor = ImageSensor(WORLD, TIMING)
    told = sensor.stimuli(sensor.edge(4))
    assert counts(told) == 0
    for frame, speed in ((5, 100.0), (15, -40.0), (20, 100.0)):
        sensor.pull(sensor.edge(frame), speed)
    told += sensor.stimuli(sensor.edge(19))
    middle = counts(told) * WORLD.mm_per_count
    assert middle == pytest.approx(40.0 - 0.04 * 4 * 40.0, abs=1e-6)
    told += sensor.stimuli(sensor.edge(60))
    assert counts(told) * WORLD.mm_per_count == pytest.approx(50.0, abs=0.06)


def test_a_frame_knows_where_the_head_was_when_its_light_came() -> None:
    sensor = ImageSensor(WORLD, TIMING, speed_mm_s=50.0)
    frame = expose(sensor, flashes(sensor, 4, PIN_LED, 3000, 2000), 6)[5]
    assert frame.z_mm == pytest.approx(50.0 * (5 * 0.040 + 0.004), abs=1e-6)
    assert frame.pose == WORLD.pose(frame.z_mm)


def test_timestamps_follow_the_edge_with_offset_drift_and_seeded_jitter() -> None:
    clock = HostClock(start_ns=1_000_000_000, drift_ppm=40.0)
    quiet = expose(ImageSensor(WORLD, TIMING, clock=clock), [], 2000)
    assert quiet[0].timestamp_ns == clock.ns(quiet[0].edge_tick - 2_800_000)
    assert abs(clock.tick(clock.ns(123_456_789_000)) - 123_456_789_000) <= 1
    assert clock.ns(100_000_000) == 1_000_000_000 + round(1e9 / (1 + 40e-6))
    faults = Faults(timestamp_jitter_us=2000.0)
    shaky = expose(ImageSensor(WORLD, TIMING, faults, clock=clock, seed=3), [], 2000)
    late_us = np.array([b.timestamp_ns - a.timestamp_ns for a, b in zip(quiet, shaky, strict=True)]) / 1e3
    assert 1850 < late_us.std() < 2150 and abs(late_us.mean()) < 130
    again = expose(ImageSensor(WORLD, TIMING, faults, clock=clock, seed=3), [], 2000)
    assert [e.timestamp_ns for e in again] == [e.timestamp_ns for e in shaky]


def test_dropped_frames_leave_holes_in_the_sequence_at_the_rate_asked_for() -> None:
    frames = expose(ImageSensor(WORLD, TIMING, Faults(frames_dropped=0.05), seed=8), [], 2000)
    assert [f.sequence for f in frames] == list(range(2000))
    assert 70 < sum(f.dropped for f in frames) < 130


def test_missing_and_doubled_edges_come_at_the_rate_asked_for() -> None:
    sensor = ImageSensor(WORLD, TIMING, Faults(sync_missing=0.1, sync_glitches=0.1), seed=2)
    falls = [s for s in sensor.stimuli(sensor.edge(999)) if s[1:] == (PIN_SYNC, 0)]
    regular = {sensor.edge(n) for n in range(1000)}
    assert 70 < len(regular - {tick for tick, _, _ in falls}) < 130
    assert 70 < len([tick for tick, _, _ in falls if tick not in regular]) < 130


def test_the_lossy_line_loses_whole_events_only() -> None:
    reply, event = bytes([3, 0x42, 7, 2, 9, 0]), bytes([4, 0x80, 1, 1, 2, 5, 0])
    stream = (reply + event) * 2000
    line = LossyLine(Faults(events_lost=0.1), seed=5)
    rng = np.random.default_rng(0)
    cuts = np.sort(rng.integers(0, len(stream), 700))
    out = b"".join(line.carry(stream[a:b]) for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True))
    assert out.count(reply) == 2000
    assert out.count(event) == 2000 - line.events_lost
    assert len(out) == len(stream) - line.events_lost * len(event)
    assert 150 < line.events_lost < 250


def test_faults_load_by_name_and_from_toml_and_say_what_is_wrong(tmp_path: Path) -> None:
    assert load_faults(None) == Faults()
    assert load_faults("standard").frames_dropped == 0.01
    file = tmp_path / "faults.toml"
    file.write_text("frames_dropped = 0.2\nresets = [10, 20]\n")
    assert load_faults(file) == Faults(frames_dropped=0.2, resets=(10, 20))
    for text, word in (
        ("frames_dropped = 2.0", "frames_dropped"),
        ("gremlins = 1", "gremlins"),
        ("= 3", "TOML"),
        ("resets = ['a']", "resets"),
    ):
        file.write_text(text)
        with pytest.raises(AnnulusError, match=word):
            load_faults(file)
    with pytest.raises(AnnulusError, match="no such fault file"):
        load_faults(tmp_path / "none.toml")


def test_a_scaled_world_sees_the_same_field() -> None:
    big = clean_world()
    small: World = big.scaled(416)
    ray = small.camera.rays(np.array([[-0.5, -0.5]]))
    np.testing.assert_allclose(ray, big.camera.rays(np.array([[-0.5, -0.5]])), atol=1e-12)
    assert replace(small, camera=big.camera, optics=big.optics) == big
