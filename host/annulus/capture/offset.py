"""A camera's timestamp offset: found from pictures, then followed, with its rate.

`calibrate_offset` finds it. The fraction of a period is the circular mean of the frames' phases. Which whole periods,
pictures say: under all but one, they and the flashes disagree. A lamp cycle looks like itself a cycle on, so what
fits must also be possible: no frame is in hand before its edge, and no driver keeps one for LAG_PERIODS_MAX unless a
preamble proves that this one does.

`OffsetTrack` follows it: a line fitted to what the frames were off, which forgets after TRACKED frames.
"""

import math
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from annulus.capture.history import EdgeHistory
from annulus.capture.photometry import Light
from annulus.capture.seen import FrameSeen
from annulus.vocabulary import AnnulusError, EdgeFlag, Lamp

WINDOW = 0.25  # of a period: how far a frame may be from its edge
LAG_PERIODS_MIN = -0.1  # of a period: how early a frame may seem, for an edge is placed only so well
LAG_PERIODS_MAX = 4.9  # a driver that keeps a frame longer must be proved to
LAG_PERIODS_PROVED_MAX = 63.9  # and longer than that none is looked for
LAG_SPREAD = 0.5  # of a period: what comes later than the quickest frames by more had to wait
SHIFTS_TRIED = (-2, -1, 0, 1)  # whole periods, where nobody looks at when the frames came
CALIBRATION_FRAMES_MIN = 12
CALIBRATION_MISMATCH_MAX = 0.05
RATE_MAX = 1e-3  # no clock is further off
TRACKED = 500  # frames: 2 ms of jitter then leave the rate uncertain by 15 ppm
TRACKED_MIN = 16
STEPPED = 8  # frames that are all off mean a step
STEP = 0.1  # of a period: how far

LIGHTS = {Lamp.PROJECTOR: Light.PROJECTOR, Lamp.LED: Light.LED, Lamp.DARK: Light.DARK}
CLEAR = frozenset(LIGHTS.values())


@dataclass(frozen=True, slots=True)
class Offset:
    """Result of `calibrate_offset`."""

    offset_ns: int  # frame timestamp minus the end of its readout
    jitter_ns: int  # one sigma
    frames: int  # whose picture was compared
    mismatches: int
    lags_ns: tuple[int, ...] = ()  # of these frames: when it was in hand, minus the end of its readout
    count: int | None = None  # driver's count minus ordinal of the closing edge; None where the driver does not count


class OffsetTrack:
    """Where frames are against their edges, and how fast that moves."""

    def __init__(self, offset_ns: float, period_ns: int) -> None:
        self._offset_ns, self._period_ns = float(offset_ns), period_ns
        self._rate = 0.0
        self._at_ns: int | None = None  # timestamp that the offset is of
        self._frames = TRACKED_MIN
        self._residuals: deque[float] = deque(maxlen=STEPPED)

    @property
    def rate(self) -> float:
        """ns per ns."""
        return self._rate

    @property
    def residual_ns(self) -> float:
        """How far the last frames were from where they should be."""
        if len(self._residuals) < STEPPED:
            return 0.0
        ordered = sorted(self._residuals)  # statistics.median, in a fifth of the time: asked for every frame
        return (ordered[(STEPPED - 1) // 2] + ordered[STEPPED // 2]) / 2

    def at(self, timestamp_ns: int) -> float:
        """Offset of a frame stamped so."""
        return self._offset_ns + (0.0 if self._at_ns is None else self._rate * (timestamp_ns - self._at_ns))

    def moved(self, timestamp_ns: int, offset_ns: float) -> None:
        """The offset stepped; the rate stays."""
        self._offset_ns, self._at_ns = offset_ns, timestamp_ns
        self._residuals.clear()

    def follow(self, timestamp_ns: int, residual_ns: float) -> None:
        """A frame that was believed was so far from its edge."""
        self._residuals.append(residual_ns)
        step_ns = self.residual_ns
        if abs(step_ns) > STEP * self._period_ns:
            self.moved(timestamp_ns, self.at(timestamp_ns) + step_ns)
            return
        self._frames = n = min(self._frames + 1, TRACKED)
        clip = STEP * self._period_ns
        off = min(max(residual_ns, -clip), clip)
        since = self._period_ns if self._at_ns is None else max(self._period_ns, timestamp_ns - self._at_ns)
        self._offset_ns = self.at(timestamp_ns) + 2 * (2 * n - 1) / (n * (n + 1)) * off
        self._rate = min(max(self._rate + 6 / (n * (n + 1)) * off / since, -RATE_MAX), RATE_MAX)
        self._at_ns = timestamp_ns


def telling(frames: Iterable[FrameSeen]) -> list[FrameSeen]:
    """Those whose pictures say what lit them: whole, clear, and not seen before."""
    met: set[int] = set()
    told = []
    for frame in frames:
        picture = frame.picture
        if picture.light is not Light.DARK and picture.fingerprint is not None:
            if picture.fingerprint in met:
                continue
            met.add(picture.fingerprint)
        if picture.light in CLEAR and not picture.torn:
            told.append(frame)
    return told


def calibrate_offset(
    frames: Iterable[FrameSeen], history: EdgeHistory, period_ns: int, *, arrivals: bool = True, preamble: bool = True
) -> Offset:
    """The camera's offset from frames whose pictures show what lit them, and the edges of the same seconds.

    arrivals : whether to look at when the frames came. preamble : whether flashes of a preamble are looked at.

    AnnulusError when too little was seen, or when nothing or more than one offset agrees.
    """
    seen = telling(frames)
    if len(seen) < CALIBRATION_FRAMES_MIN or len(history.edges) < 2:
        raise AnnulusError(
            f"camera offset: {len(seen)} frames with a clear picture and {len(history.edges)} edges, expected"
            f" {CALIBRATION_FRAMES_MIN} frames or more. Do the lamps fire, and is the sync line connected?"
        )
    phase, jitter = _phase([frame.timestamp_ns for frame in seen], history, period_ns)
    placed = []  # frames and the edge they would end at if the offset had no whole periods
    for frame in seen:
        edge = history.nearest(frame.timestamp_ns - phase)
        if abs(frame.timestamp_ns - phase - edge.host_ns) <= WINDOW * period_ns:
            placed.append((frame, edge.ordinal))
    lag = _usual_lag(seen, phase, period_ns) if arrivals else None
    verdicts = _compared(placed, history, _shifts(lag, preamble), preamble)
    fitting = [v for v in verdicts if v[0] <= CALIBRATION_MISMATCH_MAX]
    if not fitting:
        best = min(verdicts, default=(1.0, 0, 0, 0))
        raise AnnulusError(
            f"camera offset: pictures and flashes agree under no offset (best: {best[1]} of {best[2]} disagree),"
            " expected projector and LED frames in the cycle that was configured"
        )
    if lag is not None:  # what only a preamble could prove gives way to what is usual
        fitting = [v for v in fitting if lag + v[3] <= LAG_PERIODS_MAX] or fitting
    if len(fitting) > 1:
        found = ", ".join(f"{(phase + v[3] * period_ns) / 1e6:.1f}" for v in fitting)
        raise AnnulusError(
            f"camera offset: {found} ms fit equally well, expected one. Calibrate with a ratio of 4 or more"
            " and LED frames in view"
        )
    _, mismatches, compared, shift = fitting[0]
    lags, counts = [], Counter[int]()
    for frame, ordinal in placed:
        closing = history.numbered(ordinal - shift)
        if closing is None:
            continue
        if arrivals:
            lags.append(frame.arrived_ns - closing.host_ns)
        if frame.sequence is not None:
            counts[frame.sequence - closing.ordinal] += 1
    count, times = counts.most_common(1)[0] if counts else (None, 0)
    return Offset(
        phase + shift * period_ns, jitter, compared, mismatches, tuple(lags), count if 2 * times > len(placed) else None
    )


def _usual_lag(seen: Sequence[FrameSeen], phase: int, period_ns: int) -> float:
    """From edge to having the frame, in periods, if the offset had no whole periods."""
    lags = sorted(frame.arrived_ns - frame.timestamp_ns + phase for frame in seen)
    usual = lags[len(lags) // 8]
    if sum(abs(lag - usual) <= LAG_SPREAD * period_ns for lag in lags) * 2 < len(lags):
        raise AnnulusError("camera offset: frames come in bursts, expected one a period. Is the host overloaded?")
    return usual / period_ns


def _shifts(lag: float | None, preamble: bool) -> Iterable[int]:
    """Whole periods that are possible: of frames that came when they came."""
    if lag is None:
        return SHIFTS_TRIED
    longest = LAG_PERIODS_PROVED_MAX if preamble else LAG_PERIODS_MAX
    return range(math.ceil(LAG_PERIODS_MIN - lag), math.floor(longest - lag) + 1)


def _compared(
    placed: Sequence[tuple[FrameSeen, int]], history: EdgeHistory, shifts: Iterable[int], preamble: bool
) -> list[tuple[float, int, int, int]]:
    """Of each shift under which enough frames have a flash: share of mismatches, mismatches, compared, shift."""
    flashes = {edge.ordinal: history.lit(edge.ordinal) for edge in history.edges}
    hopeless = max(CALIBRATION_MISMATCH_MAX * len(placed), 1)
    verdicts = []
    for shift in shifts:
        compared = mismatches = 0
        for frame, ordinal in placed:
            flash = flashes.get(ordinal - shift)
            if flash is None or not (preamble or EdgeFlag.PREAMBLE not in flash.flags):
                continue
            compared += 1
            mismatches += LIGHTS[flash.lamp] is not frame.picture.light
            if mismatches > hopeless:
                break
        if compared >= CALIBRATION_FRAMES_MIN // 2:
            verdicts.append((mismatches / compared, mismatches, compared, shift))
    return verdicts


def _phase(stamps: Sequence[int], history: EdgeHistory, period_ns: int) -> tuple[int, int]:
    """Circular mean, and spread, of timestamp minus nearest edge, ns in (-period/2, period/2]."""
    angles = [2 * math.pi * (stamp - history.nearest(stamp).host_ns) / period_ns for stamp in stamps]
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
