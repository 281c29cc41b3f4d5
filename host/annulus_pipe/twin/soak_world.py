"""One world of a soak in virtual time: firmware, camera and driver on the one side, link, navigation and labelling as
the daemon has them on the other, and the truth beside them.
"""

from collections import Counter, deque
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np

from annulus_pipe.capture.camera import BAYER_RGGB8
from annulus_pipe.capture.proof import Witness
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.controller import TICK_S, TICKS_PER_US
from annulus_pipe.labelling.labelling import CameraMode, FrameSeen, Labelling
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.link.head import EdgeSeen, HeadControl, HeadEvent, LampsCut, PhaseChanged
from annulus_pipe.link.messages import BootCause, Stage
from annulus_pipe.link.phase import Phase
from annulus_pipe.link.pins import AS_WIRED, Pins
from annulus_pipe.link.preamble import preamble_of
from annulus_pipe.link.session import EventsLost, Rebooted
from annulus_pipe.link.stage import stage_from_us
from annulus_pipe.twin.driver import Delivered, Driver
from annulus_pipe.twin.emulated import VirtualBoard
from annulus_pipe.twin.faults import Faults, LossyLine
from annulus_pipe.twin.image_sensor import HostClock
from annulus_pipe.twin.pictures import WorldPictures
from annulus_pipe.twin.triggered import sensor_of
from annulus_pipe.twin.truth import PLACE_MM, LabelVerdict, Truth, relocks
from annulus_pipe.twin.worlds import World, clean_world
from annulus_pipe.vocabulary import Label

WIDTH = 104  # pixels: stripes stay apart, and a frame takes a fraction of a millisecond
HEAD_WIDTH = 320  # .. those of fringes, too
MS_TICKS = 1000 * TICKS_PER_US
STEP_TICKS = MS_TICKS // 2  # between two looks at the line while an answer is awaited
IDLE_TICKS = 20 * MS_TICKS
TURN_TICKS = 4 * MS_TICKS  # after an edge: its event is over the line, and its frame in the host's hands
WAITING_MAX = 28  # frames that wait while the offset is being found: the daemon's slots but its reserve
START_NS = 4_000_000_000_000  # the host has been up for a while
DRIFT_PPM = 35.0  # of the head's crystal against the host's
REACH_MM = 3000.0  # the winch goes no further
TRIGGERED = FrameTiming(25.0, 20_000.0, 14_300.0)  # exposure, and then the IMX296's readout
SPEED_MAX_MM_S = 12.0  # z is counted at the edge and judged at the flash, 7 ms later: 0.08 mm
PREAMBLE_FRAMES, PREAMBLE_S = 15, 20.0  # as head.toml has them
PULL_S = (5.0, 60.0)
REST = 0.3  # of its time the winch stands still
REOPEN_S = 0.2  # after the plug is back
ZERO_FRAMES = 250  # after a restart the operator says where the head is
QUIET_FRAMES = 250  # 10 s: frames unknown for longer ..
TOLD_BEFORE = 50  # .. and nobody told, then or shortly before
SHOWN_MAX = 20


WRONG = (LabelVerdict.WRONG_LAMP, LabelVerdict.WRONG_SLOT, LabelVerdict.WRONG_PLACE)


class Waiting(NamedTuple):
    seen: FrameSeen
    frame: Delivered


def soak_configuration(timing: FrameTiming, world: World, *, ratio: int = 4, tolerance_permille: int = 50) -> Stage:
    """Flashes of the lamps' nominal on-time, in the middle of the window."""
    flashes = []
    for lamp, width_us in (("projector", world.projector.nominal_us), ("led", world.led.nominal_us)):
        delay_us = (timing.opens_us + timing.closes_us - width_us) / 2
        timing.check_flash(delay_us, width_us, lamp)
        flashes.append((delay_us, width_us))
    return stage_from_us(
        ratio=ratio,
        period_us=timing.period_us,
        exposure_us=timing.exposure_us,
        readout_us=timing.readout_us,
        projector_us=flashes[0],
        led_us=flashes[1],
        tolerance_permille=tolerance_permille,
    )


class SoakWorld:
    """`frame` with each number in turn, `finish`, then `report`. The board is the caller's to close."""

    def __init__(
        self,
        frames: int,
        seed: int,
        faults: Faults,
        board: VirtualBoard,
        without: frozenset[Witness],
        ratio: int = 4,
        world: World | None = None,
        pins: Pins = AS_WIRED,
        trigger: str = "none",
        camera: int = 0,
    ) -> None:
        """`world`: a clean pipe in small pictures where none is given. `camera`: which of its. `pins`: the head's
        wiring. `trigger`: the camera's, of those in head.toml.
        """
        self.frames, self.seed, self.faults = frames, seed, faults
        self.timing = flashes_in = FrameTiming(25.0, 38_000.0, 28_000.0)
        tolerance = 50
        if trigger != "none":
            self.timing = TRIGGERED
            triggers = self.timing.triggered(trigger)
            flashes_in, tolerance = triggers.flashes_in, triggers.tolerance_permille
            pins = pins.triggering(trigger, triggers.width_us, triggers.delay_us)
        self.period = self.timing.period_us * TICKS_PER_US
        self.world = world or clean_world(seed=seed).scaled(WIDTH)
        pins = replace(pins, slides=self.world.turns)
        self.clock = HostClock(START_NS, drift_ppm=DRIFT_PPM)
        self.sensor = sensor_of(
            replace(self.world, travel_mm=REACH_MM),
            self.timing,
            faults,
            trigger=trigger,
            seed=seed,
            clock=self.clock,
            start_tick=MS_TICKS,
            pins=pins,
        )
        self.driver = Driver(faults, self.timing, seed, start_tick=MS_TICKS)
        self.pictures = WorldPictures(self.world, seed, camera)
        self.line = LossyLine(faults, seed)
        self.board = board
        self.boot = seed % 200  # a native board takes it, an emulated one has its own
        self.board.pull(*pins.pulled_up)
        self.board.power_on(self.boot)
        self.tick = board.tick  # of the world, now; an emulated one takes time to come up
        stage = soak_configuration(flashes_in, self.world, ratio=ratio, tolerance_permille=tolerance)
        self.head = HeadControl(stage, preamble=preamble_of(stage, PREAMBLE_FRAMES, PREAMBLE_S), pins=pins)
        self.navigation = Navigation(self.world.mm_per_count, SPEED_MAX_MM_S)
        seen = self.world.cameras[camera].camera
        period_ns = round(self.timing.period_us * 1000)
        mode = CameraMode(0, seen.width, seen.height, BAYER_RGGB8, period_ns, pins.slides, self.world.sees(camera))
        self.labelling = Labelling(mode, self.navigation, self._reported, False, without=without)
        place_mm = PLACE_MM + (SPEED_MAX_MM_S * self.timing.period_us * 1e-6 if trigger != "none" else 0.0)
        self.truth = Truth(self.period, self.world.mm_per_count, self.sensor.cable, place_mm, pins.slides)
        self.on_the_way: deque[Delivered] = deque()
        self.waiting: deque[Waiting] = deque()
        self.labels, self.reasons, self.verdicts = Counter[str](), Counter[str](), Counter[LabelVerdict]()
        self.right: list[int] = []
        self.dark: list[int] = []  # frames that no lamp lit
        self.shown: list[dict[str, Any]] = []  # the first wrong ones
        self.disturbed: list[tuple[str, int]] = []  # kind, first frame after its end
        self.events_lost_seen = self.bytes_flipped_seen = self.events_lost_for_good = 0
        self.unknown_since: int | None = None
        self.last_told = 0
        self.untold = self.unlit = 0
        self.number = 0
        self._begun = 0  # times that the camera began anew
        self._zero_at, self._zeroing = -1, False
        self._unplugged_until = -1  # world tick
        self._rng = np.random.default_rng([seed, 6])
        self._pull_at = 0
        period = self.period
        self._stalls = [
            (self.driver.stall_begins(stall), self.driver.stall_ends(stall)) for stall in sorted(faults.stalls)
        ]
        self._orders: deque[tuple[int, str, float]] = deque(
            sorted(
                [(at, "reset", 0.0) for at in faults.resets]
                + [(at, "power_loss", 0.0) for at in faults.power_losses]
                + [(at, "disconnect", ms) for at, ms in faults.disconnects]
            )
        )
        self._half = round(period / 2)

    # ---- one frame of virtual time ----

    def frame(self, number: int) -> None:
        self.number = number
        edge = self.sensor.edge(number)
        self._winch(number)
        while self._orders and self._orders[0][0] <= number:
            self._advance(edge - self._half)
            self._disturb(*self._orders.popleft())
        self._advance(edge + TURN_TICKS)
        for exposure in self.sensor.exposures(self.tick, self.board.pins()):
            delivered = self.driver.take(exposure)
            if delivered is not None:
                self.on_the_way.append(delivered)
        if self.driver.counts["unplug"] > self._begun:  # as the daemon does: what came before has its label
            self._begun = self.driver.counts["unplug"]
            while self.waiting:
                self._label(self.waiting.popleft())
            self.labelling.restarted()
        if self.line.events_lost > self.events_lost_seen:
            self.events_lost_seen = self.line.events_lost
            self.disturbed.append(("event_lost", number + 1))
        if self.line.bytes_flipped > self.bytes_flipped_seen:
            self.bytes_flipped_seen = self.line.bytes_flipped
            self.disturbed.append(("bytes_flipped", number + 1))
        if number == self._zero_at:
            self._zeroing = True
            self.navigation.odometer.zeroed_mm = None
            self.navigation.zero()
        if not self._stalled:
            self._host()

    def finish(self) -> None:
        """What still waits gets its label without the edges that never came."""
        self._deliver(self.tick + round(100 * self.period))
        while self.waiting:
            self._label(self.waiting.popleft())

    @property
    def _now(self) -> int:
        return self.clock.ns(self.tick)

    @property
    def _stalled(self) -> bool:
        """Whether the host does nothing at present."""
        if not self._stalls:
            return False
        now = self.tick
        while self._stalls and self._stalls[0][1] <= now:
            self._stalls.pop(0)
        return bool(self._stalls) and self._stalls[0][0] <= now

    def _advance(self, until: int) -> None:
        """Let the world go on, stopping wherever the host has something to say or to hear."""
        board, head = self.board, self.head
        while (now := self.tick) < until:
            awake, plugged = not self._stalled, now >= self._unplugged_until
            busy = False
            if awake and plugged:
                if self._unplugged_until >= 0:
                    self._unplugged_until = -1
                    head.reopened()
                to_send = head.pending(self._now)
                if to_send:
                    board.serial_write(to_send)
                busy = head.phase is not Phase.RUNNING or not head.session.idle
            stop = min(until, now + (STEP_TICKS if busy else IDLE_TICKS))
            for tick, pin, level in self.sensor.stimuli(stop):
                board.input(tick if tick > now else now, pin, level)
            board.run_until(stop)
            self.tick = stop
            self.truth.life(board.boot_tick, board.boot)
            if not plugged:
                board.serial_read()
            elif awake:
                for news in head.receive(self.line.carry(board.serial_read()), self._now):
                    self._heard(news)

    def _heard(self, news: HeadEvent) -> None:
        match news:
            case EdgeSeen():
                tick = self.truth.heard(news.flash, self.tick)
                self.navigation.heard(news)
                if self._zeroing and self.navigation.odometer.zeroed_mm is not None and tick is not None:
                    self._zeroing = False
                    self.truth.zeroed(tick)
                return
            case LampsCut() | PhaseChanged():
                self.last_told = self.number
            case Rebooted(_, previous):
                self.last_told = self.number
                self._zero_at = self.number + ZERO_FRAMES if previous is not None else -1
            case EventsLost():
                self.last_told = self.number
                self.events_lost_for_good += news.count
        self.navigation.heard(news)

    # ---- what happens to it ----

    def _winch(self, number: int) -> None:
        """It pulls, rests, and goes back."""
        if number < self._pull_at:
            return
        self._pull_at = number + round(float(self._rng.uniform(*PULL_S)) * self.timing.fps)
        speed = float(self._rng.uniform(-SPEED_MAX_MM_S, SPEED_MAX_MM_S)) if self._rng.random() >= REST else 0.0
        far = self.sensor.cable.z_mm(self.tick) + speed * (self._pull_at - number) / self.timing.fps
        self._pull(speed if 0.0 < far < REACH_MM else -speed)

    def _pull(self, speed_mm_s: float) -> None:
        self.sensor.pull(max(self.tick, MS_TICKS) + 1, speed_mm_s)

    def _disturb(self, number: int, kind: str, much: float) -> None:
        if self._rng.random() < 0.5:  # often because something else stopped too
            self._pull(0.0)
        if kind == "disconnect":
            self.line.unplug()
            self.board.serial_read()
            ticks = (much / 1000 + REOPEN_S) / TICK_S
            self._unplugged_until = self.tick + round(ticks)
            self.disturbed.append((kind, number + 1 + int(ticks / self.period)))
            self.last_told = number  # the daemon says that the line is broken
            return
        if kind == "reset":
            self.boot = (self.boot + 1) % 256
        self.board.power_on(self.boot, BootCause.POWER_ON if kind == "power_loss" else BootCause.WATCHDOG)
        self.tick = self.board.tick
        for pin, level in self.sensor.levels():
            self.board.input(self.tick, pin, level)
        self.truth.life(self.board.boot_tick, self.board.boot)
        self.disturbed.append((kind, number))

    # ---- the host's turn ----

    def _reported(self, kind: str, text: str) -> None:
        self.last_told = self.number

    def _host(self) -> None:
        self._deliver(self.tick)
        now = self._now
        self.labelling.look_for_offset(now / 1e9)
        if self.labelling.wants_preamble:
            self.head.order_preamble()
        while self.waiting and (self._crowded or self.labelling.settled(self.waiting[0].seen, now)):
            self._label(self.waiting.popleft())

    @property
    def _crowded(self) -> bool:
        return not self.labelling.offset_known and len(self.waiting) >= WAITING_MAX

    def _deliver(self, until: int) -> None:
        while self.on_the_way and self.on_the_way[0].due_tick <= until:
            frame = self.on_the_way.popleft()
            picture = self.pictures.measured(frame.parts)
            arrived_ns = self.clock.ns(frame.due_tick)
            seen = FrameSeen(frame.sequence, frame.timestamp_ns, arrived_ns, picture, {})
            self.labelling.saw(seen)
            self.waiting.append(Waiting(seen, frame))

    def _label(self, one: Waiting) -> None:
        header = self.labelling.header(one.seen)
        verdict = self.truth.verdict(header, one.frame)
        number = one.frame.number
        self.labels[header.label] += 1
        self.verdicts[verdict] += 1
        if header.reason:
            self.reasons[header.reason] += 1
        if verdict is LabelVerdict.UNKNOWN:
            self.unknown_since = number if self.unknown_since is None else self.unknown_since
            if not any(part.exposure.lamps for part in one.frame.parts):
                self.unlit += 1
                self.dark.append(number)
            reported = self.last_told >= self.unknown_since - TOLD_BEFORE
            self.untold += not reported and number - self.unknown_since > QUIET_FRAMES
            return
        self.unknown_since = None
        if verdict is LabelVerdict.RIGHT:
            self.right.append(number)
        elif len(self.shown) < SHOWN_MAX:
            lit = ["+".join(sorted(lamp.name.lower() for lamp in p.exposure.lamps)) for p in one.frame.parts]
            self.shown.append(
                {
                    "world": self.seed,
                    "frame": number,
                    "verdict": str(verdict),
                    "label": str(header.label),
                    "lit": lit,
                    "of": [int(p.exposure.sequence) for p in one.frame.parts],
                    "z_mm": header.z_mm,
                    "true_z_mm": round(self.truth.z_mm(one.frame.parts[0]), 3),
                    "after": self._before(number),
                }
            )

    def _before(self, number: int) -> str:
        """The last disturbance before a frame."""
        known = [d for d in (*self.disturbed, *self.driver.disturbed) if d[1] <= number + 1]
        return "{} {}".format(*max(known, key=lambda d: d[1])) if known else ""

    # ---- the account ----

    def _spans(self) -> list[tuple[int, int]]:
        """Frames, first and one past the last, in which no label can be had: what happens in them ends with them."""
        faults, fps = self.faults, self.timing.fps
        spans = [(at, at + 1 + int((ms / 1000 + REOPEN_S) * fps)) for at, ms in faults.disconnects]
        spans += [(at, at + 1 + int(seconds * fps)) for at, seconds in faults.stalls]
        return spans + [(at, at + int(much)) for at, much in (*faults.frozen, *faults.unplugged)]

    def report(self) -> dict[str, Any]:
        spans = self._spans()
        disturbed = [d for d in (*self.disturbed, *self.driver.disturbed) if not any(a <= d[1] < b for a, b in spans)]
        wrong = Counter({kind: self.verdicts[kind] for kind in WRONG})
        return {
            "frames": self.frames,
            "seed": self.seed,
            "wrong": wrong.total(),
            "wrong_lamps": wrong[LabelVerdict.WRONG_LAMP],
            "wrong_slots": wrong[LabelVerdict.WRONG_SLOT],
            "wrong_places": wrong[LabelVerdict.WRONG_PLACE],
            "unknown": self.labels[Label.UNKNOWN],
            "unlit": self.unlit,
            "projector": self.labels[Label.PROJECTOR],
            "led": self.labels[Label.LED],
            "dropped": self.driver.counts["dropped"] + self.driver.counts["dropped_in_stall"],
            "unplugged": self.driver.counts["unplugged"],
            "untold": self.untold,
            "z_assumed": self.truth.assumed,
            "z_beyond_bound": self.truth.beyond_bound,
            "z_error_max_mm": round(self.truth.error_mm, 3),
            "z_assumed_error_max_mm": round(self.truth.assumed_error_mm, 1),
            "reasons": dict(sorted(self.reasons.items())),
            "relocks": [
                {"world": self.seed, **asdict(relock)}
                for relock in relocks(sorted(disturbed, key=lambda d: d[1]), self.right, self.frames, self.dark)
            ],
            "disturbances": {
                **self.driver.counts,
                "events_lost": self.line.events_lost,
                "bytes_flipped": self.line.bytes_flipped,
                **Counter(kind for kind, _ in self.disturbed if kind not in ("event_lost", "bytes_flipped")),
            },
            "link": self.head.session.counters.as_dict(),
            "events_lost_for_good": self.events_lost_for_good,
            "clock": {"drift_ppm": round(self.head.clock.drift * 1e6, 2), "rejected": self.head.clock.rejected},
            "rearms": self.head.rearms,
            "board_lost": self.board.lost(),
            "shown": self.shown,
        }
