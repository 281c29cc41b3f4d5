"""What a user does with the controller's firmware: look at it, put it on a board, watch what it says.

    image = read_image(path); require_ours(image)
    flash(image, port="/dev/ttyACM0", say=print)        # asks the running firmware into its boot loader first

A board is reached by PICOBOOT, which reads everything back; by copying the UF2 to its drive, which nothing but the
board itself can check; or through the line it answers on, where that is not USB: it then checks a CRC.
"""

import os
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from annulus_pipe.flash.chips import CHIPS, RP2040, Chip
from annulus_pipe.flash.image import FLASH_START, PAGE_BYTES, FlashImage, application, has_application, parse_image
from annulus_pipe.flash.over_line import write_over_line
from annulus_pipe.flash.picoboot import BootLoader, PicoBoot, choose, find_boot_loaders, write_flash
from annulus_pipe.link.client import Client
from annulus_pipe.link.codec import Corrupt
from annulus_pipe.link.fields import Message
from annulus_pipe.link.hardware import carrier_line
from annulus_pipe.link.messages import (
    BOOTLOADER_MAGIC,
    BOOTLOADER_NEEDS_USB,
    BootCause,
    Bootloader,
    Hardware,
    HardwareReply,
    IdentifyReply,
    Status,
    StatusCode,
    StatusReply,
)
from annulus_pipe.link.problems import refusal, schema_problem
from annulus_pipe.link.session import Answer, EventReceived, EventsLost, LinkEvent, Rebooted
from annulus_pipe.vocabulary import AnnulusError

APPEAR_S = 8.0  # from the restart to a boot loader on the bus
MOUNT_S = 20.0  # and to its drive in the file system
TAKE_S = 15.0  # for the drive to go away once it has the whole image
BACK_S = 10.0  # for the new firmware to answer
LOOK_S = 0.1
STATUS_S = 1.0  # between two counts of a monitor
U32, U16 = 2**32, 2**16
STOPPING = ("bad_frames", "late")  # counters that stop at 65535; those of a controller below level 3 begin anew
PRODUCT = "annulus controller"  # as the firmware's USB descriptors have it

Progress = Callable[[str, int, int], None]
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Flashed:
    """What became of it."""

    image: str
    version: str
    size: int  # bytes
    how: str  # "picoboot", "drive" or "line"
    where: str  # place on the bus, the drive, or the port
    read_back: bool  # every byte was compared, or their CRC by the board itself
    running: str | None  # the commit the board answers with; None: nobody asked it


# ---- looking ---------------------------------------------------------------------------------------------------------
def image_fields(image: FlashImage) -> dict[str, object]:
    """What an image file holds, for people and programs."""
    who = image.identity
    return {
        "image": image.name,
        "firmware": "annulus" if who else "not annulus",
        "version": who.version if who else None,
        "git": who.git if who else None,
        "board": who.board if who else image.chip.board,
        "bytes": len(image.data),
        "protocol": who.protocol if who else None,
        "schema": f"{who.schema:08x}" if who else None,
        "level": who.level if who else None,
        "fits_this_host": who is not None and who.fits,
    }


def board_fields(port: str) -> dict[str, object]:
    """Who answers on a port. AnnulusError when nobody does."""
    with Client(port, diagnostics=True) as client:
        who = client.identity
        found = client.request(Hardware()) if client.session.knows(Hardware) else None
    return {"port": port, **_who(who), "carrier": carrier_line(found) if isinstance(found, HardwareReply) else None}


def _who(who: IdentifyReply) -> dict[str, object]:
    return {
        "firmware": "annulus",
        "git": _text(who.git),
        "board": _text(who.board),
        "protocol": who.protocol,
        "schema": f"{who.schema:08x}",
        "fits_this_host": not schema_problem(who),
        "boot": who.boot,
        "boot_cause": BootCause(who.cause).name.lower(),
        "tick_hz": who.tick_hz,
    }


@dataclass(frozen=True, slots=True)
class Controller:
    """A board on USB on which annulus runs."""

    port: str
    serial: str  # of the board's chip or flash: no other has it
    place: str  # on the bus, as `BootLoader.place`


def find_controllers() -> list[Controller]:
    """Controllers that run on this machine's USB. Those on other serial lines cannot be seen from here."""
    ports = [p for p in list_ports.comports() if p.product == PRODUCT and p.location]
    return [Controller(p.device, str(p.serial_number), _bus_place(p.location)) for p in sorted(ports)]


def boot_loader_fields(backend: Any = None) -> list[dict[str, object]]:
    """Boards that wait in their boot loaders; empty as well where USB cannot be searched."""
    try:
        return [{"place": b.place, "serial": b.serial, "chip": b.chip.board} for b in find_boot_loaders(backend)]
    except AnnulusError:
        return []


# ---- flashing --------------------------------------------------------------------------------------------------------
def flash(
    image: FlashImage,
    *,
    port: str | None = None,
    board: str | None = None,
    drive: Path | None = None,
    backend: Any = None,
    progress: Progress | None = None,
    say: Say = lambda line: None,
) -> Flashed:
    """Put an image on the one board meant.

    port : where its firmware answers now; it is asked into the boot loader if that is on USB, takes the image over the
    line if not, and is asked for its commit afterwards.
    board : which one, by the serial number of a running controller (then as with its port) or of a boot loader, or by
    the boot loader's place on the bus. drive : copy there instead of PICOBOOT. backend : of pyusb.

    Raises AnnulusError; where flashing broke off, the board is left in its boot loader.
    """
    place = None
    if port is None and board is not None:
        for controller in find_controllers():
            if controller.serial == board:
                port, board = controller.port, None
    if port is not None:
        place = usb_place(port)
        if place is None and drive is None and has_application(image):
            say(f"{port}: sending the image over this line")
            if write_over_line(port, application(image), progress):
                say(f"{port}: restarting into it")
                return _flashed(image, "line", port, await_firmware(port, image))
            say(f"{port}: its firmware is older than updates over a line")
        if place is None and not find_controllers():
            raise AnnulusError(
                f"{port}: the boot loader speaks USB only, and no controller is on this machine's USB. Plug it in."
            )
        known = set() if drive else {b.place for b in find_boot_loaders(backend)}  # no libusb is told before a restart
        enter_boot_loader(port, image.chip)
        say(f"{port}: restarting into the boot loader")
    if drive is not None:
        if port is not None:
            _wait(lambda: drive_chip(drive) is not None, MOUNT_S)
        copy_to_drive(image, drive, progress=progress)
        how, where = "drive", str(drive)
    else:
        if port is None:
            loader = choose(_or_say_who_runs(find_boot_loaders(backend)), board, image.chip)
        else:
            loader = _await_boot_loader(known, place, board, backend, image.chip)
        say(f"USB {loader}: boot loader of an {loader.chip}")
        with PicoBoot(loader) as boot:
            write_flash(boot, image.data, progress)
            boot.reboot()
        how, where = "picoboot", loader.place
    return _flashed(image, how, where, None if port is None else await_firmware(port, image))


def _flashed(image: FlashImage, how: str, where: str, running: str | None) -> Flashed:
    who = image.identity
    version = f"{who.version} {who.git}" if who else "not annulus"
    return Flashed(image.name, version, len(image.data), how, where, how != "drive", running)


def enter_boot_loader(port: str, chip: Chip) -> None:
    """Ask the running firmware to restart into its boot loader.

    Raises AnnulusError when it does not, with what to do, and when it is on another chip: nothing is restarted then.
    """
    with Client(port, diagnostics=True) as client:
        there = chip_of(_text(client.identity.board))
        if there not in (None, chip):
            raise AnnulusError(f"{port}: the head runs on an {there}, the image is for an {chip}")
        answer = client.ask(Bootloader(BOOTLOADER_MAGIC))
        if answer is None:
            raise AnnulusError(
                f"{port}: this firmware knows no way into the boot loader. Hold BOOTSEL while plugging the board in,"
                " and flash without naming a port."
            )
        if answer.reply.status is StatusCode.BAD_STATE and answer.reply.detail == BOOTLOADER_NEEDS_USB:
            raise AnnulusError(
                f"{port}: the boot loader speaks USB only, and no host is at the board's USB socket."
                " Plug it into this machine."
            )
        if answer.reply.status is StatusCode.BAD_STATE:
            raise AnnulusError(
                f"{port}: something is armed or moves, expected a head at rest. See annulus head disarm."
            )
        if answer.reply.status is not StatusCode.OK:
            raise AnnulusError(f"{port}: {refusal(answer)}")


def usb_place(port: str) -> str | None:
    """Where on the bus a serial port's board is, as `BootLoader.place`; None for a port that is not on USB."""
    real = os.path.realpath(port)
    for found in list_ports.comports():
        if found.device in (port, real) and found.location:
            return _bus_place(found.location)
    return None


def _bus_place(location: str) -> str:
    """Without the interface: 1-2.3:1.0 is 1-2.3."""
    return str(location).split(":")[0]


def _or_say_who_runs(loaders: list[BootLoader]) -> list[BootLoader]:
    """AnnulusError when no board waits but some run annulus: they only need to be named."""
    running = [] if loaders else find_controllers()
    if running:
        ports = ", ".join(f"{c.port} ({c.serial})" for c in running)
        raise AnnulusError(f"no board in its boot loader, but annulus runs on one: {ports}")
    return loaders


def _await_boot_loader(known: set[str], place: str | None, board: str | None, backend: Any, chip: Chip) -> BootLoader:
    """The boot loader that comes up at `place`, or that was not there before."""
    arrived: list[BootLoader] = []

    def look() -> bool:
        nonlocal arrived
        arrived = [b for b in find_boot_loaders(backend) if (b.place == place if place else b.place not in known)]
        return bool(arrived) and None not in {b.serial for b in arrived}  # udev gives the permission a moment later

    if not _wait(look, APPEAR_S) and not arrived:
        raise AnnulusError(
            f"no boot loader came up on USB within {APPEAR_S:g} s. Is the board's USB socket connected to this machine?"
            " It waits there until its power is switched off."
        )
    return choose(arrived, board, chip)


def await_firmware(port: str, image: FlashImage) -> str:
    """The commit of the firmware that answers after a restart. AnnulusError when none does, or another one."""
    last = ""
    who: IdentifyReply | None = None

    def ask() -> bool:
        nonlocal last, who
        try:
            with Client(port, diagnostics=True) as client:
                who = client.identity
        except AnnulusError as error:
            last = str(error)
        return who is not None

    if not _wait(ask, BACK_S):
        raise AnnulusError(f"flashed, but the board does not answer within {BACK_S:g} s: {last}")
    assert who is not None
    found = _text(who.git)
    if image.identity is not None and found != image.identity.git[: len(who.git)]:
        raise AnnulusError(
            f"{port}: firmware {found} answers, expected {image.identity.git}. Is it another board, or did it go back"
            " to the image before? `annulus head status` says so."
        )
    return found


# ---- the drive -------------------------------------------------------------------------------------------------------
def to_uf2(image: FlashImage) -> bytes:
    """The image as the boot ROM's drive takes it: 256 bytes in every block of 512."""
    pages = range(0, len(image.data), PAGE_BYTES)
    blocks = []
    for number, at in enumerate(pages):
        head = (0x0A324655, 0x9E5D5157, 0x2000, FLASH_START + at, PAGE_BYTES, number, len(pages), image.chip.family)
        payload = image.data[at : at + PAGE_BYTES].ljust(476, b"\0")
        blocks.append(struct.pack("<8I476sI", *head, payload, 0x0AB16F30))
    return b"".join(blocks)


def find_drives(mounts: Path = Path("/proc/mounts")) -> list[Path]:
    """Mounted drives that say they are an RP2040 or RP2350."""
    try:
        lines = mounts.read_text().splitlines()
    except OSError:
        return []
    folders = [Path(line.split()[1].encode().decode("unicode_escape")) for line in lines if line.count(" ") >= 2]
    return [folder for folder in folders if drive_chip(folder) is not None]


def drive_chip(folder: Path) -> Chip | None:
    """Whose boot loader this drive is; None: nobody's."""
    try:
        lines = (folder / "INFO_UF2.TXT").read_bytes().splitlines()
    except OSError:
        return None
    return next((chip for chip in CHIPS if f"Board-ID: {chip.drive}".encode() in lines), None)


def chip_of(board: str) -> Chip | None:
    """By the name its firmware has for it; None: no chip, as the simulated board."""
    return next((chip for chip in CHIPS if chip.board == board), None)


def chip_there(port: str | None = None, serial: str | None = None, drive: Path | None = None) -> Chip:
    """Of the board that `flash` would take, as far as it can be told: an RP2040 otherwise."""
    if drive is not None and port is None:
        return drive_chip(drive) or RP2040
    if port is not None:
        return chip_of(str(board_fields(port)["board"])) or RP2040
    for controller in find_controllers():
        if controller.serial == serial:
            return chip_there(controller.port)
    waiting = {str(b["chip"]) for b in boot_loader_fields() if serial in (None, b["serial"], b["place"])}
    return next((chip for chip in CHIPS if waiting == {chip.board}), RP2040)


def copy_to_drive(image: FlashImage, drive: Path, *, progress: Progress | None = None) -> None:
    """Copy to a board's drive and wait until the board has left it, which it does when it has the whole image."""
    chip = drive_chip(drive)
    if chip is None:
        there = ", ".join(map(str, find_drives())) or "none is mounted"
        raise AnnulusError(
            f"{drive}: not the drive of an {image.chip}: no INFO_UF2.TXT of {image.chip.drive}, expected one; {there}"
        )
    if chip is not image.chip:
        raise AnnulusError(f"{drive}: the drive of an {chip}, the image is for an {image.chip}")
    content = to_uf2(image)
    assert parse_image(content, image.name).data == image.data
    step = 16 * 512
    target = drive / "annulus.uf2"
    written = 0
    try:
        with open(target, "wb", buffering=0) as file:
            for at in range(0, len(content), step):
                written += file.write(content[at : at + step])
                os.fsync(file.fileno())
                if progress:
                    progress("copying", written, len(content))
    except OSError as error:
        # The board restarts with the last block, and may be gone before the kernel has closed the file.
        if written < len(content) - step:
            raise AnnulusError(f"{target}: broke off after {written} bytes ({error.strerror}). Flash again.") from None
    if not _wait(lambda: drive_chip(drive) is None, TAKE_S):
        raise AnnulusError(f"{drive}: still there {TAKE_S:g} s after the copy: the board did not take it. Try again.")


# ---- watching --------------------------------------------------------------------------------------------------------
def monitor(port: str, seconds: float | None = None) -> Iterator[dict[str, object]]:
    """What the controller says, as it says it, and its counters every second, until `seconds` are over or for ever.

    Sends no sign of life beyond one status query a second: whatever is armed goes dark by its host timeout.
    Raises AnnulusError when the line goes away.
    """
    with Client(port, diagnostics=True) as client:
        begin = time.monotonic()
        yield {"t_s": 0.0, "what": "identity", **_who(client.identity)}
        before: tuple[float, StatusReply] | None = None
        due = begin
        while seconds is None or time.monotonic() < begin + seconds:
            now = time.monotonic()
            if now >= due:
                due += STATUS_S
                client.session.send(Status())
            for happening in client.poll(min(LOOK_S, max(0.0, due - now))):
                t_s = round(time.monotonic() - begin, 4)
                if isinstance(happening, Answer):
                    if isinstance(happening.reply, StatusReply):
                        counts = happening.reply
                        yield {"t_s": t_s, "what": "counters", **_counters(counts, before, happening.received_ns / 1e9)}
                        before = happening.received_ns / 1e9, counts
                    continue
                if isinstance(happening, Rebooted):
                    before = None
                yield {"t_s": t_s, **_described(happening)}


def _described(happening: LinkEvent) -> dict[str, object]:
    match happening:
        case EventReceived(event=event, recovered=recovered):
            return {"what": _name(event), **_fields(event)} | ({"recovered": True} if recovered else {})
        case EventsLost(first=first, count=count):
            return {"what": "lost", "first": first, "count": count}
        case Corrupt(why=why, size=size):
            return {"what": "corrupt", "why": str(why), "bytes": size}
        case Rebooted(boot=boot, previous=previous):
            return {"what": "rebooted" if previous is not None else "met", "boot": boot, "previous": previous}
    return {"what": "unanswered"}


def _counters(now: StatusReply, before: tuple[float, StatusReply] | None, now_s: float) -> dict[str, object]:
    """State as it is; what happened since the last look, per second."""
    rates: dict[str, object] = {}
    if before is not None:
        elapsed = max(now_s - before[0], 1e-3)
        for name, modulus in (("edges", U32), ("rejected", U32), ("events", U16), ("bad_frames", U16), ("late", U16)):
            since = (getattr(now, name) - getattr(before[1], name)) % modulus
            stopped = name in STOPPING and getattr(now, name) == U16 - 1
            rates[f"{name}_per_s"] = None if stopped else round(since / elapsed, 2)
    return {
        "state": _plain(now.state),
        "fault": _plain(now.fault),
        "edges": now.edges,
        "frame_period_us": now.period / 100,
        "odometer": now.odometer,
        "turntable": now.turntable,
        **rates,
    }


def _name(message: Message) -> str:
    name = type(message).__name__
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).lstrip("_")


def _fields(message: Message) -> dict[str, object]:
    return {name: _plain(getattr(message, name)) for name in message.FIELDS}


def _plain(value: object) -> object:
    """A field's value as JSON has it: names for enumerations, lists of names for flags, text for bytes."""
    match value:
        case IntFlag():
            return [flag.name.lower() for flag in type(value) if flag in value and flag.name]
        case IntEnum():
            return value.name.lower()
        case bytes():
            return _text(value)
    return value


def _text(raw: bytes) -> str:
    return "".join(c for c in raw.rstrip(b"\0").decode("ascii", "replace") if c.isprintable())


def _wait(is_so: Callable[[], bool], patience_s: float) -> bool:
    end = time.monotonic() + patience_s
    while not is_so():
        if time.monotonic() > end:
            return False
        time.sleep(LOOK_S)
    return True
