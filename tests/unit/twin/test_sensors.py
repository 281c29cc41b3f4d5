"""The head's own sensors in virtual time: what they say is the world's truth, their noise, and what the lamps drew."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.controller import PIN_LED, PIN_PROJECTOR
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.twin.cable import Cable
from annulus_pipe.twin.faults import NO_FAULTS, Faults
from annulus_pipe.twin.image_sensor import HostClock
from annulus_pipe.twin.profiles import load_faults
from annulus_pipe.twin.sensors import HeadSensors, Imu, Supply
from annulus_pipe.twin.worlds import World, demo_world
from annulus_pipe.vocabulary import AnnulusError

S = 100_000_000  # ticks
WORLD = replace(demo_world(), roll_deg=8.0)
CLOCK = HostClock(4_000_000_000_000, 30.0)
SPEED_MM_S = 60.0


def sensors(world: World = WORLD, faults: Faults = NO_FAULTS, seed: int = 3, speed: float = SPEED_MM_S) -> HeadSensors:
    return HeadSensors(world, Cable(world.travel_mm, 0.05, 0, speed), CLOCK, faults, seed=seed)


def of(name: str, samples: Sequence[Sample]) -> list[Sample]:
    return [sample for sample in samples if sample.sensor == name]


def test_roll_is_that_of_the_pose_the_frames_are_drawn_with() -> None:
    heard = of("imu", sensors().samples(5 * S))
    assert len(heard) == 500
    true = np.degrees([WORLD.pose(SPEED_MM_S * 0.01 * k).roll or 0.0 for k in range(501)])
    assert true.max() > 7.9 and true.min() < -7.9
    error = np.array([s.values["roll_deg"] for s in heard]) - true[1:]
    assert np.sqrt((error**2).mean()) < 1.15 * Imu.ROLL_DEG and abs(error.mean()) < 0.01
    rate_error = np.array([s.values["roll_rate_deg_s"] for s in heard]) - np.diff(true) / 0.01
    assert np.sqrt((rate_error**2).mean()) < 1.15 * Imu.RATE_DEG_S
    late_ns = [s.host_ns - CLOCK.ns((k + 1) * S // 100) for k, s in enumerate(heard)]
    assert min(late_ns) >= 0 and max(late_ns) < 500_000


def test_gravity_tells_the_same_roll_and_a_head_that_slides_shakes() -> None:
    world = replace(WORLD, wobble_deg=0.0)
    moving, still = (of("imu", sensors(world, speed=speed).samples(5 * S)) for speed in (SPEED_MM_S, 0.0))
    x, y = (np.array([s.values[name] for s in moving]) for name in ("x_m_s2", "y_m_s2"))
    roll = np.array([s.values["roll_deg"] for s in moving])
    by_gravity = np.degrees(np.arctan2(x, -y))
    sign = np.sign((by_gravity * roll).sum())
    assert np.abs(sign * by_gravity - roll).mean() < 1.5  # 0.24 m/s2 of shaking
    lengths = [np.linalg.norm([s.values[f"{a}_m_s2"] for a in "xyz"]) for s in still]
    assert np.mean(lengths) == pytest.approx(9.81, abs=0.01)
    assert np.std(x) > 5 * np.std([s.values["x_m_s2"] for s in still])


def test_the_supply_carries_what_the_gates_let_the_lamps_draw() -> None:
    pins = [(t * S // 10 + 1000, PIN_PROJECTOR, 1) for t in range(10, 20)]
    pins += [(t * S // 10 + 1000 + S // 50, PIN_PROJECTOR, 0) for t in range(10, 20)]  # 20 of 100 ms
    pins += [(25 * S // 10, PIN_LED, 1)]  # and stays on
    heard = of("supply", sensors().samples(4 * S, sorted(pins)))
    assert len(heard) == 40
    current = np.array([s.values["current_a"] for s in heard])
    idle = Supply.IDLE_A
    assert current[:9] == pytest.approx(idle, abs=0.004)
    assert current[10:19] == pytest.approx(idle + 0.2 * Supply.LAMPS_A[PIN_PROJECTOR], abs=0.004)
    assert current[26:] == pytest.approx(idle + Supply.LAMPS_A[PIN_LED], abs=0.004)
    voltage = np.array([s.values["voltage_v"] for s in heard])
    assert voltage == pytest.approx(Supply.SOURCE_V - Supply.CABLE_OHM * current, abs=0.008)
    warm = [s.values["temperature_c"] for s in heard]
    assert np.mean(warm[-5:]) > np.mean(warm[:5])
    assert set(heard[0].units.items()) == {("voltage_v", "V"), ("current_a", "A"), ("temperature_c", "degC")}


def test_the_same_samples_whatever_the_steps_and_others_from_another_seed() -> None:
    pins = [(S // 3, PIN_LED, 1), (S // 2, PIN_LED, 0), (S, PIN_PROJECTOR, 1)]
    whole = sensors().samples(2 * S, pins)
    stepped, ours = [], sensors()
    for until in range(0, 2 * S + 1, S // 40):
        stepped += ours.samples(until, [p for p in pins if until - S // 40 < p[0] <= until])
    assert stepped == whole
    assert [s.values for s in sensors(seed=4).samples(2 * S, pins)] != [s.values for s in whole]
    times = [s.host_ns for s in whole]
    assert times == sorted(times) and times[0] > CLOCK.start_ns


def test_a_sensor_that_falls_silent_comes_back() -> None:
    heard = sensors(faults=Faults(sensors_silent=(("imu", 1.0, 0.5),))).samples(3 * S)
    since_s = [(s.host_ns - CLOCK.start_ns) * 1e-9 for s in of("imu", heard)]
    assert not [t for t in since_s if 1.0 <= t < 1.5] and len(since_s) == 250
    assert len(of("supply", heard)) == 30
    with pytest.raises(AnnulusError, match="sensor 'sonar': expected one of imu, supply"):
        sensors(faults=Faults(sensors_silent=(("sonar", 1.0, 0.5),)))


def test_silences_are_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "faults.toml"
    path.write_text('frames_dropped = 0.01\nsensors_silent = [["imu", 5.0, 2.0]]\n')
    assert load_faults(path) == Faults(frames_dropped=0.01, sensors_silent=(("imu", 5.0, 2.0),))
    path.write_text('sensors_silent = [["imu", -5.0, 2.0]]\n')
    with pytest.raises(AnnulusError, match="sensors_silent"):
        load_faults(path)
