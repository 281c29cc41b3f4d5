"""Says which flash lit a frame, or that nobody knows. A wrong answer is the one sin; unknown is legal and counted.

Frame n is the frame whose readout ends at edge n, and it was lit by the flash fired after edge n-1. So: take the
frame's timestamp, subtract the camera's offset, find the one edge near that moment (the closing edge), take the edge
before it in the same controller life (the opening edge), and believe the flash it announced only if everything agrees:
both edges regular, armed, one period apart, no reset, fault or arming in between, the driver's own count, and the
picture. Nothing is counted by arrival, so one disturbed frame cannot shift the next: there is nothing to lock again.

    pairing = Pairing(period_ns, calibrate_offset(frames, edges, period_ns).offset_ns)
    pairing.edge(flash, host_ns, boot_epoch)                  # as they come, in any order
    if pairing.settled(frame.timestamp_ns, now):        # the edges it needs are here, or will not come any more
        labelled = pairing.label(frame.timestamp_ns, frame.sequence, measure(frame.image).light)
"""

import math
from bisect import bisect_left, insort
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from statistics import median

from annulus.capture.photometry import Light
from annulus.vocabulary import AnnulusError, CameraSequence, EdgeFlag, Flash, Label, Lamp

EDGES_KEPT = 256  # ten seconds at 25 fps: more than a frame ever waits
SPANS_KEPT = 64
WINDOW = 0.25  # of a period: how far a frame may be from its edge
INTERVAL_TOLERANCE = 0.1  # of a period: between opening and closing edge
SETTLE_PERIODS = 3.0  # how long a frame waits for an edge that has to be read again
OFFSET_FRAMES = 63
OFFSETS_TRIED = (-2, -1, 0, 1)  # whole periods, from before the exposure to a late soft stamp; fewer than a 4:1 cycle
CALIBRATION_FRAMES_MIN = 12
CALIBRATION_MISMATCH_MAX = 0.05

_LIGHTS = {Lamp.PROJECTOR: Light.PROJECTOR, Lamp.LED: Light.LED, Lamp.DARK: Light.DARK}
_LABELS = {Lamp.PROJECTOR: Label.PROJECTOR, Lamp.LED: Label.LED}


class Reason(StrEnum):
    """Why a frame got its label. Everything but AGREED means unknown."""

    AGREED = "agreed"
    NO_EDGE = "no edge near"
    TWO_EDGES = "two edges near"
    OPENING_LOST = "opening edge lost"
    IRREGULAR = "irregular edge"
    LATE = "flash loaded late"
    DISARMED = "disarmed"
    DARK = "no flash"
    CUT = "fault or arming during the frame"
    SEQUENCE = "driver count disagrees"
    PICTURE = "picture disagrees"
    UNCLEAR = "picture unclear"
    OFFSET = "timestamp offset doubtful"


@dataclass(frozen=True, slots=True)
class Labelled:
    """The verdict on one frame. `flash` is given whenever one was found, also where the label stays unknown."""

    label: Label
    flash: Flash | None  # fired after the opening edge
    reason: Reason
    residual_ns: int | None  # frame's moment minus its closing edge


@dataclass(frozen=True, slots=True, order=True)
class PlacedEdge:
    """An edge in host time, by which it sorts."""

    host_ns: int
    boot_epoch: int
    index: int
    flash: Flash = field(compare=False)


@dataclass(frozen=True, slots=True)
class Offset:
    """Result of `calibrate_offset`."""

    offset_ns: int  # frame timestamp minus the end of its readout
    jitter_ns: int  # one sigma
    frames: int  # whose picture was compared
    mismatches: int


class EdgeHistory:
    """The controller's edges of the last seconds, and the spans in which no flash is to be trusted. Cameras on one
    sync line share one.
    """

    def __init__(self) -> None:
        self.edges: list[PlacedEdge] = []  # by host time
        self.invalid: deque[tuple[int, int]] = deque(maxlen=SPANS_KEPT)

    def edge(self, flash: Flash, host_ns: int, boot_epoch: int) -> None:
        """An edge was heard. Order does not matter: edges that had to be read again come late."""
        insort(self.edges, PlacedEdge(host_ns, boot_epoch, flash.edge, flash))
        if len(self.edges) > EDGES_KEPT:
            del self.edges[0]

    def invalidate(self, from_ns: int, to_ns: int) -> None:
        """A lamp may have been cut, or switched, in this span: no frame that was open in it gets a label."""
        self.invalid.append((from_ns, to_ns))


class Pairing:
    """Labels one camera's frames from timestamps, edges and pictures. Holds bounded history, no thread, no clock."""

    def __init__(
        self, period_ns: int, offset_ns: int = 0, *, photometry: bool = True, history: EdgeHistory | None = None
    ) -> None:
        """`history` is fed by whoever made it; without one, feed `edge` and `invalidate` here."""
        self.counters: Counter[str] = Counter()  # frames by reason
        self._history = history or EdgeHistory()
        self.edge, self.invalidate = self._history.edge, self._history.invalidate
        self._period_ns = period_ns
        self._offset_ns = offset_ns
        self._photometry = photometry
        self._last: tuple[CameraSequence, int, int] | None = None  # driver sequence, life, closing edge's index
        self._proved = False
        self._wandered = False
        self._residuals: deque[int] = deque(maxlen=OFFSET_FRAMES)

    @property
    def offset_ns(self) -> int:
        return self._offset_ns

    @property
    def offset_error_ns(self) -> int:
        """How far the frames have lately been from where the offset puts them; near 0 when all is well."""
        return round(median(self._residuals)) if len(self._residuals) >= 16 else 0

    @property
    def doubtful(self) -> bool:
        """The offset is not to be believed (yet, or any more): every label is unknown meanwhile.

        A picture of the other lamp puts the offset in doubt; a picture of the LED (or of the dark) where timing says
        so proves it again, since under an offset wrong by a frame those never fall together. Frames that wander away
        from their edges do so for good: they would come to the next edge in the end. Then, `recalibrate`.
        """
        return self._wandered or (self._photometry and not self._proved)

    @property
    def edges(self) -> Sequence[PlacedEdge]:
        """The edges now held, by time."""
        return self._history.edges

    @property
    def _window_ns(self) -> int:
        return round(WINDOW * self._period_ns)

    def recalibrate(self, period_ns: int, offset_ns: int, *, proved: bool = True) -> None:
        """Another frame rate or offset. `proved`: `calibrate_offset` just found it; False: it is from another day."""
        self._period_ns, self._offset_ns = period_ns, offset_ns
        self._proved, self._wandered = proved, False
        self._last = None
        self._residuals.clear()

    def settled(self, timestamp_ns: int, now_ns: int) -> bool:
        """Whether waiting longer can still help. True once both edges are held, or after SETTLE_PERIODS."""
        moment = timestamp_ns - self._offset_ns
        if now_ns - moment > SETTLE_PERIODS * self._period_ns:
            return True
        near = self._near(moment)
        return len(near) == 1 and self._opening(near[0]) is not None

    def label(self, timestamp_ns: int, sequence: CameraSequence | None, light: Light | None) -> Labelled:
        """The verdict on a frame. `light` None (or photometry off): timing alone. Frames in the order of capture."""
        moment = timestamp_ns - self._offset_ns
        closing, flash, reason = self._judge(moment, sequence)
        residual = moment - closing.host_ns if closing is not None else None
        if residual is not None:
            self._residuals.append(residual)
            self._wandered |= abs(self.offset_error_ns) > self._window_ns // 2
        if self._photometry and light is not None and flash is not None and reason in (Reason.AGREED, Reason.DARK):
            reason = self._compare(flash.lamp, light, reason)
        if reason is Reason.AGREED and self.doubtful:
            reason = Reason.OFFSET
        self.counters[reason] += 1
        label = _LABELS[flash.lamp] if reason is Reason.AGREED and flash is not None else Label.UNKNOWN
        return Labelled(label, flash, reason, residual)

    def _judge(self, moment: int, sequence: CameraSequence | None) -> tuple[PlacedEdge | None, Flash | None, Reason]:
        """What timing says."""
        near = self._near(moment)
        if len(near) != 1:
            self._last = None
            return None, None, Reason.TWO_EDGES if near else Reason.NO_EDGE
        closing = near[0]
        counted = self._count_agrees(sequence, closing)
        opening = self._opening(closing)
        if opening is None:
            return closing, None, Reason.OPENING_LOST
        flash = opening.flash
        interval = closing.host_ns - opening.host_ns
        tolerance = INTERVAL_TOLERANCE * self._period_ns
        irregular = EdgeFlag.IRREGULAR in flash.flags | closing.flash.flags
        if irregular or abs(interval - self._period_ns) > tolerance:
            return closing, flash, Reason.IRREGULAR
        if EdgeFlag.LATE_LOAD in flash.flags:
            return closing, flash, Reason.LATE
        if EdgeFlag.DISARMED in flash.flags | closing.flash.flags:
            return closing, flash, Reason.DISARMED
        if flash.lamp not in _LABELS or flash.width_ticks == 0:
            return closing, flash, Reason.DARK
        if any(start <= closing.host_ns and end >= opening.host_ns for start, end in self._history.invalid):
            return closing, flash, Reason.CUT
        return closing, flash, Reason.AGREED if counted else Reason.SEQUENCE

    def _near(self, moment: int) -> list[PlacedEdge]:
        """Edges inside the window around a moment. Neighbours a half period off are outside, so one is the rule."""
        window = self._window_ns
        first = bisect_left(self.edges, moment - window, key=lambda edge: edge.host_ns)
        last = bisect_left(self.edges, moment + window + 1, key=lambda edge: edge.host_ns)
        return list(self.edges[first:last])

    def _opening(self, closing: PlacedEdge) -> PlacedEdge | None:
        """The edge before, by the controller's own count and in the same life."""
        wanted = (closing.boot_epoch, closing.index - 1)
        before = bisect_left(self.edges, closing.host_ns, key=lambda edge: edge.host_ns)
        for edge in reversed(self.edges[max(0, before - 4) : before]):
            if (edge.boot_epoch, edge.index) == wanted:
                return edge
        return None

    def _count_agrees(self, sequence: CameraSequence | None, closing: PlacedEdge) -> bool:
        """Since the last frame, driver and controller must have counted the same number of frames."""
        last, self._last = self._last, None
        if sequence is None:
            return True
        self._last = (sequence, closing.boot_epoch, closing.index)
        if last is None or last[1] != closing.boot_epoch:
            return True
        return sequence - last[0] == closing.index - last[2]

    def _compare(self, lamp: Lamp, light: Light, reason: Reason) -> Reason:
        """Timing is sure of `lamp`. What does the picture say?"""
        if light is _LIGHTS[lamp]:
            self._proved |= lamp is not Lamp.PROJECTOR
            return reason
        if light is Light.UNCLEAR:
            return Reason.UNCLEAR
        if light in (Light.PROJECTOR, Light.LED):  # darkness would speak of a dead lamp, not of a wrong offset
            self._proved = False
        return Reason.PICTURE


def calibrate_offset(frames: Iterable[tuple[int, Light]], edges: Sequence[PlacedEdge], period_ns: int) -> Offset:
    """The camera's offset from frames whose pictures show what lit them, and the edges of the same seconds.

    The fraction of a period is the circular mean of the frames' phases; the whole periods are the only ones under
    which pictures and flashes agree. AnnulusError when too little was seen, or when nothing or more than one agrees.
    """
    seen = [(stamp, light) for stamp, light in frames if light in (Light.DARK, Light.PROJECTOR, Light.LED)]
    if len(seen) < CALIBRATION_FRAMES_MIN or len(edges) < 2:
        raise AnnulusError(
            f"camera offset: {len(seen)} frames with a clear picture and {len(edges)} edges, expected"
            f" {CALIBRATION_FRAMES_MIN} frames or more. Do the lamps fire, and is the sync line connected?"
        )
    phase, jitter = _phase([stamp for stamp, _ in seen], edges, period_ns)
    by_index = {(edge.boot_epoch, edge.index): edge for edge in edges}
    verdicts = []
    for periods in OFFSETS_TRIED:
        offset = phase + periods * period_ns
        compared = mismatches = 0
        for stamp, light in seen:
            closing = _nearest(edges, stamp - offset)
            opening = by_index.get((closing.boot_epoch, closing.index - 1))
            if abs(stamp - offset - closing.host_ns) > WINDOW * period_ns or opening is None:
                continue
            compared += 1
            mismatches += _LIGHTS[opening.flash.lamp] is not light
        if compared >= CALIBRATION_FRAMES_MIN // 2:
            verdicts.append((mismatches / compared, mismatches, compared, offset))
    fitting = [verdict for verdict in verdicts if verdict[0] <= CALIBRATION_MISMATCH_MAX]
    if not fitting:
        best = min(verdicts, default=(1.0, 0, 0, 0))
        raise AnnulusError(
            f"camera offset: pictures and flashes agree under no offset (best: {best[1]} of {best[2]} disagree),"
            " expected projector and LED frames in the cycle that was configured"
        )
    if len(fitting) > 1:
        found = ", ".join(f"{verdict[3] / 1e6:.1f}" for verdict in fitting)
        raise AnnulusError(
            f"camera offset: {found} ms fit equally well, expected one. Calibrate with a ratio of 4 or more"
            " and LED frames in view"
        )
    _, mismatches, compared, offset = fitting[0]
    return Offset(offset, jitter, compared, mismatches)


def _phase(stamps: Sequence[int], edges: Sequence[PlacedEdge], period_ns: int) -> tuple[int, int]:
    """Circular mean, and spread, of timestamp minus nearest edge, ns in (-period/2, period/2]."""
    angles = [2 * math.pi * (stamp - _nearest(edges, stamp).host_ns) / period_ns for stamp in stamps]
    x = sum(map(math.cos, angles)) / len(angles)
    y = sum(map(math.sin, angles)) / len(angles)
    length = min(1.0, math.hypot(x, y))
    if length < 0.5:
        raise AnnulusError(
            "camera offset: frames and edges do not run at the same rate. Is the sync line this camera's, and is the"
            " frame rate the configured one?"
        )
    scale = period_ns / (2 * math.pi)
    return round(math.atan2(y, x) * scale), round(math.sqrt(-2 * math.log(length)) * scale)


def _nearest(edges: Sequence[PlacedEdge], moment: int) -> PlacedEdge:
    at = bisect_left(edges, moment, key=lambda edge: edge.host_ns)
    around = edges[max(0, at - 1) : at + 1]
    return min(around, key=lambda edge: abs(edge.host_ns - moment))
