"""Plays scenes on a board as a host would, and keeps what was said and heard for tools.attack.truth to judge."""

import itertools
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

from annulus_pipe.controller import (
    PIN_CAMERA_TRIGGER,
    PIN_DIRECTION,
    PIN_ENABLE,
    PIN_END_HIGH,
    PIN_END_LOW,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    PIN_LED,
    PIN_MICROWAVE,
    PIN_PROJECTOR,
    PIN_STEP,
    PIN_SYNC,
    PIN_TRIGGER,
    PIN_VBUS,
    TURNTABLE_LAG_MS,
)
from annulus_pipe.link.codec import Decoder, Frame, encode
from annulus_pipe.link.messages import (
    LEVEL,
    SCHEMA_HASH,
    Arm,
    ArmFlag,
    Booted,
    BurstReply,
    BurstStop,
    CameraTrigger,
    Clear,
    Command,
    Commit,
    Event,
    Health,
    HealthReply,
    Identify,
    Info,
    InfoReply,
    Interlock,
    InterlockFlag,
    Pattern,
    Polarity,
    PolarityFlag,
    Reply,
    Reread,
    Reset,
    Stage,
    StateFlag,
    Status,
    StatusCode,
    StatusReply,
    UpdateEnd,
)
from tools.attack.boards import MS, UART, USB, Board, BrokenPromiseError, Edge, Heard
from tools.attack.kept import OPENS, Asked, Kept, Told, Trigger, accepted, edges_of
from tools.attack.scenes import Scene
from tools.attack.updates import Update, leaves, sent

BYTE_TICKS = 1000
PATIENCE = 30 * MS  # for an answer, a full line of events before it
STAGES_WITHIN = 10_000 * MS  # a whole application, 45 ms for each of its sectors
REPLUG_TAKES = 500 * MS
STANDS_WITHIN = 410 * MS  # the turntable, along the slowest ramp of a scene, its driver's lead before it
LAG = TURNTABLE_LAG_MS * MS + MS  # until its power is surely gone
FLASH_TAKES = 1000 * MS  # for what an update has in hand: two sectors, at most
RESET_TAKES = 700 * MS  # with the loader's work, and what the flash has in hand
MOTOR = (PIN_STEP, PIN_DIRECTION, PIN_ENABLE)


AS_DRAWN = PolarityFlag(0)
INVERTIBLE = {
    PIN_SYNC: PolarityFlag.SYNC,
    PIN_PROJECTOR: PolarityFlag.PROJECTOR,
    PIN_LED: PolarityFlag.LED,
    PIN_MICROWAVE: PolarityFlag.MICROWAVE,
    PIN_TRIGGER: PolarityFlag.TRIGGER,
    PIN_CAMERA_TRIGGER: PolarityFlag.CAMERA_TRIGGER,
}


class Player:
    """One board, from power on. Everybody else finds its pins as if none of them were inverted."""

    def __init__(self, board: Board, inverted: PolarityFlag = AS_DRAWN) -> None:
        self.board = board
        self.inverted = inverted
        self._turned = {pin for pin, flag in INVERTIBLE.items() if flag & inverted}
        self._origin = board.origin
        self._staging: Iterator[Command] | None = None  # of an update under way
        self._due: Asked | None = None  # the one of them that is on its way
        self.done: deque[str] = deque(maxlen=30)
        self.kept = Kept()
        self.high: dict[int, int] = {}  # pins that are high, since when
        self.high_since_boot = 0
        self.motor: list[Edge] = []  # transitions of the turntable's pins, until somebody takes them
        self._trigger: Trigger | None = (0, 0, 0)
        self._plugged = False
        self._deaf = False  # plugged in again, a host hears nothing until it says at which level it speaks
        self._sequence = [itertools.count(), itertools.count()]
        self._decoders = (Decoder(), Decoder())
        self._line_free = [0, 0]
        self._boot: int | None = None
        self._past: set[int] = set()  # the boot before
        self.next_index = 0  # of the newest event, one more
        self.edges = 0  # falling edges played so far
        self.line = UART
        self.level = LEVEL  # the controller's, if that is lower
        if inverted:
            self.input([(board.now, PIN_SYNC, 1)])
            board.pull_up([pin for pin in self._turned if pin != PIN_SYNC])
        self._look(board.run(board.now + MS))

    # ---- to the controller ----

    def send(self, line: int, command: Command) -> Asked:
        sequence = next(self._sequence[line]) & 0xFF
        data = encode(Frame(command, sequence))
        begin = max(self.board.now, self._line_free[line])
        self._line_free[line] = begin + BYTE_TICKS * len(data)
        asked = Asked(command, line, sequence, self.board.now, self._line_free[line])
        self.kept.asked.append(asked)
        self.board.write(line, data)
        self.note(f"line {line}: {command}")
        return asked

    def request(self, command: Command, line: int | None = None) -> Reply | None:
        """None when nothing came: the controller has gone, or the line has."""
        asked = self.send(self.line if line is None else line, command)
        end = asked.through + PATIENCE
        while asked.reply is None and self.board.now < end:
            self.run(self.board.now + MS // 5)
        return asked.reply

    def note(self, what: str) -> None:
        self.done.append(f"{self.board.now:>12} {what}")

    def run(self, until: int) -> None:
        while until > self.board.now:  # in pieces, in which no tick wraps
            self._look(self.board.run(min(until, self.board.now + 10_000 * MS)))

    def input(self, edges: list[Edge]) -> None:
        self.board.input([(tick, pin, level ^ (pin in self._turned)) for tick, pin, level in edges])

    # ---- from the controller ----

    def _look(self, heard: Heard) -> None:
        for tick, pin, at_the_pad in heard.transitions:
            level = at_the_pad ^ (pin in self._turned)
            if pin in MOTOR:
                self.motor.append((tick, pin, level))
            if pin in (PIN_DIRECTION, PIN_ENABLE):
                continue
            if level:
                self.high[pin] = tick
            else:
                self.kept.pulses.setdefault(pin, []).append((self.high.pop(pin, 0), tick))
        for line, data in enumerate(heard.lines):
            for item in self._decoders[line].feed(data) if data else ():
                if not isinstance(item, Frame):
                    continue  # cut short by a reset or a plug
                if isinstance(item.message, Event):
                    self._event(item.message, item)
                elif isinstance(item.message, Reply):
                    self._reply(line, item.message, item.sequence)
        if self._staging and (self._due is None or self._due.reply):
            early = self._due and isinstance(self._due.command, UpdateEnd)
            if self._due and not accepted(self._due) and not early:
                self._staging = None  # given up, or ended by a reset
            elif following := next(self._staging, None):
                self._due = self.send(self.line, following)
            else:
                self._staging = None

    def world(self, tick: int) -> int:
        """Of a tick the controller counted in the last 40 s, or will in the next 3."""
        behind = (self.board.now - self._origin - tick) & 0xFFFFFFFF
        return self.board.now - (behind if behind < 4_000_000_000 else behind - (1 << 32))

    def _event(self, event: Event, frame: Frame) -> None:
        if frame.boot in self._past:
            return  # the other line was slower
        if frame.boot != self._boot:
            self._past = {self._boot} if self._boot is not None else set()
            self.kept.boots += self._boot is not None
            self.kept.before += [self.kept.told[index] for index in sorted(self.kept.told)]
            self._boot, self.next_index, self._origin = frame.boot, 0, self.board.origin
            self._staging = self._due = None
            self.kept.told.clear()
            self.kept.times_told.clear()
        ahead = ((frame.sequence - self.next_index + 0x8000) & 0xFFFF) - 0x8000
        index = self.next_index + ahead
        self.next_index = max(self.next_index, index + 1)
        if isinstance(event, Booted):
            self.high_since_boot = self.board.now
        if self._deaf:
            return
        if index not in self.kept.told:
            self.kept.told[index] = Told(index, event, self.world(event.tick))  # type: ignore[attr-defined]
        self.kept.times_told.setdefault(index, []).append(self.board.now)

    def _reply(self, line: int, reply: Reply, sequence: int) -> None:
        for asked in reversed(self.kept.asked[-300:]):
            if asked.line == line and asked.sequence == sequence and isinstance(reply, asked.command.REPLY):
                if asked.reply is None:
                    asked.reply, asked.answered = reply, self.board.now
                    if isinstance(reply, BurstReply):
                        asked.start = self.world(reply.start)
                return

    # ---- a scene ----

    def play(self, scene: Scene) -> bool:
        """False: the board could not be brought to the beginning, which only an unplugged line may do."""
        self._prepare(scene)
        begin = self.board.now + MS
        self.kept.began = begin
        self.kept.falls = [begin + tick for tick in scene.falls]
        contacts = (PIN_INTERLOCK, PIN_INTERLOCK_ANTIVALENT) if scene.antivalent else (PIN_INTERLOCK,)
        opened = [tick for tick, pin, level in scene.inputs if pin in contacts and level == OPENS[pin]]
        self.kept.opened = [begin + tick for tick in opened]
        self.note(f"scene begins: {scene.config}, sync from {begin + scene.falls[0]}, {len(scene.falls)} edges")
        self.input([(begin + tick, pin, level) for tick, pin, level in scene.inputs])
        for tick, what, line, value in scene.actions:
            self.run(begin + tick)
            self._act(what, line, value)
        last = max([scene.end, *(tick for tick, _, _ in scene.inputs)])
        self.run(begin + last)
        self.run(max(end for _, end in [*self.kept.stalls, (0, 0)]) + MS)
        self._finish(scene)
        self._trigger = edges_of(self.kept)
        self.edges += len(self.kept.falls)
        return True

    def _act(self, what: str, line: int, value: object) -> None:
        if what == "send" and isinstance(value, Command):
            if self.level < value.SINCE:
                return
            waiting = [asked for asked in self.kept.asked[-20:] if asked.line == line and asked.reply is None]
            if (line == UART or self.board.connected()) and len(waiting) < 6:
                self.send(line, value)
        elif what == "stall" and isinstance(value, int):
            self.note(f"main loop stands still for {value} ticks")
            self.kept.stalls.append((self.board.now, self.board.now + value))
            self.board.stall(value)
        elif what == "update" and isinstance(value, Update):
            self._staging, self._due = sent(value, self.board.name), None
        elif what == "noise" and isinstance(value, bytes):
            self.note(f"line {line}: noise {value.hex()}")
            self.kept.noise.append(line)
            if line == UART:
                self.board.write(line, value)
        elif what == "plug" and bool(value) != self._plugged:
            self.note(f"USB {'plugged' if value else 'unplugged'}")
            if not value:
                self.kept.unplugged.append(self.board.now)
            self._deaf |= bool(value) and self.line == USB
            self._plug(bool(value))
        elif what == "vbus" and isinstance(value, int):
            self.note(f"VBUS gone for {value} ticks")
            self.kept.unplugged.append(self.board.now)
            self._deaf |= self.line == USB
            self.board.input([(self.board.now, PIN_VBUS, 0), (self.board.now + value, PIN_VBUS, 1)])

    def _plug(self, plugged: bool) -> None:
        self._plugged = plugged
        self.board.plug(plugged)

    def _prepare(self, scene: Scene) -> None:
        board = self.board
        self.kept = Kept(began=board.now)
        self.input([(board.now, pin, 0) for pin in (PIN_INTERLOCK, PIN_END_LOW, PIN_END_HIGH)])
        self.input([(board.now, PIN_SYNC, 1), (board.now, PIN_INTERLOCK_ANTIVALENT, 1)])
        if scene.erase:
            board.erase_takes(scene.erase)
        self.line, self._deaf = scene.line, False
        if scene.line == USB and not board.connected():
            self._plug(True)
            end = board.now + 500 * MS
            while not board.connected() and board.now < end:
                self.run(board.now + 5 * MS)
        elif scene.line == UART and board.connected():
            self._plug(False)
        self.run(board.now + 5 * MS)
        self.kept = Kept(began=board.now, trigger=self._trigger)
        self._must(Arm(outputs=ArmFlag(0)))
        self._identify(scene.level)
        self._must(Clear())
        reply = self.request(scene.config)
        if reply and reply.status == StatusCode.DUTY:  # too bright for the earliest edge it lets through
            scene.config = dimmed(scene.config)
            self._must(scene.config)
        config = scene.config
        chips = sum(1 << i for i, chip in enumerate(scene.chips) if chip == "1")
        if scene.level == LEVEL and self.level == LEVEL:
            self._must(Polarity(config.generation, self.inverted))
            self._must(CameraTrigger(config.generation, *scene.trigger))
            self._must(Interlock(InterlockFlag.ANTIVALENT if scene.antivalent else InterlockFlag(0)))
        self._must(Commit(generation=config.generation))
        self._must(Pattern(length=len(scene.chips), chips=chips.to_bytes(32, "little")))
        if scene.turntable and self.level == LEVEL:
            self._must(scene.turntable)
        if scene.preamble and self.level >= scene.preamble.SINCE and scene.level >= scene.preamble.SINCE:
            self._must(scene.preamble)
        self.kept.told.clear()
        self.kept.first = self._status()
        self.kept.health_before = self._health()
        if scene.outputs:
            self._must(Arm(outputs=scene.outputs))

    def _must(self, command: Command) -> Reply:
        reply = self.request(command)
        if reply is None:
            raise BrokenPromiseError(f"no answer to {command}")
        if reply.status != StatusCode.OK:
            raise BrokenPromiseError(f"a legal order refused: {reply} to {command}")
        return reply

    def _identify(self, level: int) -> None:
        self._must(Identify(protocol=1, schema=SCHEMA_HASH))
        if self.level == LEVEL and level > 1:
            reply = self.request(Info(level=LEVEL))
            self.level = reply.level if isinstance(reply, InfoReply) else 1

    def _status(self) -> StatusReply:
        reply = self._must(Status())
        assert isinstance(reply, StatusReply)
        return reply

    def _health(self) -> HealthReply | None:
        reply = self.request(Health())
        return reply if isinstance(reply, HealthReply) else None

    def _finish(self, scene: Scene) -> None:
        """Dark, quiet, and every event that can be had."""
        end = self.board.now + STAGES_WITHIN
        while self._staging and self.board.now < end:
            self.run(self.board.now + MS)
        self._staging = None  # after what is on its way, once the flash has time for it
        end = self.board.now + FLASH_TAKES
        while self._due and self._due.reply is None and self.board.now < end and not self.kept.boots:
            self.run(self.board.now + 5 * MS)
        self._due = None
        resets = [asked for asked in self.kept.asked if isinstance(asked.command, Reset) or leaves(asked)]
        if resets:
            end = self.board.now + RESET_TAKES
            due = max(1, sum(asked.reply is None or accepted(asked) for asked in resets))
            while self.kept.boots < due and self.board.now < end:
                self.run(self.board.now + MS // 5)
            if self.kept.boots:  # what comes next finds the board as the reset left it
                self.line = UART
                self.kept.last = self._status()
                return
        if self._deaf:
            end = self.board.now + REPLUG_TAKES
            while not self.board.connected() and self.board.now < end:
                self.run(self.board.now + 5 * MS)
            self.run(self.board.now + MS)
            if self.board.connected():
                self._identify(scene.level)
            self._deaf = False
        if scene.line == USB and not self.board.connected():
            self.line = UART
            self.run(self.board.now + 5 * MS)
            self.request(Arm(outputs=ArmFlag(0)))
            self._identify(scene.level)
        if self.request(BurstStop()) is None and not self.kept.stalls:
            raise BrokenPromiseError("no answer to BurstStop")
        end = self.board.now + 150 * MS
        while self.board.now < end and self._status().state & 8:
            self.run(self.board.now + 2 * MS)
        self._must(Arm(outputs=ArmFlag(0)))
        end = self.board.now + STANDS_WITHIN
        while self._status().state & StateFlag.TURNTABLE_MOVING:
            if self.board.now > end:
                raise BrokenPromiseError("the turntable still moves, though everything was disarmed")
            self.run(self.board.now + 5 * MS)
        self.run(self.board.now + 6 * MS + (LAG if self.motor else 0))
        self.kept.health = self._health()
        if self.kept.lost:
            self.run(self.board.now + 101 * MS)  # it is said at most once in 100 ms
        self.kept.last = self._status()
        first = self.kept.first.events if self.kept.first and not self.kept.boots else 0
        for _ in range(6):
            # Only those of this scene; numbered by the controller modulo 65536.
            newest = self.next_index + ((self.kept.last.events - self.next_index + 0x8000) & 0xFFFF) - 0x8000
            oldest = newest - ((newest - first) & 0xFFFF)
            missing = [i for i in range(max(oldest, newest - 64), newest) if i not in self.kept.told]
            if not missing:
                break
            span = min(64, missing[-1] - missing[0] + 1)
            self.request(Reread(first=missing[0] & 0xFFFF, count=span))
            self.run(self.board.now + span * 50 * BYTE_TICKS + MS)
        self.kept.last = self._status()


def dimmed(config: Stage) -> Stage:
    most = (config.frame_period - config.frame_period * config.tolerance // 1000) // 2
    return replace(config, projector_width=min(most, config.projector_width), led_width=min(most, config.led_width))
