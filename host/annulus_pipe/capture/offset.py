"""A camera's timestamp offset: found from pictures, then followed, with its rate.

`calibrate_offset` finds it. The fraction of a period is the circular mean of the frames' phases. Which whole periods,
pictures say: each shift that is possible is an hypothesis, each picture agrees with the flash that it names or does
not, and one is proved when all others together are less likely than CHANCE. Frames whose stamp is off by itself are
reckoned with, and cost time, not truth.

A lamp cycle looks like itself a cycle on. So how long a driver may keep a frame has a say (a prior), and where flashes
of a preamble are to be had, nothing is proved before they have spoken.

`OffsetTrack` follows it: a line fitted to what the frames were off, which forgets after TRACKED frames.
"""

import math
from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.capture.history import EdgeHistory
from annulus_pipe.capture.photometry import Light
from annulus_pipe.capture.seen import FrameSeen
from annulus_pipe.capture.slides import ALL_SLIDES, LIGHTS, SlidesSeen
from annulus_pipe.vocabulary import AnnulusError, EdgeFlag

WINDOW = 0.25  # of a period: how far a frame may be from its edge
LAG_PERIODS_MIN = -0.1  # of a period: how early a frame may seem, for an edge is placed only so well
LAG_PERIODS_MAX = 4.9  # a driver with four buffers, as we ask for, keeps no frame longer
LAG_PERIODS_DEEP = 8.9  # .. one with eight
LAG_PERIODS_PROVED_MAX = 63.9  # and longer than that none is looked for
DEEP = 1e-4  # how likely a driver is to keep a frame longer than LAG_PERIODS_MAX, against that it does not
DEEPEST = 1e-11  # .. and longer than LAG_PERIODS_DEEP, as long as no picture speaks for it: less than CHANCE for all
AS_BEFORE = 1e3  # how much likelier a camera that began anew is to stamp and deliver as before than otherwise
CHANCE = 1e-9  # of a wrong proof, a search; tests/unit/capture/test_offset.py counts them
ODD_MAX = 0.15  # of the pictures: contradict, as where one stamp in four is off by a frame. Beyond nothing is proved
SOUND, SOUND_MAX = 0.9, 0.01  # nine cameras in ten have fewer odd frames than that
LAG_SPREAD = 0.5  # of a period: what comes later than the quickest frames by more had to wait
HOLE = 1.5  # periods between two frames: one is missing
SHIFTS_TRIED = (-2, -1, 0, 1)  # whole periods, where nobody looks at when the frames came
CALIBRATION_FRAMES_MIN = 12
RATE_MAX = 1e-3  # no clock is further off
TRACKED = 500  # frames: 2 ms of jitter then leave the rate uncertain by 15 ppm
TRACKED_MIN = 16
STEPPED = 8  # frames that are all off mean a step
STEP = 0.1  # of a period: how far

CLEAR = frozenset(LIGHTS.values())

_CODES = {light: code for code, light in enumerate(Light)}
_NO_FLASH = -1
_ODD = np.concatenate([np.linspace(0.0, SOUND_MAX, 9)[1:], np.linspace(0.0, ODD_MAX, 65)[1:]])  # shares of odd frames
_PRIOR = np.repeat([SOUND / 8, (1 - SOUND) / 64], [8, 64])  # .. and how likely each is


@dataclass(frozen=True, slots=True)
class Offset:
    """Result of `calibrate_offset`."""

    offset_ns: int  # frame timestamp minus the end of its readout
    jitter_ns: int  # one sigma
    frames: int  # whose picture was compared
    mismatches: int
    chance: float  # that it is another
    lags_ns: tuple[int, ...] = ()  # of these frames: when it was in hand, minus the end of its readout
    count: int | None = None  # driver's count minus ordinal of the closing edge; None where the driver does not count
    off_ns: tuple[int, ...] = ()  # of the frames of `lags_ns`: how far the stamp was from where the offset puts it
    last: int | None = None  # ordinal of the closing edge of the last frame
    holed: bool = False  # frames are missing among these, and no count spans them: the last may be of another offset


class ProvedOffset(NamedTuple):
    """What was proved before the camera began anew."""

    offset_ns: float
    lag_ns: int | None


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
    chosen = []
    for frame in frames:
        picture = frame.picture
        if picture.light is not Light.DARK and picture.fingerprint is not None:
            if picture.fingerprint in met:
                continue
            met.add(picture.fingerprint)
        if picture.light in CLEAR and not picture.torn:
            chosen.append(frame)
    return chosen


def calibrate_offset(
    frames: Iterable[FrameSeen],
    history: EdgeHistory,
    period_ns: int,
    *,
    arrivals: bool = True,
    preamble: bool = True,
    before: ProvedOffset | None = None,
    adrift: bool = False,
    slides: SlidesSeen = ALL_SLIDES,
) -> Offset:
    """The camera's offset from frames whose pictures show what lit them, and the edges of the same seconds.

    arrivals : whether to look at when the frames came. preamble : whether flashes of a preamble are looked at.
    before : what the camera did until it began anew. adrift : frames may have been kept or lost by whole lamp cycles,
    any number of them, so that only a preamble proves anything, whether or not there is one. slides : those it sees.

    AnnulusError when too little was seen, or when nothing or more than one offset agrees.
    """
    frames = list(frames)
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
    shifts = _shifts(lag, (preamble and history.preambled) or adrift)
    weights = np.array([_weight(lag, shift, phase, period_ns, before, adrift) for shift in shifts])
    best = _proved(placed, history, shifts, weights, preamble, slides)
    if best.chance > CHANCE:
        raise AnnulusError(_unproved(best, phase, period_ns))
    shift = shifts[best.at]
    lags, off, counts = [], [], Counter[int]()
    for frame, ordinal in placed:
        closing = history.numbered(ordinal - shift)
        if closing is None:
            continue
        if lag is not None and frame.arrived_ns - closing.host_ns >= (lag + shift - LAG_SPREAD) * period_ns:
            lags.append(frame.arrived_ns - closing.host_ns)
            off.append(frame.timestamp_ns - closing.host_ns - phase - shift * period_ns)
        if frame.sequence is not None:
            counts[frame.sequence - closing.ordinal] += 1
    count, times = counts.most_common(1)[0] if counts else (None, 0)
    return Offset(
        phase + shift * period_ns,
        jitter,
        best.compared,
        best.mismatches,
        best.chance,
        tuple(lags),
        count if 2 * times > len(placed) else None,
        tuple(off),
        history.nearest(frames[-1].timestamp_ns - phase).ordinal - shift,
        any(
            later.sequence is None and later.timestamp_ns - frame.timestamp_ns > HOLE * period_ns
            for frame, later in pairwise(frames)
        ),
    )


def _usual_lag(seen: Sequence[FrameSeen], phase: int, period_ns: int) -> float:
    """From edge to having the frame, in periods, if the offset had no whole periods: of most frames, for single stamps
    may be off, and single frames have waited.
    """
    lags = sorted(frame.arrived_ns - frame.timestamp_ns + phase for frame in seen)
    spread_ns = LAG_SPREAD * period_ns
    many, first = max((sum(0 <= lag - low <= 2 * spread_ns for lag in lags[i:]), -i) for i, low in enumerate(lags))
    usual = lags[-first + many // 8]
    if sum(abs(lag - usual) <= spread_ns for lag in lags) * 2 < len(lags):
        raise AnnulusError("camera offset: frames come in bursts, expected one a period. Is the host overloaded?")
    return usual / period_ns


def _shifts(lag: float | None, preamble: bool) -> Sequence[int]:
    """Whole periods that are possible: of frames that came when they came."""
    if lag is None:
        return SHIFTS_TRIED
    longest = LAG_PERIODS_PROVED_MAX if preamble else LAG_PERIODS_MAX
    return range(math.ceil(LAG_PERIODS_MIN - lag), math.floor(longest - lag) + 1)


def _weight(
    lag: float | None, shift: int, phase: int, period_ns: int, before: ProvedOffset | None, adrift: bool
) -> float:
    """How likely a shift is before any picture was looked at, against one that is usual. A driver that has been seen to
    keep more frames may keep any number."""
    if lag is None:
        return 1.0
    periods = lag + shift
    weight = DEEP if periods > LAG_PERIODS_MAX else 1.0
    if periods > LAG_PERIODS_DEEP and not adrift:
        weight = DEEPEST
    if before is None or before.lag_ns is None:
        return weight
    same_stamp = abs(phase + shift * period_ns - before.offset_ns) <= WINDOW * period_ns
    same_lag = abs(periods - before.lag_ns / period_ns) <= LAG_SPREAD
    return AS_BEFORE if same_stamp and same_lag else weight


class _Best(NamedTuple):
    """The likeliest shift, and how likely all others are together against it."""

    at: int  # in the list of shifts
    chance: float
    compared: int
    mismatches: int
    rivals: tuple[int, ...] = ()  # shifts that keep it from being proved, the likeliest first


def _proved(
    placed: Sequence[tuple[FrameSeen, int]],
    history: EdgeHistory,
    shifts: Sequence[int],
    weights: NDArray[np.float64],
    preamble: bool,
    slides: SlidesSeen,
) -> _Best:
    """Two shifts are compared on the frames that have a flash under both: alike, a frame more or less in one of them
    does not count.
    """
    lamps = {
        edge.ordinal: _CODES[LIGHTS[flash.lamp]]
        for edge in history.edges
        if (flash := history.lit(edge.ordinal)) is not None
        and (preamble or EdgeFlag.PREAMBLE not in flash.flags)
        and not slides.blind(flash)
    }
    named = np.array([[lamps.get(ordinal - shift, _NO_FLASH) for _, ordinal in placed] for shift in shifts], dtype=int)
    pictures = np.array([_CODES[frame.picture.light] for frame, _ in placed], dtype=int)
    if named.size == 0:
        return _Best(0, 1.0, 0, 0)
    known = named != _NO_FLASH
    differs = known & (named != pictures)
    compared, mismatches = known.sum(axis=1), differs.sum(axis=1)
    best = _Best(0, math.inf, 0, 0)
    for at in map(int, np.flatnonzero((compared >= CALIBRATION_FRAMES_MIN) & (mismatches <= ODD_MAX * compared))):
        both = known & known[at]
        n = both.sum(axis=1)
        theirs, ours = ((both & differs[rows]).sum(axis=1) for rows in (slice(None), at))
        rivals = weights / max(weights[at], DEEP)
        if weights[at] > DEEPEST:
            rivals[weights == DEEPEST] = DEEPEST
        odds = np.exp(_log_likelihood(n, theirs) - _log_likelihood(n, ours)) * rivals
        odds[at] = 0.0
        chance = float(odds.sum())
        if chance < best.chance:
            left = tuple(shifts[i] for i in np.argsort(-odds)[:3] if odds[i] > CHANCE)
            best = _Best(at, chance, int(compared[at]), int(mismatches[at]), left)
    if math.isinf(best.chance):  # none is possible: the least bad, for the message
        at = int(np.argmin(mismatches / np.maximum(compared, 1) + (compared == 0)))
        return _Best(at, math.inf, int(compared[at]), int(mismatches[at]))
    return best


def _log_likelihood(frames: NDArray[np.int_], mismatches: NDArray[np.int_]) -> NDArray[np.float64]:
    """Of so many mismatches in so many frames, whatever the share of odd frames is."""
    logs = mismatches[:, None] * np.log(_ODD) + (frames - mismatches)[:, None] * np.log1p(-_ODD)
    top = logs.max(axis=1)
    found: NDArray[np.float64] = top + np.log(np.exp(logs - top[:, None]) @ _PRIOR)
    return found


def _unproved(best: _Best, phase: int, period_ns: int) -> str:
    """Why no offset is proved, for the operator."""
    if not best.rivals:
        return (
            "camera offset: pictures and flashes agree under no offset (best:"
            f" {best.mismatches} of {best.compared} disagree), expected projector and LED frames in the cycle that was"
            " configured"
        )
    rivals = ", ".join(f"{(phase + shift * period_ns) / 1e6:.1f}" for shift in best.rivals)
    return (
        f"camera offset: {rivals} ms may fit as well, as far as {best.compared} frames tell, expected one."
        " More frames may tell, or a preamble ([lamps] preamble_frames), or a ratio of 4 or more with LED frames in"
        " view"
    )


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
