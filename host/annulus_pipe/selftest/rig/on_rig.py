"""The board at the other end of the rig's jumpers.

Two Picos have two crystals. The rig's clock is held against the controller's once (`compare_clocks`): two edges of the
sync input some tenths of a second apart, which the rig played and the controller stamped. Every time of a scene is then
given in the controller's ticks. Where edges of the sync input are played in a scene, their stamps also tell the
controller's own count at its begin.
"""

import contextlib
import random
import statistics
import time
from collections.abc import Sequence

from annulus_pipe.controller import (
    PIN_DIRECTION,
    PIN_ENABLE,
    PIN_END_HIGH,
    PIN_END_LOW,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_SYNC,
    TURNTABLE_POSITION_MAX_STEPS,
)
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    CameraTrigger,
    Clear,
    Command,
    Commit,
    Edge,
    Event,
    IdentifyReply,
    Interlock,
    InterlockFlag,
    Polarity,
    PolarityFlag,
    Reply,
    Reset,
    Status,
    Turntable,
    TurntableFlag,
)
from annulus_pipe.link.problems import too_old
from annulus_pipe.link.session import Answer, EventReceived, Unanswered, identify
from annulus_pipe.selftest.rig.board import MS, EdgeIn, Fine, NotKeptError, Played, Scene
from annulus_pipe.selftest.rig.promises import camera, configuration
from annulus_pipe.selftest.rig.recording import merged, play_list, samples, track
from annulus_pipe.selftest.rig.wire import (
    AREA_WORDS,
    CUED_AT,
    LIST_WORDS,
    NONE,
    PLAYED_AT,
    SAMPLER_TRACK,
    TRACK_ODD,
    TRACKS,
    WORDS_MAX,
    Area,
    Record,
    RigLine,
    RigState,
)
from annulus_pipe.vocabulary import AnnulusError

HIGH_AT_REST = (PIN_SYNC, PIN_INTERLOCK_ANTIVALENT, PIN_ODOMETER_A, PIN_ODOMETER_B)
DRIVEN = (*HIGH_AT_REST, PIN_INTERLOCK, PIN_END_LOW, PIN_END_HIGH)
AT_REST = sum(1 << pin for pin in HIGH_AT_REST)  # interlock and end switches closed
SLOW_PINS = (PIN_DIRECTION, PIN_ENABLE)  # known to some microseconds
BEGINS = 100  # ticks: the first edge of a scene at the earliest
COMPARED_MS = 200  # one tick of it is 0.05 ppm
PPM_MAX = 200.0  # two crystals of 30 ppm differ by less; more is no Pico, or not 100 MHz
# A level that changes within a tick is taken at its end, by either board, and stands in that tick: on the average half
# a tick later, half of one earlier, than the number says.
TAKEN_AT, SEEN_AT = 0.5, 0.5
STAMP_OFF = 3.0  # ticks by which a stamp may miss its edge and still be believed to be its
OWED_MS = 80  # the most dark a burst can owe is 77 ms
EARLY_S = 30.0  # a scene that long overdue will not end
OPENINGS = 3  # of a second each: nobody is there
REFUSABLE_S = 10.0
GOES_S, RETURNS_S, READ_S = 0.5, 8.0, 0.05  # a port whose board restarts
FRAME = 200_000  # ticks, between two promises: the shortest, so that no hold-off of it lasts into the next one
PASSES = 4  # runs of noise for a question


class FloodingClient(Client):
    """A host that also talks nonsense."""

    def noise(self, rng: random.Random) -> None:
        for _ in range(PASSES):
            self._port.write(rng.randbytes(80) + b"\0")


def _identified(device: str) -> FloodingClient:
    """Asked again: an emulated board on a busy machine may stand still for longer than a link repeats a question."""
    for _ in range(OPENINGS - 1):
        with contextlib.suppress(AnnulusError):
            return FloodingClient(device)
    return FloodingClient(device)


class RigBoard:
    """A controller behind `device`, its pins behind `rig`. Closes both."""

    def __init__(self, device: str, rig: str) -> None:
        self.rig = RigLine(rig)
        try:
            self.client = _identified(device)
        except AnnulusError:
            self.rig.close()
            raise
        self.device = device
        self.ratio = 1.0  # ticks of the rig in one of the controller's
        self._levels = AT_REST
        self._drive = sum(1 << pin for pin in DRIVEN)
        self.slow_pins: tuple[int, ...] = SLOW_PINS
        self._rng = random.Random(1)
        self._news: list[Event] = []
        self._asked: int | None = None  # a question behind noise, not answered yet
        self.rig.levels(self._drive, self._levels)

    def close(self) -> None:
        try:
            self.rig.levels(0, 0)
        finally:
            self.rig.close()
            self.client.close()

    # ---- a Board ----

    def slack(self, span: float = 0) -> float:
        """Each end of a time is seen by another clock than it was made by: up to a tick; and 0.05 ppm of it."""
        return 1.01 + 5e-8 * span

    def request(self, command: Command) -> Reply:
        answer = self.ask(command)
        if answer is None:
            raise AnnulusError(f"{self.device}: no answer to {type(command).__name__.lower()}, expected one")
        return answer

    def identify(self) -> IdentifyReply:
        """And hear which commands it has, as whoever opens a line does."""
        reply = self.request(identify())
        assert isinstance(reply, IdentifyReply)
        until = self.client.now_s() + REFUSABLE_S
        while not self.client.session.informed and self.client.now_s() < until:
            self._listen(READ_S)
        return reply

    def fresh(self) -> None:
        """Nothing armed, nothing latched, nothing moves, all duty paid, inputs at rest, wiring as after a reset."""
        self.rig.levels(self._drive, AT_REST)
        self._levels = AT_REST
        self.request(Arm(ArmFlag(0)))
        for width in (FRAME // 4, 0):  # triggers taken back end a hold-off, and forget one that waited for an edge
            self._request_known(
                configuration(period=FRAME), Polarity(1, PolarityFlag(0)), CameraTrigger(1, width, 0), Commit(1)
            )
        self.play(Scene(until=OWED_MS * MS, edges=camera([MS])))  # from that edge on this hold-off is in force
        self.identify()
        far = TURNTABLE_POSITION_MAX_STEPS
        self._request_known(Interlock(InterlockFlag(0)), Clear(), Turntable(-far, far, 0, 0, TurntableFlag(0)))

    def _request_known(self, *commands: Command) -> None:
        """Those that its firmware has."""
        for command in commands:
            if self.client.session.knows(type(command)):
                self.request(command)

    def ask(self, command: Command) -> Reply | None:
        """An older firmware breaks the promise that needs a command it does not know, and no other."""
        if not self.client.session.knows(type(command)):
            raise NotKeptError(too_old(type(command)))
        if isinstance(command, Reset):
            return self._restarted(command)
        answer: Answer | None = self.client.ask(command, REFUSABLE_S)
        return None if answer is None else answer.reply

    def _restarted(self, command: Reset) -> Reply | None:
        """A port over USB goes away with the board, its last answer perhaps as well, and comes again; a UART stays."""
        answer: Answer | None = None
        until = time.monotonic() + GOES_S
        with contextlib.suppress(AnnulusError):
            answer = self.client.ask(command, REFUSABLE_S)
            while time.monotonic() < until:
                self._listen(READ_S)
        self.client.close()
        until = time.monotonic() + RETURNS_S
        while True:
            try:
                self.client = FloodingClient(self.device)
                return None if answer is None else answer.reply
            except AnnulusError:
                if time.monotonic() > until:
                    raise
                time.sleep(READ_S)

    def play(self, scene: Scene) -> Played:
        wanted = [(round(tick * self.ratio), pin, level) for tick, pin, level in scene.edges]
        words, ticks = play_list(wanted, self._levels, PLAYED_AT if scene.cue is None else CUED_AT)
        if len(words) > LIST_WORDS:
            raise AnnulusError(
                f"a scene of {len(words)} words, expected {LIST_WORDS} at most: this is a fault of annulus"
            )
        tracks = self._tracks(scene)
        for at in range(0, len(words), WORDS_MAX):
            self.rig.load(words[at : at + WORDS_MAX], at)
            self.client.keep_alive()
            self._listen()
        self.rig.record(self._record(scene, tracks))
        self._listen()
        self._news.clear()
        self._asked = None
        self.rig.go(len(words))
        replies = self._attend(scene)
        state = self.rig.state()
        self.rig.stop()
        self._listen(0.01)
        for _, pin, level in wanted:
            self._levels = (self._levels & ~(1 << pin)) | (level << pin)
        if state.lost:
            raise AnnulusError(f"{self.rig.url}: the recording has a hole: more changes than the rig could keep")
        transitions = self._fetch(scene, tracks, state)
        cued = _first_rise(transitions, scene.cue)
        edges = [
            (cued + tick / self.ratio - TAKEN_AT, pin, level)
            for tick, (_, pin, level) in zip(ticks, sorted(wanted), strict=True)
        ]
        played = Played(edges, transitions, list(self._news), replies)
        played.origin = origin_of(played)
        return played

    # ---- clocks ----

    @property
    def ppm(self) -> float:
        """By which the rig's clock is faster."""
        return 1e6 * (self.ratio - 1)

    def compare_clocks(self) -> None:
        """From here on times are in the controller's ticks."""
        self.ratio = 1.0
        at = [MS, (1 + COMPARED_MS) * MS]
        edges = [item for tick in at for item in ((tick, PIN_SYNC, 0), (tick + 100 * 100, PIN_SYNC, 1))]
        played = self.play(Scene(until=at[-1] + 5 * MS, edges=edges))
        reported = [event.tick for event in played.heard(Edge)]
        if len(reported) != 2:
            raise AnnulusError(
                f"{self.device}: {len(reported)} of 2 edges of the sync input were reported, expected both."
                " Is the jumper of GP2 (pin 4) there, and is the port this board's?"
            )
        falls = played.falls_played(PIN_SYNC)
        self.ratio = (falls[1] - falls[0]) / ((reported[1] - reported[0]) % 2**32)
        if abs(self.ppm) > PPM_MAX:
            raise AnnulusError(
                f"the controller's time stamps and the rig's clock differ by {self.ppm:.0f} ppm, expected"
                f" {PPM_MAX:.0f} at most: two crystals never do, so the controller stamps wrong or not at 100 MHz"
            )

    # ---- one scene ----

    def _tracks(self, scene: Scene) -> list[tuple[int, int]]:
        """(machine, pin and phase) of each track: pairs first, then single ones."""
        free = [i for i in range(TRACKS) if scene.fine is None or i != SAMPLER_TRACK]
        tracks = []
        for number, pin in enumerate(scene.watch):
            phases = (0, TRACK_ODD) if number < 3 else (0,)
            tracks += [(free.pop(0), pin | phase) for phase in phases]
        return tracks

    def _record(self, scene: Scene, tracks: Sequence[tuple[int, int]]) -> Record:
        machines = [NONE] * TRACKS
        for machine, pin in tracks:
            machines[machine] = pin
        slow = sum(1 << pin for pin in self.slow_pins)
        cue = NONE if scene.cue is None else scene.cue
        if scene.fine is None:
            return Record(tuple(machines), cue=cue, slow=slow)
        return Record(
            tuple(machines), scene.fine.first, cue, slow, self._sample_delay(scene.fine), self._words(scene.fine)
        )

    def _sample_delay(self, fine: Fine) -> int:
        return round(fine.begin * self.ratio)

    def _words(self, fine: Fine) -> int:
        return min(AREA_WORDS, -(-round(fine.ticks * self.ratio) // 8))

    def _attend(self, scene: Scene) -> list[Reply | None]:
        """Until it is over: orders at their ticks, events, and a word now and then."""
        end = round(scene.until * self.ratio)
        orders = list(scene.orders)
        replies: list[Reply | None] = []
        deadline = self.client.now_s() + EARLY_S + 20 * scene.until / 1e8
        while True:
            state = self.rig.state()
            if orders and state.tick >= orders[0][0] * self.ratio:
                replies.append(self.ask(orders.pop(0)[1]))
                end = max(end, self.rig.state().tick + round(scene.after * self.ratio))
                continue
            if state.tick >= end and state.played and not orders:
                return replies
            if self.client.now_s() > deadline:
                raise AnnulusError(f"{self.rig.url}: the scene does not end, expected it to be over by now")
            if scene.flood:
                self._flood()
            elif not scene.silent:
                self.client.keep_alive()
            self._listen()

    def _flood(self) -> None:
        """Noise and a question, once the one before has been answered: what waits on the line stays bounded."""
        if self._asked is None:
            self.client.noise(self._rng)
            self._asked = self.client.session.send(Status())

    def _listen(self, seconds: float = 0.0) -> None:
        happened = self.client.poll(seconds)
        while happened:
            self._news += [news.event for news in happened if isinstance(news, EventReceived)]
            if any(isinstance(news, Answer | Unanswered) and news.ticket == self._asked for news in happened):
                self._asked = None
            happened = self.client.poll(0.0)

    def _fetch(self, scene: Scene, tracks: Sequence[tuple[int, int]], state: RigState) -> list[EdgeIn]:
        """Everything recorded, in the controller's ticks."""
        seen: dict[int, list[list[tuple[int, int]]]] = {}
        for machine, which in tracks:
            pin, odd = which & ~TRACK_ODD, bool(which & TRACK_ODD)
            count = state.tracked[machine]
            if count == state.room:
                raise AnnulusError(f"GP{pin} changed {count} times or more, which is all the rig can keep of a scene")
            words = self.rig.read(Area.RECORDED, machine * state.room, count)
            seen.setdefault(pin, []).append(track(words, odd))
        found: list[EdgeIn] = []
        for pin, each in seen.items():
            found += [(tick, pin, level) for tick, level in merged(*each, *([[]] * (2 - len(each))))]
        if scene.fine is not None:
            count = min(state.sampled, self._words(scene.fine))
            words = self.rig.read(Area.RECORDED, AREA_WORDS - self._words(scene.fine), count)
            found += samples(words, scene.fine.first, self._sample_delay(scene.fine))
        slow = self.rig.read(Area.SLOW, 0, 2 * state.slow)
        stamped = [(tick, what >> 1, what & 1) for tick, what in zip(slow[::2], slow[1::2], strict=True)]
        found += [change for change in stamped if change[1] not in seen]
        return sorted((tick / self.ratio + SEEN_AT, pin, level) for tick, pin, level in found)


def _first_rise(transitions: Sequence[EdgeIn], pin: int | None) -> float:
    """From which the list was played: the scene's begin, or the rise it waited for."""
    if pin is None:
        return 0.0
    rises = [tick for tick, p, level in transitions if p == pin and level]
    return rises[0] - SEEN_AT if rises else float("nan")


def origin_of(played: Played) -> float | None:
    """The controller's count at tick 0, by the stamps of its edges: those of one pairing that fits all."""
    reported = [event.tick for event in played.heard(Edge)]
    falls = played.falls_played(PIN_SYNC)
    if not reported:
        return None
    since = [(tick - reported[0] + 2**31) % 2**32 - 2**31 for tick in reported]
    for first in falls:
        off = [min((first + s - fall for fall in falls), key=abs) for s in since]
        if all(abs(o) <= STAMP_OFF for o in off):
            return reported[0] - first - statistics.median(off)
    return None
