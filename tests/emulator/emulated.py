"""The shipped image under test: the emulator as a child process, in virtual time, one command at a time."""

import itertools
import json
import os
import shutil
import struct
import subprocess
import zlib
from pathlib import Path
from typing import Any, TypeVar

from annulus_pipe.controller import PIN_LED, PIN_MICROWAVE, PIN_PROJECTOR, PIN_SYNC, PIN_TRIGGER, TICKS_PER_US
from annulus_pipe.flash.image import APPLICATION_AT, application, read_image
from annulus_pipe.link.codec import Decoder, Frame, encode
from annulus_pipe.link.messages import (
    LEVEL,
    SCHEMA_HASH,
    Arm,
    ArmFlag,
    Command,
    Commit,
    Event,
    Garbled,
    Identify,
    IdentifyReply,
    Info,
    InfoReply,
    Ping,
    Reply,
    Stage,
    StatusCode,
)
from annulus_pipe.selftest.rig import promises as promised

ROOT = Path(__file__).resolve().parents[2]
IMAGE = ROOT / "firmware/build/annulus.uf2"
ELF = Path(os.environ.get("ANNULUS_IMAGE", IMAGE)).with_suffix(".elf")
EMULATOR = ROOT / "tools/emulator/emulate.mjs"

MS = 1000 * TICKS_PER_US
BOOTED = 30 * MS  # boot ROM, loader, clocks, first event are over
LATENCY = 9  # from the pin's edge to the lamp's, beyond the programmed delay: the constant of the README
PERIOD = 4_000_000
ROUND_MAX = 500 * TICKS_PER_US  # of the main loop, its sleep not counted: a quarter of a microwave credit
OUTPUTS = (PIN_PROJECTOR, PIN_LED, PIN_MICROWAVE, PIN_TRIGGER)

E = TypeVar("E", bound=Event)


def made_image() -> Path:
    """The image under test and what runs it. ANNULUS_IMAGE when another one is to be judged, as tools/mutants.py does.

    Raises AssertionError naming the Debian package that is missing.
    """
    given = os.environ.get("ANNULUS_IMAGE")
    for tool, package in (("node", "nodejs"), ("arm-none-eabi-gcc", "gcc-arm-none-eabi")):
        if shutil.which(tool) is None and not (given and tool != "node"):
            raise AssertionError(f"{tool} is missing: Debian's {package}, which `make test` installs")
    if not (EMULATOR.parent / "node_modules/rp2040js").is_dir():
        subprocess.run(["npm", "ci", "--silent", "--no-audit", "--no-fund"], cwd=EMULATOR.parent, check=True)
    if given:
        return Path(given)
    subprocess.run(["make", "--silent", "-C", str(ROOT / "firmware"), "image"], check=True, stdout=subprocess.DEVNULL)
    return IMAGE


def made_image_of(image: Path, folder: Path, git: str) -> Path:
    """As if built at another commit: its identity and its CRC are the bytes in which that differs."""
    old = read_image(image)
    assert old.identity is not None
    if len(git) != len(old.identity.git):  # made outside of a checkout
        make = ["make", "--silent", "-C", str(ROOT / "firmware"), "image", f"BUILD={folder}", f"GIT={git}"]
        subprocess.run(make, check=True, stdout=subprocess.DEVNULL)
        return folder / "annulus.uf2"
    blocks = [bytearray(block) for (block,) in struct.iter_unpack("512s", image.read_bytes())]
    flash = b"".join(block[32:288] for block in blocks)
    assert old.data == flash
    flash = flash.replace(old.identity.git.encode(), git.encode())
    end = APPLICATION_AT + len(application(old).data)
    flash = flash[: end - 4] + struct.pack("<I", zlib.crc32(flash[APPLICATION_AT : end - 4])) + flash[end:]
    for i, block in enumerate(blocks):
        block[32:288] = flash[256 * i : 256 * i + 256]
    made = folder / "annulus.uf2"
    made.write_bytes(b"".join(blocks))
    return made


class EmulatorFault(Exception):
    """The image did what silicon would not forgive."""


_idle: list[subprocess.Popen[str]] = []  # emulators whose board is done with: the next board is built anew in them


def end(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.close()
    process.wait(30)


def end_idle() -> None:
    while _idle:
        end(_idle.pop())


class EmulatedBoard:
    """Ticks of 10 ns since power came on. `rises`, `falls` and `transitions` keep everything the pins ever did."""

    def __init__(
        self, image: Path = IMAGE, vcd: Path | None = None, flash_id: str | None = None, kind: str = "pico"
    ) -> None:
        self._image = image
        self._functions: dict[str, int] = {}
        self._keep = vcd is None  # the process, for another board
        taken = _idle.pop() if self._keep and _idle else None
        command = ["node", str(EMULATOR), str(image), "--drive", *(["--vcd", str(vcd)] if vcd else [])]
        command += ["--flash-id", flash_id] if flash_id else []
        command += ["--board", kind]
        self._process = taken or subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.now = 0
        self.transitions: list[tuple[int, int, int]] = []
        self.sent: list[tuple[int, int]] = []
        self.events: list[Event] = []
        self.event_sequences: list[int] = []
        self.replies: list[Reply] = []
        self.resets: list[int] = []
        self.stack = 0  # bytes, the deepest so far
        self.rounds = (0, 0)  # ticks the main loop's longest took, and when it began; set it to begin anew
        self.pulled_up = False  # D+, by the device
        self.longest = (0, 0)  # the same, of all
        self.origin = 0  # tick at which the controller began to count its own
        self.bootloader: dict[str, Any] | None = None  # what the image told the boot ROM, once it is there
        self.flash = {"erased": 0, "programmed": 0}  # sectors and pages since the beginning
        self.bad = 0
        self.over_usb = False  # talk and listen over USB; what the other line says goes to `aside`
        self.aside: list[Frame | object] = []
        self.usb: dict[str, Any] = {}  # the USB host's last report: state, descriptors, what it asked
        self.usb_controls: list[dict[str, str]] = []
        self.usb_bytes = 0  # received over USB
        self.usb_requests: list[tuple[int, bytes]] = []  # when, and the setup packet: what a kernel asked over USB/IP
        self._usb_decoder = Decoder()
        self._decoder = Decoder()
        self._sequence = itertools.count()
        if taken:
            try:
                self._do(op="anew", image=str(image), board=kind, **({"flash_id": flash_id} if flash_id else {}))
            except EmulatorFault:
                self.close()
                raise

    def close(self) -> None:
        if self._keep:
            _idle.append(self._process)
        else:
            end(self._process)

    def _do(self, **op: Any) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(op) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            self._keep = False
            raise EmulatorFault("the emulator ended")
        answer = json.loads(line)
        if "fault" in answer:
            self._keep = False
            raise EmulatorFault(f"{answer['fault']} (tick {answer['now']})")
        self.now, self.resets, self.stack = answer["now"], answer["resets"], answer["stack"]
        self.origin, self.bootloader = answer["origin"], answer["bootloader"]
        self.rounds = max(self.rounds, tuple(answer["round"]))
        self.longest = max(self.longest, tuple(answer["round"]))
        self.flash, self.pulled_up = answer["flash"], answer["pulled_up"]
        self.transitions += [tuple(pin) for pin in answer["pins"]]
        self.sent += [tuple(byte) for byte in answer["sent"]]
        heard = self._decoder.feed(bytes(byte for _, byte in answer["sent"]))
        over_usb: list[Any] = []
        if answer["usb"] is not None:
            self.usb = answer["usb"]
            self.usb_controls += self.usb["controls"]
            self.usb_requests += [
                (asked["tick"], bytes.fromhex(asked["setup"])) for asked in self.usb.get("requests", ())
            ]
            data = bytes.fromhex(self.usb["received"])
            self.usb_bytes += len(data)
            over_usb = list(self._usb_decoder.feed(data))
        self.aside += heard if self.over_usb else over_usb
        for item in over_usb if self.over_usb else heard:
            if not isinstance(item, Frame):
                self.bad += 1
            elif isinstance(item.message, Event):
                self.events.append(item.message)
                self.event_sequences.append(item.sequence)
            else:
                self.replies.append(item.message)

    def run(self, until: int) -> None:
        self._do(op="run", until=until)

    def run_to(self, function: str, within: int = 100 * MS) -> None:
        """Stop before the first instruction of a function of the image; at once called again, before the next call."""
        if not self._functions:
            elf = self._image.with_suffix(".elf")
            listed = subprocess.run(["arm-none-eabi-nm", elf], capture_output=True, text=True, check=True).stdout
            self._functions = {name: int(at, 16) & ~1 for at, _, name in map(str.split, listed.splitlines())}
        end = self.now + within
        self._do(op="run", until=end, at=self._functions[function])
        assert self.now < end, f"{function} was not called"

    def poke_dma_count(self, channel: int, count: int) -> None:
        """Transfers this channel has still to do, as if it had run for long."""
        self._do(op="dma-count", channel=channel, count=count)

    def age(self, microseconds: int) -> None:
        """The timer's count goes on by so much, as if the image had slept."""
        self._do(op="age", us=microseconds)

    def input(self, *edges: tuple[int, int, int]) -> None:
        self._do(op="input", edges=edges)

    def wire(self, *wires: tuple[int, int]) -> None:
        """Jumpers from an output to an input each, in place of those before."""
        self._do(op="wires", wires=wires)

    def let_go(self, pin: int) -> None:
        """An input's wire is off: its pad pulls it."""
        self._do(op="let-go", pin=pin)

    def pull(self, *pulls: tuple[int, int]) -> None:
        """Resistors outside at these outputs, to this level each, in place of those before."""
        self._do(op="pulls", pulls=pulls)

    def write(self, data: bytes) -> None:
        if self.over_usb:
            self.usb_do("write", hex=data.hex())
        else:
            self._do(op="write", hex=data.hex())

    def usb_do(self, what: str, **more: str | list[str]) -> None:
        """attach, detach, reset, suspend, resume, hang, open, close, write (hex), control (setup, data), controls
        (setups, one right after the other), abandon (setup: and nothing after it; or then, wait ticks later)."""
        self._do(op="usb", do=what, **more)

    def plug_in(self, within: int = 400 * MS) -> None:
        """Attach a USB host and wait until it has the port open; from then on talk over it."""
        self.usb_do("attach")
        end = self.now + within
        while not self.usb.get("open"):
            assert self.now < end, self.usb
            self.run(self.now + 5 * MS)
        self.over_usb = True

    def serve_usbip(self) -> int:
        """Plug it into a host that offers it over USB/IP, on this port of localhost. Its kernel commands it."""
        self._keep = False
        self._do(op="usbip", port=0)
        self.usb_do("attach")
        while self.usb["state"] != "offered":
            self.run(self.now + 5 * MS)
        port = self.usb["port"]
        assert isinstance(port, int)
        return port

    def control(self, setup: bytes, data: bytes = b"") -> tuple[str, bytes]:
        """One control transfer: ok, stall.., and what came in."""
        self.usb_controls.clear()
        self.usb_do("control", setup=setup.hex(), data=data.hex())
        while not self.usb_controls:
            self.run(self.now + MS)
        return self.usb_controls[0]["status"], bytes.fromhex(self.usb_controls[0]["data"])

    def stall(self, ticks: int) -> None:
        self._do(op="stall", ticks=ticks)

    def trap(self, function: str, what: str) -> int:
        """Once the image enters this function: "hang" there for ever, or take a hard "fault". Its address."""
        listed = subprocess.run(["arm-none-eabi-nm", str(ELF)], capture_output=True, text=True, check=True).stdout
        (at,) = [int(line.split()[0], 16) for line in listed.splitlines() if line.split()[-1] == function]
        self._do(op="trap", at=at, what=what)
        return at

    def power_cycle(self, *, short: bool = False, bootsel: bool = False) -> None:
        """Power off and on: the flash remembers, and, if it was `short`, the RAM; inputs stay, what the line had under
        way is lost. BOOTSEL may be held."""
        self._do(op="bootsel" if bootsel else "power-cycle", short=short)
        self._decoder = Decoder()

    def leave_bootloader(self) -> None:
        """As after a UF2 was copied: the boot ROM resets and starts the image."""
        self._do(op="leave-bootloader")

    def copy_uf2(self, image: Path) -> None:
        """In the boot loader: onto its drive, which starts it."""
        self._do(op="copy-uf2", file=str(image))

    def spoil_flash(self, at: int, data: bytes) -> None:
        self._do(op="flash", at=at, hex=data.hex())

    def spoil_ram(self, at: int, data: bytes) -> None:
        self._do(op="ram", at=at, hex=data.hex())

    def erase_takes(self, ticks: int) -> None:
        """A sector of flash, from now on."""
        self._do(op="flash", erase_ticks=ticks)

    def send(self, command: Command) -> None:
        self.write(encode(Frame(command, next(self._sequence) & 0xFF)))

    def request(self, command: Command, within: int = 10 * MS) -> Reply:
        """Send and wait for the answer, in virtual time."""
        self.replies.clear()
        self.send(command)
        end = self.now + within
        while not (mine := [reply for reply in self.replies if isinstance(reply, command.REPLY)]):
            assert self.now < end, f"no answer to {command}"
            self.run(self.now + MS // 2)
        return mine[0]

    def identify(self, within: int = 100 * MS) -> IdentifyReply:
        """As a host does: it asks until it is answered, since the board may be starting."""
        end = self.now + within
        while True:
            try:
                reply = self.request(Identify(protocol=1, schema=SCHEMA_HASH))
                break
            except AssertionError:
                if self.now >= end or self.bootloader:
                    raise
        assert isinstance(reply, IdentifyReply)
        self.replies.clear()
        self.send(Info(level=LEVEL))  # from here on nothing is held back; an older image says garbled
        end = self.now + 10 * MS
        while not any(isinstance(answer, InfoReply | Garbled) for answer in self.replies) and self.now < end:
            self.run(self.now + MS // 4)
        return reply

    def run_alive(self, until: int, every: int = 20 * MS) -> None:
        """Run, with a ping now and then, as a host would."""
        while self.now < until:
            self.send(Ping())
            self.run(min(until, self.now + every))

    def pulse(self, tick: int, low: int = 10_000) -> None:
        self.input((tick, PIN_SYNC, 0), (tick + low, PIN_SYNC, 1))

    def rises(self, pin: int) -> list[int]:
        return [tick for tick, p, level in self.transitions if p == pin and level == 1]

    def falls(self, pin: int) -> list[int]:
        return [tick for tick, p, level in self.transitions if p == pin and level == 0]

    def widths(self, pin: int) -> list[int]:
        """Of every pulse."""
        return [fall - rise for rise, fall in zip(self.rises(pin), self.falls(pin), strict=True)]

    def heard(self, kind: type[E]) -> list[E]:
        return [event for event in self.events if isinstance(event, kind)]


def configuration(*, delay: int = 300_000, width: int = 200_000, **changes: int) -> Stage:
    """As the promises have it, with flashes of a length of their own."""
    return promised.configuration(delay=delay, width=width, **changes)


def arm(board: EmulatedBoard, outputs: ArmFlag = ArmFlag.LAMPS, **changes: int) -> None:
    board.identify()
    for command in (configuration(**changes), Commit(generation=changes.get("generation", 1)), Arm(outputs=outputs)):
        assert board.request(command).status == StatusCode.OK


def edges_from(board: EmulatedBoard, count: int, period: int = PERIOD, jitter: int = 13) -> list[int]:
    """Edges one period apart but for a few ticks, so that every phase of the state machines meets one."""
    first = board.now + MS
    return [first + i * period + (i * 7) % jitter for i in range(count)]


def lamps_after(board: EmulatedBoard, edges: list[int]) -> list[int]:
    """Which lamp rose after each edge, and nothing else may have."""
    rises = sorted((tick, pin) for pin in (PIN_PROJECTOR, PIN_LED) for tick in board.rises(pin))
    assert len(rises) == len(edges)
    return [pin for _, pin in rises]
