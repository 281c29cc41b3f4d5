"""The machine itself: what is installed, cameras, clock, memory, compiled loops."""

import ctypes
import importlib.metadata
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

from annulus import shipped
from annulus.daemon.cameras import picamera2
from annulus.daemon.check import Finding
from annulus.daemon.config import HeadConfig
from annulus.flash import update
from annulus.flash.image import read_image
from annulus.geometry.calibration import Calibration
from annulus.numeric import compiling
from annulus.reprocess import ahead
from annulus.vocabulary import AnnulusError

PACKAGES = ("numpy", "opencv-python-headless", "scipy", "numba", "mcap", "pyzmq", "simplejpeg")
STEP_MS, LOOK_S = 1.0, 0.3  # of the clock against one that never jumps
STA_UNSYNC, TIMEX_BYTES, STATUS_AT = 0x40, 512, 5  # struct timex of linux/timex.h: `status` is its sixth word
SPARE_BYTES = 600e6  # for the daemon, a recorder, a publisher and two workers, without frames
YEAR_LEAST = 2025  # this was written then: an earlier clock is wrong


def versions() -> list[Finding]:
    """annulus and what it runs on; the native library and the Pico's image that come with it."""
    have = []
    for name in PACKAGES:
        try:
            have.append(f"{name.removesuffix('-python-headless')} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    about = f"{importlib.metadata.version('annulus')}, commit {shipped.commit()}"
    python = f"Python {platform.python_version()} on {platform.machine()}"
    found = [Finding("annulus", True, f"{about}; {python}; {', '.join(have)}")]
    try:
        shipped.shipped(shipped.NATIVE)
        found.append(Finding("simulation", True, "the firmware's own code is there for this machine"))
    except AnnulusError as error:
        found.append(Finding("simulation", None, str(error)))
    try:
        image = update.image_fields(read_image(shipped.shipped(shipped.IMAGE)))
        found.append(Finding("image", bool(image["fits_this_host"]), f"annulus.uf2 {image['version']}, {image['git']}"))
    except AnnulusError as error:
        found.append(Finding("image", None, str(error)))
    return found


def kernels(calibration: Calibration | None = None) -> list[Finding]:
    """Whether the measuring loops of a head are compiled: of the one named, or of one camera and a slide."""
    kept = compiling.folder()
    if kept is None:
        return [Finding("compiled", False, compiling.NOWHERE)]
    work = ahead.USUAL if calibration is None else ahead.work_of(calibration)
    ready = compiling.is_ready(work) if calibration is None else ahead.is_ready(calibration)
    if ready:
        return [Finding("compiled", True, f"the measuring loops ({work}), in {kept}")]
    return [Finding("compiled", None, f"not yet ({work}): the first scan waits for it, or have doctor compile it now")]


def cameras(root: Path = Path("/")) -> list[Finding]:
    """Cameras of Picamera2 with their modes, V4L2's, and whether a sensor puts out its frame sync."""
    found = []
    model = _text(root / "proc/device-tree/model").rstrip("\0")
    try:
        for number, one in enumerate(picamera2().global_camera_info()):
            found.append(Finding("camera", True, f"{number}: {one.get('Model', 'unknown')} by Picamera2"))
    except AnnulusError as error:
        found.append(Finding("picamera2", False if "Raspberry" in model else None, str(error)))
    found += [_v4l2(root, device) for device in sorted((root / "sys/class/video4linux").glob("video*"))]
    for sensor in sorted((root / "sys/module").glob("imx*/parameters/trigger_mode")):
        name, mode = sensor.parts[-3], _text(sensor).strip()
        leads = "its XVS pad puts the frame sync out" if mode == "1" else "it does not lead; see the manual"
        found.append(Finding("frame sync", mode == "1", f"{name}: trigger_mode {mode} in {sensor}: {leads}"))
    if not any(one.what == "camera" for one in found):
        found.append(Finding("camera", None, "none on this machine"))
    return found


def _v4l2(root: Path, device: Path) -> Finding:
    node = root / "dev" / device.name
    name = _text(device / "name").strip() or "no name"
    if os.access(node, os.R_OK | os.W_OK):
        return Finding("camera", True, f"/dev/{device.name}: {name}")
    return Finding("camera", False, f"/dev/{device.name}: {name}: no permission: sudo usermod -aG video $USER")


def clock(
    wall: Callable[[], int] = time.time_ns, even: Callable[[], int] = time.monotonic_ns,
    synchronised: Callable[[], bool | None] | None = None, look_s: float = LOOK_S,
) -> list[Finding]:  # fmt: skip
    """Whether the time of day is somebody's, and stands still against the one that frames are stamped with."""
    before = wall() - even()
    time.sleep(look_s)
    step_ms = abs(wall() - even() - before) / 1e6
    year = time.gmtime(wall() / 1e9).tm_year
    known = (synchronised or _synchronised)()
    if year < YEAR_LEAST:
        return [Finding("clock", False, f"it is {year} here: sudo timedatectl set-ntp true, or fit a real-time clock")]
    if step_ms > STEP_MS:
        return [Finding("clock", False, f"the time of day jumped by {step_ms:.1f} ms in {look_s:g} s: who sets it?")]
    said = {
        True: "synchronised",
        False: "not synchronised: recordings may tell a wrong time of day",
        None: "unknown",
    }
    text = f"{said[known]}; steady within {max(step_ms, 0.001):.3f} ms"
    return [Finding("clock", True if known else None, text)]


def _synchronised() -> bool | None:
    """What the kernel was told by whoever keeps its clock; None where it does not say."""
    timex = (ctypes.c_long * (TIMEX_BYTES // ctypes.sizeof(ctypes.c_long)))()  # modes 0: only asks
    try:
        if ctypes.CDLL(None).adjtimex(timex) < 0:
            return None
    except (OSError, AttributeError):
        return None
    return not timex[STATUS_AT] & STA_UNSYNC


def memory(root: Path = Path("/"), head: HeadConfig | None = None) -> list[Finding]:
    """Memory for frames in hand; they cross processes in a memfd, which counts as memory."""
    free = {}
    for line in _text(root / "proc/meminfo").splitlines():
        name, _, value = line.partition(":")
        if value.split()[:1] and value.split()[0].isdigit():
            free[name] = int(value.split()[0]) * 1024
    if "MemAvailable" not in free:
        return [Finding("memory", None, "unknown")]
    frames = 0.0 if head is None else head.slots * max(3 * one.width * one.height for one in head.cameras)
    need = SPARE_BYTES + frames
    text = f"{free['MemAvailable'] / 1e9:.1f} of {free.get('MemTotal', 0) / 1e9:.1f} GB are free"
    if head is not None:
        text += f"; {head.slots} frames in hand are {frames / 1e6:.0f} MB"
    if free["MemAvailable"] < need:
        return [Finding("memory", False, f"{text}; a head needs {need / 1e9:.1f} GB: fewer [workers] slots?")]
    return [Finding("memory", True, text)]


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""
