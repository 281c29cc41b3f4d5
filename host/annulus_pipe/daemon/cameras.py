"""The cameras that head.toml asks for."""

from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.capture.camera import CameraDriver, NoSuchControl
from annulus_pipe.capture.picamera import configure
from annulus_pipe.capture.remote import RemoteCamera
from annulus_pipe.capture.v4l2 import V4L2Camera
from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.extras import adds
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

FRAME_WAIT_S = 0.2  # in one call: who waits for frames says so often enough that a hang is known from silence


def open_camera(wanted: CameraConfig, number: int) -> CameraDriver:
    """Not started yet. Raises AnnulusError when it is not there or is of another size than configured."""
    camera = _open(wanted, number)
    if (camera.width, camera.height) != (wanted.width, wanted.height):
        camera.close()
        raise AnnulusError(
            f"{wanted.device}: frames are {camera.width}x{camera.height}, but head.toml says "
            f"{wanted.width}x{wanted.height}."
        )
    return camera


def _open(wanted: CameraConfig, number: int) -> CameraDriver:
    fps, size = wanted.timing.fps, {"width": wanted.width, "height": wanted.height}
    match wanted.kind:
        case "v4l2":
            return V4L2Camera(wanted.device, fourcc=wanted.format, **size, fps=fps, timeout_s=FRAME_WAIT_S)
        case "opencv":
            from annulus_pipe.capture.opencv import OpenCVCamera

            return OpenCVCamera(wanted.device, fourcc=wanted.format, **size, fps=fps)
        case "video":
            from annulus_pipe.daemon.filmed import VideoFileCamera  # here: an intake that takes over has no time for it

            return VideoFileCamera(Path(wanted.device))
        case "folder":
            from annulus_pipe.daemon.filmed import ScanFolderCamera

            return ScanFolderCamera(Path(wanted.device), fps=fps, camera=number)
        case "remote":
            return RemoteCamera(wanted.device, FRAME_WAIT_S)
        case "picamera2":
            return _picamera(wanted)


def picamera2() -> Any:
    """Picamera2's class. AnnulusError, one line, where it is not there or does not load."""
    try:
        from picamera2 import Picamera2
    except ImportError:
        raise AnnulusError(
            "camera: picamera2 is not installed for this Python. On a Raspberry Pi: apt install python3-picamera2, "
            "and make the environment with --system-site-packages."
        ) from None
    except ValueError as error:  # Debian 12's simplejpeg is built for numpy 1: "numpy.dtype size changed"
        raise AnnulusError(
            f"camera: picamera2 does not load beside numpy {np.__version__} ({one_line(str(error))}): the system's "
            f"simplejpeg is built for an older one. {adds('pi')}"
        ) from None
    return Picamera2


def _picamera(wanted: CameraConfig) -> CameraDriver:
    try:
        camera = picamera2()(int(wanted.device) if wanted.device.isdigit() else 0)
    except (RuntimeError, IndexError) as error:
        raise AnnulusError(f"camera: Picamera2 cannot open camera {wanted.device}: {error}") from None
    try:
        configured = configure(
            camera,
            (wanted.width, wanted.height),
            stream=wanted.format,
            fps=wanted.timing.fps,
            exposure_us=wanted.timing.exposure_us,
            gain=wanted.gain,
            colour_gains=wanted.colour_gains,
            sensor_crop=wanted.sensor_crop,
        )
    except BaseException:
        camera.close()
        raise
    configured.timeout_s = FRAME_WAIT_S
    return configured


def apply_controls(camera: CameraDriver, config: CameraConfig) -> list[str]:
    """Fixed exposure and rate on a sensor; call when it is started. Files and other programs' cameras have none.

    Returns what the camera cannot be told, for the operator. Raises AnnulusError when it does not do what it was told.
    """
    remarks = []
    if config.kind in ("v4l2", "opencv"):  # Picamera2 was told when it was configured
        period_us = round(config.timing.period_us)
        for controls in (
            {"AeEnable": False, "FrameDurationLimits": (period_us, period_us)},
            {"ExposureTime": round(config.timing.exposure_us)},
            {"AnalogueGain": config.gain},
        ):
            try:
                camera.set_controls(controls)
            except NoSuchControl as error:
                remarks.append(str(error))
    return remarks
