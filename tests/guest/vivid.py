"""Runs in the guest: what the V4L2 camera makes of vivid, the kernel's own test driver, as facts on stdout, in JSON.

    python vivid.py CHAPTER    a function below; test_v4l2.py says what must be true of its facts

/dev/video0 is a webcam with a list of sizes, /dev/video1 an HDMI input with a scaler, /dev/video2 an output.
"""

import ctypes
import json
import os
import struct
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from annulus_pipe.capture import videodev
from annulus_pipe.capture.camera import CapturedFrame, grab
from annulus_pipe.capture.opencv import OpenCVCamera
from annulus_pipe.capture.pixels import ENCODINGS_OF
from annulus_pipe.capture.v4l2 import V4L2Camera
from annulus_pipe.vocabulary import AnnulusError

WEBCAM, HDMI, OUTPUT = "/dev/video0", "/dev/video1", "/dev/video2"
SIZE = {"width": 640, "height": 360}

VIVID = 0x00F0_F000  # its own controls, vivid-ctrls.c
OSD, ENCODING, QUANTIZATION, TIME_WRAP = (VIVID + n for n in (1, 27, 28, 39))
DROPPED, DISCONNECT, NO_BUFFERS, NO_START, FATAL = (VIVID + n for n in (64, 65, 67, 69, 70))
S_DV_TIMINGS = 3 << 30 | 132 << 16 | ord("V") << 8 | 87


def main() -> None:
    facts = CHAPTERS[sys.argv[1]]()
    json.dump(facts, sys.stdout)


def refusals() -> dict[str, str]:
    said = {
        "absent": why("/dev/video77"),
        "plain file": why(__file__),
        "folder": why("/dev"),
        "other device": why("/dev/null"),
        "output": why(OUTPUT),
        "format unread": why(WEBCAM, fourcc="AR24"),
        "format not offered": why(WEBCAM, fourcc="MJPG"),
        "size": why(WEBCAM, width=1664, height=1232),
        "rate": why(WEBCAM, fps=24.0),
        "hdmi rate": why(HDMI),
    }
    os.seteuid(65534)
    said["permission"] = why(WEBCAM)
    os.seteuid(0)
    with Streaming():
        said["busy"] = why(WEBCAM, width=1280, height=720)
        said["busy, same settings"] = why(WEBCAM)
    for name, fault in (("no buffers", NO_BUFFERS), ("no start", NO_START)):
        camera = V4L2Camera(WEBCAM, **SIZE)
        vivid(fault)
        try:
            camera.start()
            said[name] = ""
        except AnnulusError as error:
            said[name] = str(error)
    with Streaming() as frames:  # and nothing of it stays
        said["afterwards"] = str(next(frames).image.shape)
    return said


def opencv() -> dict[str, Any]:
    """The same device through OpenCV's capture: stamps, counts, and what it refuses."""
    facts: dict[str, Any] = {}
    for name, wanted in (
        ("absent", {}),
        ("size", {"width": 1664, "height": 1232}),
        ("format", {**SIZE, "fourcc": "MJPG"}),
    ):
        try:
            OpenCVCamera("/dev/video77" if name == "absent" else WEBCAM, **wanted)  # type: ignore[arg-type]
            facts[name] = ""
        except AnnulusError as error:
            facts[name] = str(error)
    camera = OpenCVCamera(WEBCAM, fourcc="YUYV", **SIZE)
    camera.start()
    facts["controls"] = []
    for controls in ({"AeEnable": False}, {"AnalogueGain": 100.0}):
        try:
            camera.set_controls(controls)
        except AnnulusError as error:
            facts["controls"].append(str(error))
    frames = [grab(camera) for _ in range(30)]
    facts["shape"] = str(frames[0].image.shape)
    facts["counted"] = any(frame.sequence is not None for frame in frames)
    facts["late_ns"] = [frame.arrived_ns - frame.timestamp_ns for frame in frames]
    facts["steps_ns"] = [b.timestamp_ns - a.timestamp_ns for a, b in pairwise(frames)]
    vivid(DISCONNECT)
    facts["gone"] = ""
    for _ in range(20):  # what the driver had already comes first
        try:
            grab(camera)
        except (AnnulusError, TimeoutError) as error:
            facts["gone"] = str(error)
            break
    camera.close()
    return facts


def formats() -> dict[str, Any]:
    """The bars of the test picture, in BGR, as each format gives them."""
    vivid(OSD, 2)
    with_device = videodev.Device(WEBCAM)
    offered = with_device.formats()
    with_device.close()
    bars: dict[str, Any] = {}
    small = {"width": 320, "height": 180}
    for fourcc in sorted(set(ENCODINGS_OF) & set(offered)):
        bars[fourcc] = colours_of(V4L2Camera(WEBCAM, fourcc=fourcc, **small))
    for name, control, value in (("full range", QUANTIZATION, 1), ("BT.709", ENCODING, 2)):
        vivid(control, value)
        for fourcc in ("YUYV", "NV12"):
            bars[f"{fourcc}, {name}"] = colours_of(V4L2Camera(WEBCAM, fourcc=fourcc, **small))
        vivid(control, 0)
    vivid(OSD, 0)
    return {"offered": offered, "bars": bars}


def our_size() -> dict[str, Any]:
    """1664 x 1232 at 25 fps from the HDMI input: its signal is 1080p25, its scaler does the rest."""
    timings = struct.pack(
        "<5IQ9I", 0, 1920, 1080, 0, 3, 74_250_000, 528, 44, 148, 4, 5, 36, 0, 0, 0
    )  # vivid-core.h, V4L2_DV_BT_CEA_1920X1080P25
    device = videodev.Device(HDMI)
    device.call(S_DV_TIMINGS, ctypes.create_string_buffer(timings, 132))
    device.set(OSD, 2)
    device.close()
    camera = V4L2Camera(HDMI)
    camera.start()
    frames = [grab(camera) for _ in range(10)]
    camera.close()
    return {**stamps(frames), "shape": frames[0].image.shape, "bars": bars_of(frames[0])}


def streaming() -> dict[str, Any]:
    facts: dict[str, Any] = {}
    camera = V4L2Camera(WEBCAM, **SIZE)
    began = time.monotonic_ns()
    camera.start()
    facts["plain"] = {**stamps([grab(camera) for _ in range(25)]), "began": began}
    time.sleep(1.0)
    resumed = time.monotonic_ns()
    facts["after a pause"] = {**stamps([grab(camera) for _ in range(10)]), "resumed": resumed}
    camera.stop()
    time.sleep(0.5)
    began = time.monotonic_ns()
    camera.start()
    facts["after a stop"] = {**stamps([grab(camera) for _ in range(3)]), "began": began}
    vivid(DROPPED, 50)
    facts["half dropped"] = stamps([grab(camera) for _ in range(15)])
    vivid(DROPPED, 0)
    vivid(DROPPED, 100)
    facts["all dropped"] = timed(lambda: drain(camera))
    vivid(DROPPED, 0)
    facts["mended"] = stamps([grab(camera) for _ in range(3)])
    camera.stop()

    vivid(TIME_WRAP, 1)
    with Streaming() as frames:
        facts["other clock"] = timed(lambda: next(frames))
    vivid(TIME_WRAP, 0)
    with Streaming() as frames:
        device = videodev.Device(WEBCAM)
        device.call(
            videodev.S_PARM, videodev.StreamParameters(type=videodev.CAPTURE, numerator=1, denominator=15)
        )  # behind its back, as a driver does that exposes longer in the dark
        device.close()
        facts["another rate"] = timed(lambda: drain(frames.camera))
    facts["controls"] = controls()
    return facts


def going() -> dict[str, Any]:
    """The device breaks, goes, and comes back."""
    facts: dict[str, Any] = {}
    camera = V4L2Camera(WEBCAM, **SIZE)
    camera.start()
    grab(camera)
    vivid(FATAL)
    facts["broken"] = timed(lambda: drain(camera))
    camera.stop()
    camera.start()
    facts["started again"] = stamps([grab(camera) for _ in range(3)])
    vivid(DISCONNECT)
    facts["gone"] = timed(lambda: drain(camera))
    facts["while gone"] = why(WEBCAM)
    camera.stop()  # vivid plugs itself in again when nobody has it open
    camera.start()
    facts["back"] = stamps([grab(camera) for _ in range(3)])
    camera.close()
    return facts


def controls() -> dict[str, str]:
    """Asked of a webcam that has a gain, an automatic one as well, and no exposure."""
    said = {}
    device = videodev.Device(WEBCAM)
    device.set(videodev.CID_AUTOGAIN, 1)
    with Streaming() as frames:
        for name, wanted in (
            ("automatic off", {"AeEnable": False}),
            ("gain", {"AnalogueGain": 77.0}),
            ("gain too high", {"AnalogueGain": 9000.0}),
            ("exposure", {"ExposureTime": 38_000}),
            ("same rate", {"FrameDurationLimits": (40_000, 40_000)}),
            ("other rate", {"FrameDurationLimits": (66_667, 66_667)}),
            ("no such rate", {"FrameDurationLimits": (37_000, 37_000)}),
        ):
            try:
                frames.camera.set_controls(wanted)
                said[name] = ""
            except AnnulusError as error:
                said[name] = f"{type(error).__name__}: {error}"
            if name == "gain":
                said["gain read"] = str(device.call(videodev.G_CTRL, videodev.Control(videodev.CID_GAIN)).value)
                auto = device.call(videodev.G_CTRL, videodev.Control(videodev.CID_AUTOGAIN))
                said["automatic read"] = str(auto.value)
            if name == "other rate":
                next(frames)
    device.close()
    return said


# ---- what they share ----


class Streaming:
    """A started camera whose frames can be asked for."""

    def __init__(self) -> None:
        self.camera = V4L2Camera(WEBCAM, **SIZE)

    def __enter__(self) -> "Streaming":
        self.camera.start()
        return self

    def __next__(self) -> CapturedFrame:
        return grab(self.camera)

    def __exit__(self, *error: object) -> None:
        self.camera.close()


def vivid(control: int, value: int = 1) -> None:
    """Through a handle of its own, as v4l2-ctl would."""
    device = videodev.Device(WEBCAM)
    try:
        device.call(videodev.S_CTRL, videodev.Control(control, value))
    finally:
        device.close()


def why(device: str, **settings: Any) -> str:
    """In what words it is refused; empty when it is not."""
    try:
        V4L2Camera(device, **{**({} if device == HDMI else SIZE), **settings})
    except AnnulusError as error:
        return str(error)
    return ""


def drain(camera: V4L2Camera) -> None:
    """Frames that came before the fault may still wait."""
    for _ in range(300):
        grab(camera)


def timed(ask: Any) -> dict[str, Any]:
    """What was raised, after how long, and how much the processor had to do for it."""
    began, cpu = time.monotonic(), time.process_time()
    try:
        ask()
        said = ""
    except (AnnulusError, TimeoutError) as error:
        said = f"{type(error).__name__}: {error}"
    return {"said": said, "seconds": time.monotonic() - began, "cpu": time.process_time() - cpu}


def stamps(frames: list[CapturedFrame]) -> dict[str, Any]:
    return {
        "stamps": [frame.timestamp_ns for frame in frames],
        "counts": [frame.sequence for frame in frames],
        "now": time.monotonic_ns(),
    }


def colours_of(camera: V4L2Camera) -> Any:
    camera.start()
    try:
        return bars_of(grab(camera))
    finally:
        camera.close()


def bars_of(frame: CapturedFrame) -> Any:
    """The middle of each of the eight bars."""
    height, width = frame.image.shape[:2]
    row = height // 2 & ~1
    return [frame.image[row, width * (2 * bar + 1) // 16 & ~1].tolist() for bar in range(8)]


CHAPTERS = {chapter.__name__: chapter for chapter in (refusals, formats, our_size, streaming, going, opencv)}

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    main()
