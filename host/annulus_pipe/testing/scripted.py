"""A controller without physics, for tests of the host's side: it keeps the rules of protocol/README.md, no more.
And a bad line to it.
"""

import random
from collections import deque

from annulus_pipe.controller import TICK_HZ
from annulus_pipe.link.codec import TO_CONTROLLER, Decoder, Frame, crc16, encode
from annulus_pipe.link.messages import (
    COMMANDS,
    EVENT_RING,
    LEVEL,
    PROTOCOL_VERSION,
    SCHEMA_HASH,
    Arm,
    ArmReply,
    BoardKind,
    BootCause,
    Booted,
    CameraTrigger,
    CameraTriggerReply,
    Clear,
    ClearReply,
    Command,
    Commit,
    CommitReply,
    Configuration,
    ConfigurationReply,
    Edge,
    Event,
    FaultCode,
    Garbled,
    Hardware,
    HardwareReply,
    Identify,
    IdentifyReply,
    Image,
    ImageFlash,
    ImageReply,
    ImageWhy,
    Info,
    InfoReply,
    Interlock,
    InterlockFlag,
    InterlockReply,
    Move,
    MoveReply,
    Ping,
    PingReply,
    Polarity,
    PolarityFlag,
    PolarityReply,
    Preamble,
    PreambleReply,
    Presence,
    Reply,
    Reread,
    RereadReply,
    Slides,
    SlidesLit,
    SlidesLitReply,
    SlidesReply,
    Stage,
    StageReply,
    StateFlag,
    Status,
    StatusCode,
    StatusReply,
    Wiring,
    WiringReply,
)

REPLIES_KEPT = 8


class ScriptedController:
    """Carries commands out at most once as long as a host keeps to its window."""

    def __init__(self, boot: int = 7, *, schema: int = SCHEMA_HASH, level: int = LEVEL) -> None:
        self.schema = schema
        self.level = level
        self.nonce = 0x1000
        self.in_force: Stage | None = None
        self.refuse: dict[type[Command], tuple[StatusCode, int]] = {}
        self.executed: list[Command] = []  # over all lives
        self.armed = False
        self.fault = FaultCode.NONE
        self._start(boot)

    def _start(self, boot: int) -> None:
        self.boot = boot
        self.tick_origin_ns: int | None = None
        self._decoder = Decoder({id_: kind for id_, kind in TO_CONTROLLER.items() if self.level >= kind.SINCE})
        self.nonce += 1
        self.edges = 0
        self._staged: Stage | None = None
        self._staged_inverted = self.inverted = PolarityFlag(0)
        self._staged_slides = self.slides = 1
        self._staged_trigger = self.trigger = (0, 0)
        self.in_force = None
        self._kept: deque[tuple[Command, int, bytes]] = deque(maxlen=REPLIES_KEPT)
        self._ring: dict[int, Event] = {}
        self._next = 0
        self._bad = 0
        self._out = bytearray()
        self.armed = False

    def power_cycle(self) -> None:
        """Begins anew with the same boot byte, and nobody hears it."""
        self._start(self.boot)
        self.emit(Booted(BootCause.POWER_ON, 0), reach_the_line=False)

    def reset(self) -> None:
        self._start((self.boot + 1) % 256)
        self.emit(Booted(BootCause.HOST_RESET, 0))

    def emit(self, event: Event, *, reach_the_line: bool = True) -> int:
        if isinstance(event, Edge):
            self.edges = event.edge + 1
        sequence = self._next
        self._next = (self._next + 1) % 65536
        self._ring[sequence] = event
        if len(self._ring) > EVENT_RING:
            del self._ring[next(iter(self._ring))]
        if reach_the_line:
            self._out += encode(Frame(event, sequence, self.boot))
        return sequence

    def take(self) -> bytes:
        out = bytes(self._out)
        self._out.clear()
        return out

    def receive(self, data: bytes, now: int) -> None:
        if self.tick_origin_ns is None:
            self.tick_origin_ns = now
        for frame in self._decoder.feed(data):
            if not isinstance(frame, Frame):
                self._bad += 1
                self._out += encode(Frame(Garbled(self._bad % 65536), 0))
                continue
            command = frame.message
            assert isinstance(command, Command)
            for kept, sequence, wire in self._kept:
                if not kept.QUERY and (kept, sequence) == (command, frame.sequence):
                    self._out += wire
                    break
            else:
                self.executed.append(command)
                reply = self._execute(command, now)
                wire = encode(Frame(reply, frame.sequence))
                self._kept.append((command, frame.sequence, wire))
                self._out += wire
                if isinstance(command, Reread) and isinstance(reply, RereadReply):
                    for at in range(reply.count):
                        again = (reply.first + at) % 65536
                        self._out += encode(Frame(self._ring[again], again, self.boot))

    def _execute(self, command: Command, now: int) -> Reply:
        status, detail = self.refuse.get(type(command), (StatusCode.OK, 0))
        ok = (status, detail)
        tick = (now - (self.tick_origin_ns or 0)) // 10 % 2**32
        match command:
            case Identify():
                self._kept.clear()
                if command.schema != self.schema:
                    ok = (StatusCode.SCHEMA, 0)
                return IdentifyReply(
                    *ok,
                    PROTOCOL_VERSION,
                    self.schema,
                    self.boot,
                    BootCause.POWER_ON,
                    TICK_HZ,
                    b"deadbeef",
                    b"scripted",
                    2_000_000,
                    500,
                    30,
                    3000,
                )
            case Ping():
                return PingReply(*ok, tick)
            case Status():
                state = StateFlag.LAMPS_ARMED if self.armed else StateFlag(0)
                held = self.in_force.generation if self.in_force else 0
                return StatusReply(*ok, state, self.fault, held, self.edges, 0, 0, 0, self._next, 0, 0, 0, 0)
            case Info():
                ids = (id_ for id_, kind in COMMANDS.items() if self.level >= kind.SINCE)
                known = sum(1 << id_ for id_ in ids).to_bytes(8, "little")
                return InfoReply(*ok, self.level, 0, 1, 0, b"0" * 16, known, 0xFF, self.nonce, 0, 0, 1000)
            case Configuration():
                stage = self.in_force or Stage(0, *[0] * 10)
                crc = crc16(stage.pack(), Stage.SCHEMA_BYTE) if self.in_force else 0
                return ConfigurationReply.unpack(bytes(ok) + stage.pack() + crc.to_bytes(2, "little"))
            case Image():
                return ImageReply(*ok, 0, 0, ImageWhy.RECORDED, ImageFlash.WHOLE, 0xDEADBEEF)
            case Hardware():
                return HardwareReply(*ok, BoardKind.UNKNOWN, Presence.UNKNOWN, InterlockFlag(0))
            case Interlock(inputs):
                return InterlockReply(*ok, inputs)
            case Preamble(length, interval):
                return PreambleReply(*ok, length, interval)
            case Stage(generation):
                self._staged, self._staged_inverted = command, self.inverted
                self._staged_trigger, self._staged_slides = self.trigger, self.slides
                return StageReply(*ok, generation, 0, 0)
            case Commit(generation):
                self.in_force, self.inverted = self._staged, self._staged_inverted
                self.trigger, self.slides = self._staged_trigger, self._staged_slides
                return CommitReply(*ok, generation)
            case Polarity(generation, inverted):
                self._staged_inverted = inverted
                return PolarityReply(*ok, generation, inverted)
            case CameraTrigger(generation, width, delay):
                self._staged_trigger = width, delay
                return CameraTriggerReply(*ok, generation, width, delay)
            case Slides(generation, count):
                self._staged_slides = count
                return SlidesReply(*ok, generation, count)
            case SlidesLit():
                held = self.in_force.generation if self.in_force else 0
                return SlidesLitReply(*ok, held, self.slides, self.slides if held else 0)
            case Wiring():
                held = self.in_force.generation if self.in_force else 0
                return WiringReply(*ok, held, self.inverted, PolarityFlag(0), *self.trigger)
            case Arm(outputs):
                self.armed = bool(outputs) and status is StatusCode.OK
                return ArmReply(*ok, outputs)
            case Clear():
                self.fault = FaultCode.NONE
                return ClearReply(*ok, FaultCode.NONE)
            case Move(position):
                return MoveReply(*ok, position)
            case Reread(first, count) if status is StatusCode.OK:
                there = [s for s in ((first + i) % 65536 for i in range(count)) if s in self._ring]
                if not there:
                    return RereadReply(StatusCode.GONE, 0, first, 0)
                return RereadReply(StatusCode.OK, 0, there[0], len(there))
            case Reread(first):
                return RereadReply(*ok, first, 0)
        raise AssertionError(command)


class BadLine:
    """Drops, flips, inserts and doubles bytes, each with the same chance."""

    def __init__(self, seed: int, rate: float) -> None:
        self._random = random.Random(seed)
        self.rate = rate

    def carry(self, data: bytes) -> bytes:
        out = bytearray()
        for byte in data:
            match self._random.randrange(4) if self._random.random() < self.rate else None:
                case None:
                    out.append(byte)
                case 0:
                    pass
                case 1:
                    out.append(byte ^ (1 << self._random.randrange(8)))
                case 2:
                    out += bytes((byte, self._random.randrange(256)))
                case _:
                    out += bytes((byte, byte))
        return bytes(out)
