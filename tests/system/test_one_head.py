"""One head with all its senses at once: rings, LED, capacitive sectors, supply and attitude, and nothing lost.

The head's chips are registers on a simulated I2C bus; drivers, daemon, recorder and workers are the real ones.
"""

import resource
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.session import Session
from annulus_pipe.demo import demo_config
from annulus_pipe.hooks import sheets
from annulus_pipe.record.recording import open_recording
from annulus_pipe.reprocess import survey_of
from annulus_pipe.sensors.fdc2214 import Ads1115, Fdc2214, Tank
from annulus_pipe.sensors.i2c import I2cSensors
from annulus_pipe.sensors.imu import Mpu6050
from annulus_pipe.sensors.ina226 import Ina226, Rail
from annulus_pipe.twin.head import start_head
from annulus_pipe.twin.i2c_chips import HeadBus
from annulus_pipe.twin.worlds import demo_world
from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wings.crossbore.ground import Bore, Ground

pytestmark = [
    pytest.mark.alone,
    pytest.mark.deep(gate="tests/system/test_scan.py::test_a_scan_is_labelled_recorded_and_reconstructed"),
]

STALL_S = 0.25  # a machine that stood still for longer may lose frames, and counts them
FPS, SPEED_MM_S, TRAVEL_MM = 8.0, 120.0, 2300.0
WORLD = replace(demo_world(travel_mm=TRAVEL_MM + 200.0), wobble_mm=0.2).scaled(416)  # on skids: a frame every 15 mm
BORE_MM, RADIUS_MM = 1150.0, 76.0
GROUND = Ground(TRAVEL_MM + 400.0, bores=(Bore(BORE_MM, RADIUS_MM, angle_deg=90.0),), wander_mm=0.0)
CHIPS = ("capacitance", "supply", "imu")


class Listener(Observer):
    def __init__(self) -> None:
        self.told: list[tuple[str, str]] = []

    def event(self, kind: str, text: str) -> None:
        self.told.append((kind, text))


def test_rings_led_sectors_supply_and_attitude_at_once_and_nothing_lost(tmp_path: Path, stalls: Any) -> None:
    listener = Listener()
    with start_head(replace(WORLD, ground=GROUND), FPS, seed=5, speed_mm_s=SPEED_MM_S) as head:
        bus = HeadBus(head.sensor_address, Tank(), 10.0)
        readers = [Fdc2214(bus, adc=Ads1115(bus)), Ina226(bus, rail=Rail(least_v=8.0)), Mpu6050(bus)]
        chips = I2cSensors("/dev/i2c-1", bus, readers, 0.025)
        time.sleep(0.5)  # the head has spoken before the first reading
        chips.start()
        session = Session(demo_config(head, WORLD, tmp_path), observer=listener, sensors=[chips], name="scan")
        end, began = time.monotonic() + 90.0, resource.getrusage(resource.RUSAGE_SELF)

        def done() -> bool:
            assert time.monotonic() < end, listener.told
            return head.counters()["z_mm"] > TRAVEL_MM if session.labelled > 30 else False

        begun = time.monotonic()
        report = session.run(done)
        stood_still_s = stalls.since(begun)
        spent = resource.getrusage(resource.RUSAGE_SELF)
    lost = {name: count for name, count in report.drops.items() if count}
    assert not lost or stood_still_s > STALL_S, (lost, listener.told)
    assert report.frames["projector"] > 80 and report.frames["led"] > 20
    seconds = session.seconds
    recording = open_recording(tmp_path / "scan.mcap")
    read = {name: sum(1 for _ in recording.notes(f"/sensor/{name}")) for name in CHIPS}
    assert min(read.values()) > 25 * seconds or stood_still_s > STALL_S, read  # every 25 ms, or what a reading takes
    cpu = (spent.ru_utime + spent.ru_stime - began.ru_utime - began.ru_stime) / seconds
    print(f"daemon's own process: {100 * cpu:.0f} % of a core over {seconds:.0f} s; samples {read}")
    assert cpu < 0.6
    live = [text for kind, text in listener.told if kind == "bore"]
    assert len(live) == 1 and "cross bore, air" in live[0], listener.told
    assert float(live[0].split(" at ")[1].split(" m,")[0]) == pytest.approx(BORE_MM / 1000, abs=0.03)
    pipe = survey_of(tmp_path / "scan.mcap")
    (bore,) = [feature for feature in pipe.features if feature.kind is FeatureKind.CROSS_BORE]
    assert bore.z_mm == pytest.approx(BORE_MM, abs=25.0) and bore.length_mm == pytest.approx(2 * RADIUS_MM, abs=40.0)
    assert bore.arc_deg == 360.0 and bore.measured("probability_percent") > 90.0
    (behind,) = sheets(pipe)  # what the sectors read, as the report draws it
    assert "taken out" in behind.note
