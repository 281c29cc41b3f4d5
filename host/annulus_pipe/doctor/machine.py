"""The machine itself: what is installed, clock, memory, the library of the loops."""

import ctypes
import importlib.metadata
import platform
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from annulus_pipe import shipped
from annulus_pipe.daemon.check import CheckRow
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.flash import update
from annulus_pipe.flash.image import read_image
from annulus_pipe.numeric import native
from annulus_pipe.stream.access import require_secret
from annulus_pipe.vocabulary import AnnulusError

PACKAGES = ("numpy", "opencv-python-headless", "scipy", "mcap", "pyzmq", "simplejpeg")
STEP_MS, LOOK_S = 1.0, 0.3  # of the clock against one that never jumps
STA_UNSYNC, TIMEX_BYTES, STATUS_AT = 0x40, 512, 5  # struct timex of linux/timex.h: `status` is its sixth word
SPARE_BYTES = 600e6  # for the daemon, a recorder, a publisher and two workers, without frames
YEAR_LEAST = 2025  # this was written then: an earlier clock is wrong


def versions() -> list[CheckRow]:
    """annulus and what it runs on; the native library and the Pico's image that come with it."""
    have = []
    for name in PACKAGES:
        try:
            have.append(f"{name.removesuffix('-python-headless')} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    about = f"{importlib.metadata.version('annulus-pipe')}, commit {shipped.commit()}"
    python = f"Python {platform.python_version()} on {platform.machine()}"
    found = [CheckRow("annulus", True, f"{about}; {python}; {', '.join(have)}")]
    try:
        shipped.shipped(shipped.NATIVE)
        found.append(CheckRow("simulation", True, "the firmware's own code is there for this machine"))
    except AnnulusError as error:
        found.append(CheckRow("simulation", None, str(error)))
    try:
        image = update.image_fields(read_image(shipped.shipped(shipped.IMAGE)))
        found.append(
            CheckRow("image", bool(image["fits_this_host"]), f"annulus.uf2 {image['version']}, {image['git']}")
        )
    except AnnulusError as error:
        found.append(CheckRow("image", None, str(error)))
    return found


def loops() -> list[CheckRow]:
    """Which library of the measuring loops this processor runs."""
    try:
        native.library()
        return [CheckRow("loops", True, f"the measuring loops for {native.level()}")]
    except AnnulusError as error:
        return [CheckRow("loops", False, str(error))]


def secrets(files: Sequence[Path]) -> list[CheckRow]:
    """Whether nobody else may read or change them; those of head.toml are looked at when it is read."""
    found = []
    for path in files:
        with suppress(FileNotFoundError):
            try:
                require_secret(path)
                found.append(CheckRow("secret", True, f"{path}: this user's alone"))
            except (AnnulusError, ValueError) as error:
                found.append(CheckRow("secret", False, str(error)))
    return found


def clock(
    wall: Callable[[], int] = time.time_ns,
    even: Callable[[], int] = time.monotonic_ns,
    synchronised: Callable[[], bool | None] | None = None,
    look_s: float = LOOK_S,
) -> list[CheckRow]:
    """Whether the time of day is somebody's, and stands still against the one that frames are stamped with."""
    before = wall() - even()
    time.sleep(look_s)
    step_ms = abs(wall() - even() - before) / 1e6
    year = time.gmtime(wall() / 1e9).tm_year
    known = (synchronised or _synchronised)()
    if year < YEAR_LEAST:
        return [CheckRow("clock", False, f"it is {year} here: sudo timedatectl set-ntp true, or fit a real-time clock")]
    if step_ms > STEP_MS:
        return [CheckRow("clock", False, f"the time of day jumped by {step_ms:.1f} ms in {look_s:g} s: who sets it?")]
    words = {True: "synchronised", False: "not synchronised: recordings may tell a wrong time of day", None: "unknown"}
    text = f"{words[known]}; steady within {max(step_ms, 0.001):.3f} ms"
    return [CheckRow("clock", True if known else None, text)]


def _synchronised() -> bool | None:
    """What the kernel was told by whoever keeps its clock; None where it does not say."""
    timex = (ctypes.c_long * (TIMEX_BYTES // ctypes.sizeof(ctypes.c_long)))()  # modes 0: only asks
    try:
        if ctypes.CDLL(None).adjtimex(timex) < 0:
            return None
    except (OSError, AttributeError):
        return None
    return not timex[STATUS_AT] & STA_UNSYNC


def memory(root: Path = Path("/"), head: HeadConfig | None = None) -> list[CheckRow]:
    """Memory for frames in hand; they cross processes in a memfd, which counts as memory."""
    free = {}
    for line in text_of(root / "proc/meminfo").splitlines():
        name, _, value = line.partition(":")
        if value.split()[:1] and value.split()[0].isdigit():
            free[name] = int(value.split()[0]) * 1024
    if "MemAvailable" not in free:
        return [CheckRow("memory", None, "unknown")]
    frames = 0.0 if head is None else head.slots * max(3 * one.width * one.height for one in head.cameras)
    need = SPARE_BYTES + frames
    text = f"{free['MemAvailable'] / 1e9:.1f} of {free.get('MemTotal', 0) / 1e9:.1f} GB are free"
    if head is not None:
        text += f"; {head.slots} frames in hand are {frames / 1e6:.0f} MB"
    if free["MemAvailable"] < need:
        return [CheckRow("memory", False, f"{text}; a head needs {need / 1e9:.1f} GB: fewer [workers] slots?")]
    return [CheckRow("memory", True, text)]


def text_of(path: Path) -> str:
    """Of a file of the kernel's; empty where there is none."""
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""
