"""The machine's cameras: what they are, which pictures they send, whether one puts out its frame sync."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from annulus_pipe.capture.videodev import Device
from annulus_pipe.daemon.cameras import picamera2
from annulus_pipe.daemon.check import CheckRow
from annulus_pipe.doctor.machine import text_of
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

NO_CAMERA = re.compile(r"bcm2835|rp1-cfe|pispbe|unicam|rpi-|hevc")  # a Pi's own stages: Picamera2 speaks for them
SIZES_MAX = 6  # of a V4L2 camera's that are told


def cameras(root: Path = Path("/"), theirs: Callable[[], Any] = picamera2) -> list[CheckRow]:
    """Picamera2's and V4L2's, and sensors that know who leads. theirs : Picamera2's class, or AnnulusError."""
    found = []
    try:
        kind = theirs()
        found += [_picamera(kind, number, one) for number, one in enumerate(kind.global_camera_info())]
    except AnnulusError as error:
        on_a_pi = "Raspberry" in text_of(root / "proc/device-tree/model")
        found.append(CheckRow("picamera2", False if on_a_pi else None, str(error)))
    for device in sorted((root / "sys/class/video4linux").glob("video*")):
        name = text_of(device / "name").strip() or "no name"
        if not NO_CAMERA.search(name):
            found.append(_v4l2(root / "dev" / device.name, f"/dev/{device.name}: {name}"))
    if not any(one.what == "camera" for one in found):
        found.append(CheckRow("camera", None, "none on this machine"))
    for sensor in sorted((root / "sys/module").glob("imx*/parameters/trigger_mode")):
        name, mode = sensor.parts[-3], text_of(sensor).strip()
        leads = "its XVS pad puts the frame sync out" if mode == "1" else "it does not lead; see the manual"
        found.append(CheckRow("frame sync", mode == "1", f"{name}: trigger_mode {mode} in {sensor}: {leads}"))
    for node in sorted((root / "proc/device-tree").glob("soc*/csi*/sync-gpios")):
        found.append(CheckRow("frame sync", True, _receiver_sync(node)))
    return found


def _receiver_sync(node: Path) -> str:
    """Of a Pi's CSI receiver that says on a pin when a frame begins and ends: cells of phandle, GPIO, flags."""
    cells = node.read_bytes()
    pin = f"GPIO {int.from_bytes(cells[4:8], 'big')}" if len(cells) >= 12 else "a GPIO"
    return (
        f"{pin} of this computer follows the receiver {node.parent.name}, high from a frame's start to its end; set in"
        " an interrupt, so some tens of us late: leave the flash 0.5 ms before the window closes"
    )


def _picamera(kind: Any, number: int, about: dict[str, Any]) -> CheckRow:
    """One camera, opened for its modes and given back."""
    name = f"{number}: {about.get('Model', 'unknown')} by Picamera2"
    try:
        camera = kind(number)
    except (RuntimeError, IndexError) as error:
        return CheckRow("camera", None, f"{name}: not asked, another program has it ({one_line(str(error))})")
    try:
        modes = [(*mode["size"], mode["fps"]) for mode in camera.sensor_modes]
        listed = ", ".join(f"{width}x{height} at {fps:.0f} fps" for width, height, fps in modes)
    except (RuntimeError, KeyError, TypeError, ValueError) as error:
        return CheckRow("camera", False, f"{name}: does not say its modes ({one_line(str(error))})")
    finally:
        camera.close()
    return CheckRow("camera", True, f"{name}: {listed}")


def _v4l2(node: Path, name: str) -> CheckRow:
    if not os.access(node, os.R_OK | os.W_OK):
        return CheckRow("camera", False, f"{name}: no permission: sudo usermod -aG video $USER")
    try:
        device = Device(str(node))
    except (AnnulusError, OSError) as error:
        return CheckRow("camera", None, f"{name}: not asked ({one_line(str(error))})")
    try:
        sizes = [f"{fourcc} {size}" for fourcc in device.formats() for size in device.sizes(fourcc)]
    finally:
        device.close()
    if not sizes:
        return CheckRow("camera", None, f"{name}: sends no pictures")
    more = f", and {len(sizes) - SIZES_MAX} more" if len(sizes) > SIZES_MAX else ""
    return CheckRow("camera", True, f"{name}: {', '.join(sizes[:SIZES_MAX])}{more}")
