"""The twin through the real pairing, link and firmware code in virtual time, labels scored against what really lit each
frame. `annulus twin soak` prints what `soak` returns.

A label is wrong when the frame shows anything but that lamp over all its rows, or when the flash it was given is not
the one that lit it (which would put the frame at another place along the pipe).
"""

import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from annulus.capture.pairing import Labelled, Pairing, PlacedEdge, calibrate_offset
from annulus.capture.photometry import Light, measure
from annulus.capture.timing import FrameTiming
from annulus.controller import TICKS_PER_US
from annulus.link.head import EdgeSeen, HeadControl, LampsCut, Phase, stage_from_us
from annulus.link.messages import BootCause, Stage
from annulus.link.session import EventsLost
from annulus.twin.emulated import Board, open_board
from annulus.twin.faults import Faults, LossyLine, load_faults
from annulus.twin.image_sensor import Exposure, HostClock, ImageSensor
from annulus.twin.render import Renderer
from annulus.twin.worlds import World, clean_world
from annulus.vocabulary import AnnulusError, Label, Lamp

WIDTH = 104  # pixels: stripes stay apart, and a frame takes a fraction of a millisecond
MS_TICKS = 1000 * TICKS_PER_US
STEP_TICKS = MS_TICKS // 2  # between two looks at the line while an answer is awaited
IDLE_TICKS = 10 * MS_TICKS
EVENT_TICKS = MS_TICKS  # after an edge, by then its event is over the line
CALIBRATION_FRAMES = 50
FRAMES_WAITING_MAX = 128  # while the offset is being found they all wait
EVEN = 0.97  # a row with less light than this share of the brightest: the flash was not all rows'
START_NS = 4_000_000_000_000  # the host has been up for a while
SPEED_MM_S = 2.0

_LABELS = {frozenset({Lamp.PROJECTOR}): Label.PROJECTOR, frozenset({Lamp.LED}): Label.LED}
_LIT = {Label.PROJECTOR: Lamp.PROJECTOR, Label.LED: Lamp.LED}


@dataclass(frozen=True, slots=True)
class _Frame:
    exposure: Exposure
    light: Light | None


class _Score:
    """Labels of one Pairing against the truth."""

    def __init__(self) -> None:
        self.labels = dict.fromkeys(Label, 0)
        self.wrong = 0
        self.right: list[int] = []  # frame numbers, rising

    def add(self, exposure: Exposure, labelled: Labelled, period: float, boot_ticks: dict[int, int]) -> None:
        self.labels[labelled.label] += 1
        if labelled.label is Label.UNKNOWN:
            return
        if is_right(exposure, labelled, period, boot_ticks):
            self.right.append(exposure.sequence)
        else:
            self.wrong += 1


def is_right(exposure: Exposure, labelled: Labelled, period: float, boot_ticks: dict[int, int]) -> bool:
    """Whether the lamp is the one that lit the frame, all of it, and the flash the one before its closing edge.

    boot_ticks : world tick at which the life with that boot byte began.
    """
    if exposure.lamps != {_LIT[labelled.label]} or labelled.flash is None:
        return False
    rows = exposure.projector if labelled.label is Label.PROJECTOR else exposure.led
    if float(rows.min()) < EVEN * float(rows.max()):
        return False
    fired = boot_ticks.get(labelled.flash.boot, -1) + labelled.flash.tick
    return abs(fired - (exposure.edge_tick - period)) < 0.25 * period


def soak_configuration(timing: FrameTiming, world: World, *, ratio: int = 4) -> Stage:
    """Flashes of the lamps' nominal on-time, in the middle of the window."""

    flashes = []
    for lamp, width_us in (("projector", world.projector.nominal_us), ("led", world.led.nominal_us)):
        delay_us = (timing.opens_us + timing.closes_us - width_us) / 2
        timing.check_flash(delay_us, width_us, lamp)
        flashes.append((delay_us, width_us))
    return stage_from_us(
        ratio=ratio, period_us=timing.period_us, exposure_us=timing.exposure_us, readout_us=timing.readout_us,
        projector_us=flashes[0], led_us=flashes[1],
    )  # fmt: skip


def soak(
    frames: int,
    seed: int = 0,
    *,
    faults: Faults | str | None = "standard",
    photometry: bool = True,
    offset_error_ns: int = 0,
    board: str = "native",
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, Any]:
    """Run `frames` camera frames of virtual time and score every label.

    Two controller resets, a third and two thirds of the way, unless `faults` places its own. `photometry` False leaves
    the picture out of the labels. `offset_error_ns` is added to the calibrated offset: sabotage, for showing that a
    wrong pairing is found out. The same frames are labelled a second time from timing alone ("timing_only"). `board` is
    native or emulated: the same core on a simulated board, or the very image a user flashes.

    Raises AnnulusError when `frames` is too few to calibrate the camera's offset, or that calibration fails; with the
    emulated board also where silicon would have hung.
    """
    if frames < 2 * CALIBRATION_FRAMES:
        raise AnnulusError(f"soak: {frames} frames, expected {2 * CALIBRATION_FRAMES} or more")
    chosen = faults if isinstance(faults, Faults) else load_faults(faults)
    run = _Run(frames, seed, chosen, photometry, offset_error_ns, open_board(board))
    began = time.perf_counter()
    try:
        for frame in range(frames):
            run.frame(frame)
            if progress is not None and frame % 50 == 0:
                progress("frames", frame, frames)
        run.finish()
    finally:
        run.board.close()
    if progress is not None:
        progress("frames", frames, frames)
    return run.report(time.perf_counter() - began)


class _Run:
    def __init__(
        self, frames: int, seed: int, faults: Faults, photometry: bool, offset_error_ns: int, board: Board
    ) -> None:
        if faults.resets == () and faults != load_faults("none"):
            faults = replace(faults, resets=(frames // 3, 2 * frames // 3))
        self.frames, self.seed, self.faults = frames, seed, faults
        self.photometry, self.offset_error_ns = photometry, offset_error_ns
        self.timing = FrameTiming(25.0, 38_000.0, 28_000.0)
        self.period = self.timing.period_us * TICKS_PER_US
        self.world = clean_world(seed=seed).scaled(WIDTH)
        self.renderer = Renderer(self.world)
        self.clock = HostClock(START_NS, drift_ppm=35.0)
        self.sensor = ImageSensor(
            self.world, self.timing, faults, seed=seed, clock=self.clock, start_tick=MS_TICKS, speed_mm_s=SPEED_MM_S
        )
        self.line = LossyLine(faults, seed)
        self.board = board
        self.boot = seed % 200  # a native board takes it, an emulated one has its own
        self.board.power_on(self.boot)
        self.boot_ticks: dict[int, int] = {}
        self.head = HeadControl(soak_configuration(self.timing, self.world))
        self.pairing = Pairing(round(self.timing.period_us * 1000), photometry=photometry)
        self.blind = Pairing(round(self.timing.period_us * 1000), photometry=False)
        self.calibrated = False
        self.calibration: list[tuple[int, Light]] = []
        self.jitter_ns = 0
        self.score, self.blind_score = _Score(), _Score()
        self.waiting: deque[_Frame] = deque()
        self.disturbed: list[int] = []  # first frame after each disturbance's end
        self.lost_seen = 0
        self.overflow = self.dropped = self.dark = 0
        self.events_lost_for_good = 0

    # ---- one frame of virtual time ----

    def frame(self, number: int) -> None:
        edge = self.sensor.edge(number)
        if number in self.faults.resets:
            self._advance(round(edge - self.period / 2))
            self._reset()
            self.disturbed.append(number)
        self._advance(edge)
        for exposure in self.sensor.exposures(self.board.tick, self.board.pins()):
            self._captured(exposure)
        self._advance(edge + EVENT_TICKS)
        if self.line.events_lost > self.lost_seen:
            self.lost_seen = self.line.events_lost
            self.disturbed.append(number + 1)
        self._label(self._now)

    def finish(self) -> None:
        """What still waits gets its label without the edges that never came."""
        if not self.calibrated:
            raise AnnulusError(
                f"soak: the camera's offset was not found in {self.frames} frames, head {self.head.phase.value},"
                " expected fewer faults or more frames"
            )
        self._label(self._now + round(100 * self.timing.period_us * 1000))

    @property
    def _now(self) -> int:
        return self.clock.ns(self.board.tick)

    def _advance(self, until: int) -> None:
        """Let the world go on, stopping wherever the host has something to say or to hear."""
        while self.board.tick < until:
            self.board.serial_write(self.head.pending(self._now))
            busy = self.head.phase is not Phase.RUNNING or not self.head.session.idle
            stop = min(until, self.board.tick + (STEP_TICKS if busy else IDLE_TICKS))
            for tick, pin, level in self.sensor.stimuli(stop):
                self.board.input(max(tick, self.board.tick), pin, level)
            self.board.run_until(stop)
            self.boot_ticks[self.board.boot] = self.board.boot_tick
            for news in self.head.receive(self.line.carry(self.board.serial_read()), self._now):
                match news:
                    case EdgeSeen():
                        for pairing in (self.pairing, self.blind):
                            pairing.edge(news.flash, news.host_ns, news.boot_epoch)
                    case LampsCut():
                        for pairing in (self.pairing, self.blind):
                            pairing.invalidate(news.from_ns, news.to_ns)
                    case EventsLost():
                        self.events_lost_for_good += news.count

    def _reset(self) -> None:
        self.boot = (self.boot + 1) % 256
        self.board.power_on(self.boot, BootCause.WATCHDOG)
        for pin, level in self.sensor.levels():
            self.board.input(self.board.tick, pin, level)

    # ---- frames ----

    def _captured(self, exposure: Exposure) -> None:
        if exposure.dropped:
            self.dropped += 1
            self.disturbed.append(exposure.sequence + 1)
            return
        self.dark += not exposure.lamps
        light = self._light(exposure) if self.photometry or not self.calibrated else None
        if light is not None and not self.calibrated:
            self._calibrate(exposure, light)
        self.waiting.append(_Frame(exposure, light))
        if len(self.waiting) > FRAMES_WAITING_MAX:
            self.waiting.popleft()
            self.overflow += 1

    def _light(self, exposure: Exposure) -> Light:
        """What the picture shows that this exposure makes."""
        where = (exposure.pose, exposure.z_mm)
        return measure(self.renderer.render(*where, exposure.projector, exposure.led, seed=exposure.sequence)).light

    def _calibrate(self, exposure: Exposure, light: Light) -> None:
        if self.head.phase is Phase.RUNNING and light is not Light.DARK:
            self.calibration.append((exposure.timestamp_ns, light))
        if len(self.calibration) < CALIBRATION_FRAMES:
            return
        offset = calibrate_offset(self.calibration, list[PlacedEdge](self.pairing.edges), self._period_ns)
        self.jitter_ns = offset.jitter_ns
        for pairing in (self.pairing, self.blind):
            sabotaged = self.offset_error_ns != 0
            pairing.recalibrate(self._period_ns, offset.offset_ns + self.offset_error_ns, proved=not sabotaged)
        self.calibrated = True

    @property
    def _period_ns(self) -> int:
        return round(self.timing.period_us * 1000)

    def _label(self, now: int) -> None:
        while self.calibrated and self.waiting and self.pairing.settled(self.waiting[0].exposure.timestamp_ns, now):
            frame = self.waiting.popleft()
            exposure = frame.exposure
            for pairing, score in ((self.pairing, self.score), (self.blind, self.blind_score)):
                labelled = pairing.label(exposure.timestamp_ns, exposure.sequence, frame.light)
                score.add(exposure, labelled, self.period, self.boot_ticks)

    # ---- the account ----

    def report(self, seconds: float) -> dict[str, Any]:
        counters = self.head.session.counters
        relocks = _relocks(self.disturbed, self.score.right, self.frames)
        return {
            "frames": self.frames,
            "seed": self.seed,
            "wrong": self.score.wrong,
            "unknown": self.score.labels[Label.UNKNOWN],
            "projector": self.score.labels[Label.PROJECTOR],
            "led": self.score.labels[Label.LED],
            "dropped": self.dropped,
            "overflow": self.overflow,
            "dark": self.dark,
            "reasons": {str(reason): count for reason, count in sorted(self.pairing.counters.items())},
            "relock_frames_max": max(relocks, default=0),
            "disturbances": {
                "frames_dropped": self.dropped,
                "events_lost": self.line.events_lost,
                "bytes_flipped": self.line.bytes_flipped,
                "resets": len(self.faults.resets),
            },
            "timing_only": {
                "wrong": self.blind_score.wrong,
                "unknown": self.blind_score.labels[Label.UNKNOWN],
                "reasons": {str(reason): count for reason, count in sorted(self.blind.counters.items())},
            },
            "link": counters.as_dict(),
            "events_lost_for_good": self.events_lost_for_good,
            "clock": {"drift_ppm": round(self.head.clock.drift * 1e6, 2), "rejected": self.head.clock.rejected},
            "rearms": self.head.rearms,
            "offset_us": round(self.pairing.offset_ns / 1000, 1),
            "jitter_us": round(self.jitter_ns / 1000, 1),
            "board_lost": self.board.lost(),
            "virtual_s": round(self.frames / self.timing.fps, 1),
            "seconds": round(seconds, 2),
        }


def _relocks(disturbed: list[int], right: list[int], frames: int) -> list[int]:
    """For each disturbance: frames from its end to the next right label, that frame included.

    A disturbance with no right label after it counts as all the frames that were left, unless fewer were left than a
    relock is allowed to take.
    """
    relocks = []
    for first in disturbed:
        at = bisect_right(right, first - 1)
        if at < len(right):
            relocks.append(right[at] - first + 1)
        elif frames - first > 8:
            relocks.append(frames - first)
    return relocks
