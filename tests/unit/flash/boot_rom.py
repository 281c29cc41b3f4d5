"""An RP2040 or RP2350 in its boot loader, as pyusb sees it: a backend that does what the boot ROM's own code does.

After raspberrypi/pico-bootrom-rp2040: usb_boot_device.c (descriptors, commands, stalls) and async_task.c (checks).
"""

import errno
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import usb.core

MSC_IN, MSC_OUT, OUT, IN = 0x81, 0x02, 0x03, 0x84
PICOBOOT = 1  # interface
FLASH, RAM, RAM_END = 0x10000000, 0x20000000, 0x20042000
SECTOR, PAGE = 4096, 256
OK, UNKNOWN_CMD, CMD_LENGTH, TRANSFER_LENGTH, ADDRESS, ALIGNMENT = 0, 1, 2, 3, 4, 5
REBOOTING = 7
# id: (size of its arguments, moves data)
COMMANDS = {1: (1, False), 2: (12, False), 3: (8, False), 4: (8, True), 5: (8, True), 6: (0, False), 7: (0, False)}
COMMANDS_RP2350 = {number: moves for number, moves in COMMANDS.items() if number != 2} | {10: (16, False)}


@dataclass
class Board:
    """One chip with its flash. Hooks break things: they are called where the real thing may fail."""

    bus: int = 1
    ports: tuple[int, ...] = (2,)
    address: int = 5
    serial: str = "E0C9125B0D9B"
    product: int = 0x0003
    flash: bytearray = field(default_factory=lambda: bytearray(b"\x55" * 256 * 1024))
    open_error: int | None = None  # errno that opening gives
    claim_error: int | None = None
    before: Callable[["Board", str], None] = lambda board, what: None  # may raise
    stuck_bits: dict[int, int] = field(default_factory=dict)  # address: bits that stay 0 when programmed
    has_picoboot: bool = True

    def __post_init__(self) -> None:
        self.plugged = True
        self.exclusive = self.xip_exited = self.rebooted = False
        self.commands: list[int] = []
        self.erased: list[int] = []
        self.programmed: list[int] = []
        self.claimed = False
        self.configure()

    def configure(self) -> None:
        self.halted: set[int] = set()
        self.status = (0, 0, 0, 0)  # token, code, command, in progress
        self.expect: tuple[int, int, int, int] | None = None  # id, address, size, left: data still to move
        self.ack: int | None = None  # endpoint on which the acknowledgement goes

    # ---- commands ----

    def packet(self, data: bytes) -> None:
        """What comes on the OUT endpoint while no transfer is under way."""
        if len(data) != 32 or data[:4] != struct.pack("<I", 0x431FD10B):
            self.halted |= {IN, OUT}
            return
        _, token, identity, size, _, transfer, arguments = struct.unpack("<IIBBHI16s", data)
        self.commands.append(identity)
        self.status = (token, UNKNOWN_CMD, identity, 0)
        commands = COMMANDS_RP2350 if self.product == 0x000F else COMMANDS
        known = commands.get(identity & 0x7F)
        if known is None:
            self.halted |= {IN, OUT}
            return
        address, length = struct.unpack_from("<II", arguments)
        if size != known[0] or transfer != (length if known[1] else 0):
            self.status = (token, CMD_LENGTH if size != known[0] else TRANSFER_LENGTH, identity, 0)
            self.halted |= {IN, OUT}
            return
        self.status = (token, OK, identity, 1)
        if known[1] and transfer:
            self.expect = (identity, address, length, length)
        else:
            self.task(identity, arguments)
            self.done(identity)

    def done(self, identity: int) -> None:
        self.status = (*self.status[:3], 0)
        self.expect = None
        self.ack = OUT if identity & 0x80 else IN

    def task(self, identity: int, arguments: bytes) -> None:
        """Commands without data. Whatever comes of it, it is acknowledged and the status stays OK: _atc_ack."""
        address, length = struct.unpack_from("<II", arguments)
        if identity == 1:
            self.before(self, "exclusive")
            self.exclusive = arguments[0] != 0
        elif identity in (2, 10):
            self.reboot_arguments = arguments
            self.before(self, "reboot")
            self.rebooted = True
        elif identity == 3:
            if address % SECTOR or length % SECTOR or not in_flash(address, length) or not self.xip_exited:
                return
            for sector in range(address, address + length, SECTOR):
                self.before(self, "erase")
                at = (sector - FLASH) % len(self.flash)
                self.flash[at : at + SECTOR] = b"\xff" * SECTOR
                self.erased.append(sector)
        elif identity == 6:
            self.xip_exited = True

    def chunk(self, identity: int, address: int, data: bytes) -> bytes | int:
        """One page of a transfer: what is read, or an error."""
        if self.rebooted:
            return REBOOTING
        if not in_flash(address, len(data)):
            return ADDRESS
        if address % PAGE:
            return ALIGNMENT
        at = (address - FLASH) % len(self.flash)
        if identity == 0x84:
            self.before(self, "read")
            return bytes(self.flash[at : at + len(data)])
        self.before(self, "write")
        if self.xip_exited:
            for i, byte in enumerate(data):
                self.flash[at + i] &= byte & ~self.stuck_bits.get(address + i, 0)
            self.programmed.append(address)
        return b""

    # ---- endpoints ----

    def out(self, data: bytes) -> int:
        if OUT in self.halted:
            raise usb_error(errno.EPIPE)
        if self.ack == OUT:
            assert len(data) <= 1, "a command before the acknowledgement of the last"
            self.ack = None
            return len(data)
        if self.ack == IN:
            raise usb_error(errno.ETIMEDOUT)
        if self.expect is None:
            self.packet(data)  # taken even if it is refused: the host sees the stall with its next transfer
            return len(data)
        identity, address, size, left = self.expect
        assert not identity & 0x80
        for at in range(0, len(data), PAGE):
            result = self.chunk(identity, address + at, data[at : at + PAGE])
            if isinstance(result, int):
                self.status = (self.status[0], result, identity, 0)
                self.halted.add(OUT)
                self.expect = None
                raise usb_error(errno.EPIPE)
        self.expect = (identity, address + len(data), size, left - len(data))
        if left == len(data):
            self.done(identity)
        return len(data)

    def into(self, size: int) -> bytes:
        if IN in self.halted:
            raise usb_error(errno.EPIPE)
        if self.ack == IN:
            self.ack = None
            return b""
        if self.expect is None or not self.expect[0] & 0x80:
            raise usb_error(errno.ETIMEDOUT)
        identity, address, _, left = self.expect
        assert size == left
        found = bytearray()
        for at in range(0, size, PAGE):
            result = self.chunk(identity, address + at, bytes(min(PAGE, size - at)))
            if isinstance(result, int):
                self.status = (self.status[0], result, identity, 0)
                self.halted.add(IN)
                self.expect = None
                raise usb_error(errno.EPIPE)
            found += result
        self.done(identity)
        return bytes(found)


def in_flash(address: int, length: int) -> bool:
    return address >= FLASH and address + length <= FLASH + 0x1000000


def usb_error(number: int) -> usb.core.USBError:
    kind = usb.core.USBTimeoutError if number == errno.ETIMEDOUT else usb.core.USBError
    return kind({errno.EPIPE: "Pipe error", errno.EACCES: "Access denied"}.get(number, "USB error"), -9, number)


def _endpoint(address: int) -> SimpleNamespace:
    return SimpleNamespace(
        bLength=7,
        bDescriptorType=5,
        bEndpointAddress=address,
        bmAttributes=2,
        wMaxPacketSize=64,
        bInterval=0,
        bRefresh=0,
        bSynchAddress=0,
        extra_descriptors=[],
    )


def _interface(number: int, kind: tuple[int, int, int]) -> SimpleNamespace:
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=4,
        bInterfaceNumber=number,
        bAlternateSetting=0,
        bNumEndpoints=2,
        bInterfaceClass=kind[0],
        bInterfaceSubClass=kind[1],
        bInterfaceProtocol=kind[2],
        iInterface=0,
        extra_descriptors=[],
    )


class Bus:
    """A pyusb backend with these boards on it."""

    def __init__(self, *boards: Board) -> None:
        self.boards = list(boards)

    def enumerate_devices(self) -> Iterator[Board]:
        return (board for board in self.boards if board.plugged)

    def get_parent(self, board: Board) -> None:
        return None

    def get_device_descriptor(self, board: Board) -> SimpleNamespace:
        return SimpleNamespace(
            bLength=18,
            bDescriptorType=1,
            bcdUSB=0x0110,
            bDeviceClass=0,
            bDeviceSubClass=0,
            bDeviceProtocol=0,
            bMaxPacketSize0=64,
            idVendor=0x2E8A,
            idProduct=board.product,
            bcdDevice=0x0100,
            iManufacturer=1,
            iProduct=2,
            iSerialNumber=3,
            bNumConfigurations=1,
            address=board.address,
            bus=board.bus,
            port_number=board.ports[-1],
            port_numbers=board.ports,
            speed=2,
        )

    def get_configuration_descriptor(self, board: Board, config: int) -> SimpleNamespace:
        if config:
            raise IndexError
        return SimpleNamespace(
            bLength=9,
            bDescriptorType=2,
            wTotalLength=55,
            bNumInterfaces=1 + board.has_picoboot,
            bConfigurationValue=1,
            iConfiguration=0,
            bmAttributes=0x80,
            bMaxPower=0xFA,
            extra_descriptors=[],
        )

    def get_interface_descriptor(self, board: Board, interface: int, alt: int, config: int) -> SimpleNamespace:
        if alt or config:
            raise IndexError
        return [_interface(0, (8, 6, 0x50)), _interface(PICOBOOT, (0xFF, 0, 0))][interface]

    def get_endpoint_descriptor(
        self, board: Board, endpoint: int, interface: int, alt: int, config: int
    ) -> SimpleNamespace:
        return _endpoint([[MSC_IN, MSC_OUT], [OUT, IN]][interface][endpoint])

    def open_device(self, board: Board) -> Board:
        self._there(board)
        if board.open_error is not None:
            raise usb_error(board.open_error)
        return board

    def close_device(self, board: Board) -> None:
        board.claimed = False

    def get_configuration(self, board: Board) -> int:
        return 1

    def claim_interface(self, board: Board, interface: int) -> None:
        assert interface == PICOBOOT, "the drive's interface is the kernel's"
        if board.claim_error is not None:
            raise usb_error(board.claim_error)
        board.claimed = True

    def release_interface(self, board: Board, interface: int) -> None:
        board.claimed = False

    def clear_halt(self, board: Board, endpoint: int) -> None:
        self._there(board)
        assert endpoint in board.halted, "clearing a halt that is none may cost the data toggle"
        board.halted.discard(endpoint)

    def ctrl_transfer(
        self, board: Board, kind: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> int:
        self._there(board)
        if (kind, request) == (0x80, 6) and value >> 8 == 3:
            return _answer(data, _string(board, value & 0xFF))
        if (kind, request) == (0x82, 0) and index in (IN, OUT):
            return _answer(data, bytes((index in board.halted, 0)))
        if (kind, request, index) == (0xC1, 0x42, PICOBOOT) and len(data) == 16:
            return _answer(data, struct.pack("<IIBB6x", *board.status))
        if (kind, request, index) == (0x41, 0x41, PICOBOOT):
            board.configure()
            return 0
        raise usb_error(errno.EPIPE)

    def bulk_write(self, board: Board, endpoint: int, interface: int, data: Any, timeout: int) -> int:
        self._there(board)
        assert (endpoint, interface, board.claimed) == (OUT, PICOBOOT, True)
        return board.out(data.tobytes())

    def bulk_read(self, board: Board, endpoint: int, interface: int, data: Any, timeout: int) -> int:
        self._there(board)
        assert (endpoint, interface, board.claimed) == (IN, PICOBOOT, True)
        return _answer(data, board.into(len(data)))

    def intr_write(self, *arguments: Any) -> int:
        raise NotImplementedError

    iso_write = intr_read = iso_read = intr_write

    def _there(self, board: Board) -> None:
        if not board.plugged:
            raise usb_error(errno.ENODEV)


def _answer(buffer: Any, data: bytes) -> int:
    size = min(len(buffer), len(data))
    for i in range(size):
        buffer[i] = data[i]
    return size


def _string(board: Board, index: int) -> bytes:
    if index == 0:
        return bytes((4, 3, 0x09, 0x04))
    text = ["Raspberry Pi", "RP2 Boot", board.serial][index - 1].encode("utf-16-le")
    return bytes((2 + len(text), 3)) + text
