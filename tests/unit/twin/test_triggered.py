"""A camera that takes a trigger exposes with it, and is not there without one."""

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.controller import PIN_CAMERA_TRIGGER, PIN_LED
from annulus_pipe.link.pins import AS_WIRED
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.triggered import sensor_of
from annulus_pipe.twin.worlds import clean_world

MS = 100_000
TIMING = FrameTiming(25.0, 20_000.0, 14_300.0)
XTRIG = AS_WIRED.triggering("xtrig", 19_985.74)


def low(at: int, width: int = 1_998_574) -> list[tuple[int, int, int]]:
    return [(at, PIN_CAMERA_TRIGGER, 0), (at + width, PIN_CAMERA_TRIGGER, 1)]


def test_a_frame_exposes_while_xtrig_is_low_and_14_26_us_more_and_its_readout_follows() -> None:
    sensor = sensor_of(clean_world().scaled(104), TIMING, trigger="xtrig", pins=XTRIG)
    assert sensor.exposures(100 * MS) == [], "no trigger, no frame"
    at = 200 * MS
    inside = [(at + 5 * MS, PIN_LED, 1), (at + 6 * MS, PIN_LED, 0)]
    after = [(at + 1_998_574 + 1426, PIN_LED, 1), (at + 21 * MS, PIN_LED, 0)]
    (frame,) = sensor.exposures(at + 30 * MS, sorted([*low(at), *inside, *after]))
    assert frame.edge_tick == at + 1_998_574 and frame.reads_out == 1426 + 1_430_000
    assert set(frame.led * sensor.world.led.nominal_us) == {1000.0}, "all rows, and nothing of what came after"
    assert frame.timestamp_ns == (at + 1_998_574 + 1426) * 10


def test_a_trigger_that_comes_during_the_readout_or_is_missed_makes_no_frame_and_no_number() -> None:
    sensor = sensor_of(clean_world().scaled(104), TIMING, trigger="xtrig", pins=XTRIG)
    triggers = low(20 * MS) + low(42 * MS) + low(80 * MS)
    frames = sensor.exposures(200 * MS, triggers)
    assert [frame.edge_tick // MS for frame in frames] == [39, 99]
    assert [int(frame.sequence) - frame.missed for frame in frames] == [0, 1]
    deaf = sensor_of(clean_world().scaled(104), TIMING, Faults(sync_missing=1.0), trigger="xtrig", pins=XTRIG)
    assert deaf.exposures(200 * MS, triggers) == []
