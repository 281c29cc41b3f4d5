"""PICOBOOT, the vendor interface of the boot ROM on USB, of RP2040 and RP2350: erase, write, read back flash, restart.

    with PicoBoot(choose(find_boot_loaders())) as boot:     # AnnulusError: none, several, no permission, no libusb
        write_flash(boot, image.data, progress)             # AnnulusError: and the board stays in the boot loader
        boot.reboot()

`command` and `parse_status` are the bytes alone. Source: RP2040 datasheet §2.8.5 and the boot ROM's own code
(raspberrypi/pico-bootrom-rp2040, usb_boot_device.c and async_task.c). Two things only the latter tells: a failing erase
is acknowledged like a good one, so only reading back proves anything; and the serial number of an RP2040 is the same
for all chips of one revision, so boards are told apart by their place on the bus. The RP2350's boot ROM takes the same
commands but for the restart, which has another number and other arguments.
"""

import contextlib
import errno
import itertools
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import IntEnum
from types import TracebackType
from typing import Any, Protocol, Self

import usb.core
import usb.util

from annulus_pipe.flash.chips import CHIPS, RP2040, RP2350, Chip
from annulus_pipe.flash.image import FLASH_START, PAGE_BYTES, SECTOR_BYTES
from annulus_pipe.shipped import UDEV, shipped
from annulus_pipe.vocabulary import AnnulusError

VENDOR = 0x2E8A
HOW_TO_BOOT = "Hold BOOTSEL while plugging the board in, or name the port of a running one."

MAGIC = 0x431FD10B
_COMMAND = struct.Struct("<IIBBHI16s")
_STATUS = struct.Struct("<IIBB6x")
_IF_RESET, _IF_STATUS = 0x41, 0x42
_VENDOR_OUT, _VENDOR_IN = 0x41, 0xC1  # control requests to the interface
_STANDARD_IN_ENDPOINT, _GET_STATUS = 0x82, 0
_IN = 0x80  # of a command id and of an endpoint's address
_EXCLUSIVE = 1
_COMMAND_MS, _DATA_MS = 3_000, 10_000
_REBOOT_DELAY_MS = 500  # time for the acknowledgement to get out


def install_rule() -> str:
    """The line for a shell that lets people use the boards without being root."""
    return f"sudo cp {shipped(UDEV)} /etc/udev/rules.d/ && sudo udevadm control --reload && sudo udevadm trigger"


class CommandId(IntEnum):
    EXCLUSIVE_ACCESS = 0x01
    REBOOT = 0x02
    FLASH_ERASE = 0x03
    READ = 0x84
    WRITE = 0x05
    EXIT_XIP = 0x06
    REBOOT2 = 0x0A  # of an RP2350, which knows no REBOOT


class PicoBootStatus(IntEnum):
    OK = 0
    UNKNOWN_CMD = 1
    INVALID_CMD_LENGTH = 2
    INVALID_TRANSFER_LENGTH = 3
    INVALID_ADDRESS = 4
    BAD_ALIGNMENT = 5
    INTERLEAVED_WRITE = 6
    REBOOTING = 7
    UNKNOWN_ERROR = 8
    INVALID_STATE = 9  # from here on of an RP2350 only
    NOT_PERMITTED = 10
    INVALID_ARG = 11
    BUFFER_TOO_SMALL = 12
    PRECONDITION_NOT_MET = 13
    MODIFIED_DATA = 14
    INVALID_DATA = 15
    NOT_FOUND = 16
    UNSUPPORTED_MODIFICATION = 17


@dataclass(frozen=True, slots=True)
class CommandStatus:
    """What the boot ROM says of the last command."""

    token: int
    code: int
    command: int
    in_progress: bool

    @property
    def text(self) -> str:
        return PicoBootStatus(self.code).name.lower() if self.code in set(PicoBootStatus) else f"status {self.code}"


def command(identity: CommandId, token: int, arguments: bytes = b"", transfer: int = 0) -> bytes:
    """The 32 bytes of a command; `transfer` bytes of data follow, then an empty packet the other way."""
    return _COMMAND.pack(MAGIC, token, identity, len(arguments), 0, transfer, arguments)


def parse_status(data: bytes) -> CommandStatus:
    """From the 16 bytes of the status request. ValueError for another length."""
    if len(data) != _STATUS.size:
        raise ValueError(f"{len(data)} bytes of status, expected {_STATUS.size}")
    token, code, identity, in_progress = _STATUS.unpack(data)
    return CommandStatus(token, code, identity, bool(in_progress))


@dataclass(frozen=True, slots=True)
class BootLoader:
    """A board that waits in its boot loader."""

    place: str  # on the bus, as Linux writes it: 1-2.3
    serial: str | None  # None: not readable without permission. The same for every RP2040 of a revision
    device: Any = field(repr=False, compare=False)
    chip: Chip = RP2040

    def __str__(self) -> str:
        return f"{self.place} ({self.serial or 'serial number not readable'})"


def find_boot_loaders(backend: Any = None) -> list[BootLoader]:
    """All boards in their boot loaders, in order of their places. `backend`: of pyusb, by default libusb.

    Raises AnnulusError when there is no libusb.
    """
    try:
        devices = list(usb.core.find(find_all=True, backend=backend, idVendor=VENDOR))
    except usb.core.NoBackendError:
        raise AnnulusError(
            "no libusb on this machine, expected Debian's libusb-1.0-0. Or copy the image to the board's drive."
        ) from None
    except usb.core.USBError as error:
        raise AnnulusError(f"USB cannot be searched ({error.strerror}), expected a USB host") from None
    chips = {chip.product: chip for chip in CHIPS}
    found = [BootLoader(_place(d), _serial(d), d, chips[d.idProduct]) for d in devices if d.idProduct in chips]
    return sorted(found, key=lambda loader: loader.place)


def choose(loaders: Iterable[BootLoader], wanted: str | None = None, chip: Chip | None = None) -> BootLoader:
    """The one board meant: by serial number or place, or the only one with that chip.

    Raises AnnulusError, which lists what there is.
    """
    everybody = list(loaders)
    if not everybody:
        raise AnnulusError(f"no board in its boot loader. {HOW_TO_BOOT}")
    meant = [loader for loader in everybody if wanted in (None, loader.serial, loader.place)]
    all_of_them = [loader for loader in everybody if chip in (None, loader.chip)]
    matching = [loader for loader in meant if loader in all_of_them]
    if meant and not matching:
        raise AnnulusError(f"the board at USB {meant[0].place} is an {meant[0].chip}, the image is for an {chip}")
    listed = ", ".join(map(str, all_of_them or everybody))
    if not matching:
        raise AnnulusError(f"no board {wanted} in its boot loader, there is {listed}")
    if len(matching) > 1:
        raise AnnulusError(f"{len(matching)} boards in their boot loaders, name one by place or serial: {listed}")
    return matching[0]


def _place(device: Any) -> str:
    ports = ".".join(map(str, device.port_numbers or ()))
    return f"{device.bus}-{ports}" if ports else f"{device.bus}:{device.address}"


def _serial(device: Any) -> str | None:
    try:
        serial = device.serial_number
    except (usb.core.USBError, ValueError, NotImplementedError):
        return None
    finally:
        usb.util.dispose_resources(device)
    return str(serial) if serial else None


class PicoBoot:
    """One board's boot loader. Any failure asks the boot ROM why, puts its interface right again and raises."""

    def __init__(self, loader: BootLoader) -> None:
        self.place = loader.place
        self._chip = loader.chip
        self._device = loader.device
        self._tokens = itertools.count(1)
        self._interface = self._out = self._in = 0
        try:
            self._interface, self._out, self._in = self._find_endpoints()
            usb.util.claim_interface(self._device, self._interface)
            self._reset()
        except usb.core.USBError as error:
            self.close()
            raise self._mended(error, "opening") from None
        except AnnulusError:
            self.close()
            raise

    def exclusive_access(self) -> None:
        """Nothing comes in by the board's drive any more."""
        self._run(CommandId.EXCLUSIVE_ACCESS, bytes((_EXCLUSIVE,)))

    def exit_xip(self) -> None:
        """The flash takes commands; needed before it is erased or written."""
        self._run(CommandId.EXIT_XIP)

    def erase(self, address: int, size: int) -> None:
        """Whole sectors. The boot ROM acknowledges this even when it refused."""
        self._run(CommandId.FLASH_ERASE, struct.pack("<II", address, size))

    def write(self, address: int, data: bytes) -> None:
        """Whole pages of erased flash."""
        self._run(CommandId.WRITE, struct.pack("<II", address, len(data)), data)

    def read(self, address: int, size: int) -> bytes:
        """Flash from a page's beginning on, or RAM."""
        return self._run(CommandId.READ, struct.pack("<II", address, size), size)

    def reboot(self) -> None:
        """Start what is in the flash. The board leaves the bus; it may do so before it has said yes."""
        with contextlib.suppress(_Gone):
            if self._chip is RP2350:
                self._run(CommandId.REBOOT2, struct.pack("<IIII", 0, _REBOOT_DELAY_MS, 0, 0))
            else:
                self._run(CommandId.REBOOT, struct.pack("<III", 0, 0, _REBOOT_DELAY_MS))

    def close(self) -> None:
        usb.util.dispose_resources(self._device)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _find_endpoints(self) -> tuple[int, int, int]:
        for interface in self._device.get_active_configuration():
            addresses = sorted(endpoint.bEndpointAddress for endpoint in interface)
            if interface.bInterfaceClass == 0xFF and [address & _IN for address in addresses] == [0, _IN]:
                return interface.bInterfaceNumber, addresses[0], addresses[1]
        raise AnnulusError(
            f"USB {self.place}: no PICOBOOT interface, expected the boot ROM of an {self._chip}; or use its drive"
        )

    def _run(self, identity: CommandId, arguments: bytes = b"", data: bytes | int = b"") -> bytes:
        """One command; `data` to send, or how many bytes to fetch."""
        transfer = data if isinstance(data, int) else len(data)
        received = b""
        try:
            self._device.write(self._out, command(identity, next(self._tokens), arguments, transfer), _COMMAND_MS)
            if isinstance(data, int):
                received = bytes(self._device.read(self._in, transfer, _DATA_MS))
            elif data:
                self._device.write(self._out, data, _DATA_MS)
            if identity & _IN:
                self._device.write(self._out, b"\0", _COMMAND_MS)  # empty would do; Raspberry Pi's tools send one byte
            else:
                self._device.read(self._in, 1, _COMMAND_MS if transfer else _DATA_MS)
        except usb.core.USBError as error:
            raise self._mended(error, identity.name.lower().replace("_", " ")) from None
        if len(received) != (transfer if isinstance(data, int) else 0):
            raise AnnulusError(f"USB {self.place}: {len(received)} of {transfer} bytes read, expected all")
        return received

    def _reset(self) -> None:
        for endpoint in (self._in, self._out):
            # only where it is halted, as Raspberry Pi's tools do: clearing resets the data toggle, on both sides or not
            if self._device.ctrl_transfer(_STANDARD_IN_ENDPOINT, _GET_STATUS, 0, endpoint, 2, _COMMAND_MS)[0] & 1:
                self._device.clear_halt(endpoint)
        self._device.ctrl_transfer(_VENDOR_OUT, _IF_RESET, 0, self._interface, None, _COMMAND_MS)

    def _mended(self, error: usb.core.USBError, doing: str) -> AnnulusError:
        """What a user can do about it."""
        here = f"USB {self.place}"
        if error.errno == errno.EACCES:
            return AnnulusError(f"{here}: no permission. Install the udev rule: {install_rule()}")
        if error.errno == errno.EBUSY:
            return AnnulusError(f"{here}: another program has the boot loader (picotool?), expected it free")
        if error.errno in (errno.ENODEV, errno.ENOENT, errno.EIO):
            return _Gone(f"{here}: the board went away while {doing}. Hold BOOTSEL, plug it in and flash again.")
        why = "no answer in time" if error.errno == errno.ETIMEDOUT else error.strerror
        with contextlib.suppress(usb.core.USBError, ValueError):
            answer = self._device.ctrl_transfer(_VENDOR_IN, _IF_STATUS, 0, self._interface, _STATUS.size, _COMMAND_MS)
            status = parse_status(bytes(answer))
            why = status.text if status.code else why
            self._reset()
        return AnnulusError(f"{here}: the boot loader refused {doing} ({why}). Flash again, or by its drive.")


class _Gone(AnnulusError):
    """The board left the bus."""


class FlashMemory(Protocol):
    """What `write_flash` needs of a PicoBoot."""

    def exclusive_access(self) -> None: ...

    def exit_xip(self) -> None: ...

    def erase(self, address: int, size: int) -> None: ...

    def write(self, address: int, data: bytes) -> None: ...

    def read(self, address: int, size: int) -> bytes: ...


def write_flash(boot: FlashMemory, data: bytes, progress: Callable[[str, int, int], None] | None = None) -> None:
    """Put whole pages from FLASH_START on and read all of them back.

    The first sector is erased first and its first page, without which the boot ROM starts nothing, is written last,
    when all the rest has been read back: a board that is pulled out half-way comes up in its boot loader again.

    Raises AnnulusError where the flash reads back something else.
    """
    starts = range(0, len(data), SECTOR_BYTES)
    tell = progress or (lambda what, done, total: None)
    boot.exclusive_access()
    boot.exit_xip()
    for i, start in enumerate(starts):
        boot.erase(FLASH_START + start, SECTOR_BYTES)
        tell("erasing", i + 1, len(starts))
    for i, start in enumerate(starts):
        begin = start or PAGE_BYTES
        boot.write(FLASH_START + begin, data[begin : start + SECTOR_BYTES])
        tell("writing", i + 1, len(starts))
    for i, start in enumerate(starts):
        begin = start or PAGE_BYTES
        _compare(boot, begin, data[begin : start + SECTOR_BYTES])
        tell("reading back", i + 1, len(starts))
    boot.write(FLASH_START, data[:PAGE_BYTES])
    _compare(boot, 0, data[:PAGE_BYTES])


def _compare(boot: FlashMemory, begin: int, wanted: bytes) -> None:
    found = boot.read(FLASH_START + begin, len(wanted))
    if found != wanted:
        at = next(i for i, pair in enumerate(zip(found, wanted, strict=True)) if pair[0] != pair[1])
        raise AnnulusError(
            f"flash at {FLASH_START + begin + at:08x} reads {found[at]:02x}, written {wanted[at]:02x}."
            " The board stays in its boot loader: flash again, try another cable, then another board."
        )
