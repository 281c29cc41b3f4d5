"""Picamera2's own code between us and a sensor that is told when to expose (libcamera_stub.py)."""

import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import libcamera_stub
import numpy as np
import pytest

from annulus_pipe.capture.camera import BAYER_RGGB8, BGR8, CameraDriver, grab
from annulus_pipe.capture.picamera import HELD_MAX, RawFormat, configure, on_monotonic, plug, require_controls
from annulus_pipe.vocabulary import AnnulusError

PACKAGE = Path(__file__).parents[3] / ".tools/picamera2"
SIZE = (1664, 1232)
MODES = [("SRGGB10", SIZE), ("SRGGB12", SIZE), ("SRGGB10", (1640, 1232)), ("SRGGB8", (640, 480))]
S = 1_000_000_000


@pytest.fixture(scope="module")
def package() -> Iterator[Any]:
    """Picamera2 with a libcamera that is ours; taken out again afterwards."""
    assert (PACKAGE / "picamera2").is_dir(), "picamera2 is missing: `make test` installs it"
    before = set(sys.modules)
    libcamera_stub.install(MODES)
    sys.path.insert(0, str(PACKAGE))
    import picamera2
    import picamera2.picamera2 as inside

    inside.DmaAllocator = libcamera_stub.MemoryAllocator
    yield picamera2
    sys.path.remove(str(PACKAGE))
    for name in set(sys.modules) - before:
        stands_in = isinstance(sys.modules[name], libcamera_stub.StandIn)
        if stands_in or name.split(".")[0] in ("picamera2", "libcamera"):
            del sys.modules[name]


@pytest.fixture
def sensor(package: Any) -> libcamera_stub.Sensor:
    fresh = libcamera_stub.Sensor(MODES)
    package.Picamera2._cm.reset()
    return fresh


@pytest.fixture
def theirs(package: Any, sensor: libcamera_stub.Sensor) -> Iterator[Any]:
    camera = package.Picamera2(0)
    yield camera
    camera.close()


def configured(
    theirs: Any, stream: str = "raw", size: tuple[int, int] = SIZE, gain: float = 2.0, crop: Any = None
) -> Any:
    return configure(
        theirs,
        size,
        stream=stream,
        fps=25.0,
        exposure_us=38_000.0,
        gain=gain,
        colour_gains=(1.9, 1.6),
        sensor_crop=crop,
    )


def exposed(sensor: libcamera_stub.Sensor, frames: int) -> None:
    """One after the other, each once Picamera2 has passed the last one on."""
    for _ in range(frames):
        sensor.expose()
        end = time.monotonic() + 30.0
        while sensor.ready and time.monotonic() < end:
            time.sleep(0.001)
        time.sleep(0.003)


def test_the_raw_stream_comes_without_padding_with_the_sensors_count_and_nothing_automatic(
    sensor: libcamera_stub.Sensor, theirs: Any
) -> None:
    camera = configured(theirs)
    assert isinstance(camera, CameraDriver) and camera.encoding == BAYER_RGGB8
    raw = theirs.camera_configuration()["raw"]
    assert raw["format"] == "SRGGB10" and raw["stride"] > 2 * SIZE[0]
    assert theirs.camera_configuration()["sensor"] == {"bit_depth": 10, "output_size": SIZE}
    camera.start()
    # in force before the first frame, not some frames later
    assert sensor.told["ExposureTime"] == 38_000 and sensor.told["FrameDurationLimits"] == (40_000, 40_000)
    assert sensor.told["AwbEnable"] is False and sensor.told["ColourGains"] == (1.9, 1.6)
    assert (sensor.told["NoiseReductionMode"], sensor.told["Sharpness"], sensor.told["AeEnable"]) == (0, 0.0, False)
    exposed(sensor, 3)
    for number in (1, 2, 3):
        frame = grab(camera)
        assert frame.sequence == number and frame.image.shape == SIZE[::-1]
        assert (frame.image[0::2, 0::2] == 200).all() and (frame.image[1::2, 1::2] == 40).all()
        assert (frame.image[0::2, 1::2] == 120).all() and (frame.image[1::2, 0::2] == 120).all()
        assert 0 <= time.monotonic_ns() - frame.timestamp_ns < 5 * S
    camera.close()


def test_the_isps_picture_can_be_had_instead(sensor: libcamera_stub.Sensor, theirs: Any) -> None:
    camera = configured(theirs, "RGB888", (1640, 1232))
    camera.start()
    exposed(sensor, 1)
    frame = grab(camera)
    assert (frame.encoding, frame.image.shape) == (BGR8, (1232, 1640, 3)) and (frame.image == [40, 120, 200]).all()
    camera.close()


def test_a_host_held_up_gets_every_frame_the_driver_had_and_a_hole_for_what_it_had_not(
    sensor: libcamera_stub.Sensor, theirs: Any
) -> None:
    """Picamera2 itself keeps one finished request and gives the others back."""
    camera = configured(theirs)
    camera.start()
    exposed(sensor, HELD_MAX)
    assert [grab(camera).sequence for _ in range(HELD_MAX)] == list(range(1, HELD_MAX + 1))
    exposed(sensor, HELD_MAX + 3)
    assert [grab(camera).sequence for _ in range(HELD_MAX)] == list(range(HELD_MAX + 4, 2 * HELD_MAX + 4))
    assert camera.dropped == 3
    camera.close()


def test_a_silent_sensor_ends_a_wait_and_neither_stop_nor_start_hangs(
    sensor: libcamera_stub.Sensor, theirs: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("annulus_pipe.capture.picamera.SILENT_S", 0.05)
    camera = configured(theirs)
    camera.start()
    with pytest.raises(TimeoutError, match="no frame"):
        grab(camera)
    done = threading.Event()
    threading.Thread(target=lambda: (camera.stop(), done.set()), daemon=True).start()
    assert done.wait(5.0)
    camera.start()
    exposed(sensor, 1)
    assert grab(camera).sequence == 1
    camera.close()


def test_requests_held_while_it_stops_do_no_harm(sensor: libcamera_stub.Sensor, theirs: Any) -> None:
    camera = configured(theirs)
    camera.start()
    exposed(sensor, 3)
    taken = camera.capture_request()
    camera.stop()
    taken.release()
    camera.start()
    exposed(sensor, 2)
    assert grab(camera).sequence == 1  # nothing from before
    camera.close()


def test_a_sensor_that_does_otherwise_than_it_was_told_is_named(sensor: libcamera_stub.Sensor, theirs: Any) -> None:
    camera = configured(theirs)
    sensor.does["ExposureTime"] = 33_000
    camera.start()
    with pytest.raises(AnnulusError, match="ExposureTime is 33000, it was told 38000"):
        for _ in range(20):
            exposed(sensor, 1)
            grab(camera)
    camera.close()


def test_a_mode_that_shows_another_field_than_the_calibrations_is_refused(
    sensor: libcamera_stub.Sensor, theirs: Any
) -> None:
    assert configured(theirs, crop=(0, 0, 3280, 2464)).sensor_crop == (0, 0, 3280, 2464)
    sensor.fields[SIZE] = (816, 616, 1648, 1232)  # the same size, from the middle of the sensor
    with pytest.raises(AnnulusError, match=r"shows 1648x1232 at 816,616 .* made with 3280x2464 at 0,0"):
        configured(theirs, crop=(0, 0, 3280, 2464))
    assert configured(theirs).sensor_crop == (816, 616, 1648, 1232)  # a calibration that does not say


def test_sizes_the_sensor_has_no_mode_of_are_refused_in_one_line(sensor: libcamera_stub.Sensor, theirs: Any) -> None:
    with pytest.raises(AnnulusError, match="no mode of 1600x1200, it has 1640x1232, 1664x1232, 640x480"):
        configured(theirs, size=(1600, 1200))


@pytest.mark.parametrize("name", ["SRGGB8", "SBGGR10", "SGRBG12", "SGBRG16", "SRGGB10_CSI2P", "SBGGR12_CSI2P"])
def test_every_mosaic_is_read_as_the_colours_it_has(name: str) -> None:
    width, height = 40, 6
    mosaic = RawFormat.named(name)
    colours = {"R": 200, "G": 120, "B": 40}
    cells = np.array([colours[c] for c in mosaic.order], np.uint16).reshape(2, 2)
    pixels = np.tile(cells, (height // 2, width // 2))
    if mosaic.packed:
        group, kept = (5, 4) if mosaic.bits == 10 else (3, 2)
        rows = np.full((height, width // kept, group), 0x5A, np.uint8)
        rows[:, :, :kept] = pixels.reshape(height, -1, kept)
        rows = rows.reshape(height, -1)
    elif mosaic.bits == 8:
        rows = pixels.astype(np.uint8)
    else:
        rows = ((pixels << (mosaic.bits - 8)) | 1).astype("<u2").view(np.uint8).reshape(height, -1)
    padded = np.hstack([rows, np.full((height, 24), 0xEE, np.uint8)])
    picture = mosaic.picture(padded, width, height)
    assert mosaic.encoding == f"bayer_{mosaic.order.lower()}8" and (picture == pixels).all()


@pytest.mark.parametrize("name", ["SRGGB10_PISP_COMP1", "R8", "SRGGB9", "SXYZW10", "RGB888"])
def test_raw_formats_that_are_not_read_are_named(name: str) -> None:
    with pytest.raises(AnnulusError, match=name):
        RawFormat.named(name)


def test_stamps_of_either_clock_are_on_the_monotonic_one_after_a_suspend() -> None:
    now, suspended = 500 * S, 3600 * S
    for age in (0, 30_000_000, 2 * S):
        assert on_monotonic(now - age, now, now + suspended) == now - age
        assert on_monotonic(now + suspended - age, now, now + suspended) == now - age
    assert on_monotonic(now - 30_000_000, now, now + 100) == now - 30_000_000  # never suspended


def test_controls_that_are_not_reported_are_not_judged() -> None:
    require_controls({"ExposureTime": 38_000, "Sharpness": 0.0}, {})
    require_controls({"ExposureTime": 38_000}, {"ExposureTime": 37_957})
    with pytest.raises(AnnulusError, match="ColourGains"):
        require_controls({"ColourGains": (1.9, 1.6)}, {"ColourGains": (1.0, 1.0)})


def test_a_configured_object_of_the_users_plugs_in(sensor: libcamera_stub.Sensor, theirs: Any) -> None:
    theirs.configure(theirs.create_video_configuration(main={"size": (640, 480), "format": "RGB888"}, raw=None))
    camera = plug(theirs)
    camera.start()
    exposed(sensor, 1)
    assert grab(camera).image.shape == (480, 640, 3)
    camera.close()


def test_what_cannot_be_used_is_refused_in_one_line() -> None:
    main = {"format": "SBGGR10", "size": (6, 4)}
    with pytest.raises(AnnulusError, match="main format is SBGGR10"):
        plug(SimpleNamespace(camera_configuration=lambda: {"main": main}, capture_request=None))
    with pytest.raises(AnnulusError, match="has not Picamera2's methods"):
        plug(object())
