"""The camera that head.toml asks for."""

from pathlib import Path

from annulus.capture.camera import Camera, V4L2Camera, plug
from annulus.capture.remote import RemoteCamera
from annulus.daemon.config import HeadConfig
from annulus.record.replay import ScanFolderCamera, VideoFileCamera
from annulus.vocabulary import AnnulusError


def open_camera(config: HeadConfig) -> Camera:
    """Not started yet. Raises AnnulusError when it is not there or is of another size than configured."""
    camera = _open(config)
    wanted = config.camera
    if (camera.width, camera.height) != (wanted.width, wanted.height):
        camera.close()
        raise AnnulusError(
            f"{wanted.device}: frames are {camera.width}x{camera.height}, but head.toml says "
            f"{wanted.width}x{wanted.height}."
        )
    return camera


def _open(config: HeadConfig) -> Camera:
    wanted, fps = config.camera, config.timing.fps
    match wanted.kind:
        case "v4l2":
            return V4L2Camera(wanted.device, width=wanted.width, height=wanted.height, fps=fps)
        case "video":
            return VideoFileCamera(Path(wanted.device))
        case "folder":
            return ScanFolderCamera(Path(wanted.device), fps=fps)
        case "twin":
            return RemoteCamera(wanted.device)
        case "picamera2":
            return _picamera(config)


def _picamera(config: HeadConfig) -> Camera:
    try:
        from picamera2 import Picamera2
    except ImportError:
        raise AnnulusError(
            "camera: picamera2 is not installed for this Python. On a Raspberry Pi: apt install python3-picamera2, "
            "and make the environment with --system-site-packages."
        ) from None
    camera = Picamera2()
    size = (config.camera.width, config.camera.height)
    camera.configure(camera.create_video_configuration(main={"size": size, "format": "RGB888"}, buffer_count=6))
    return plug(camera)


def apply_controls(camera: Camera, config: HeadConfig) -> None:
    """Fixed exposure and rate on a sensor; call when it is started. Files and the twin have none."""
    if config.camera.kind in ("v4l2", "picamera2"):
        period_us = round(config.timing.period_us)
        camera.set_controls({"AeEnable": False, "FrameDurationLimits": (period_us, period_us)})
        camera.set_controls(
            {"ExposureTime": round(config.timing.exposure_us), "AnalogueGain": config.camera.gain}
        )  # fmt: skip
