"""What one turn of the turntable recorded, and what is wrong with it before anybody makes an image of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.late import fft
from annulus_pipe.vocabulary import AnnulusError

POSITIONS_MAX = 8192  # Unguarded, both: a wrong file must not fill the memory
SAMPLES_MAX = 1 << 22
# Guards, all in tests/wings/tai/test_imaging.py: test_receivers_at_odd_angles_are_neither_stuck_nor_holes
# for HOLE; for the others test_bad_traces_are_named_and_left_out, test_a_round_object_is_not_a_stage_that_stands_still.
HOLE = 2.5  # times the usual spacing, for receivers need not stand evenly ..
HOLE_DEG = 12.0  # .. and at least so much
CLIPPED = 3  # neighbouring samples at the very same extreme: a converter at its rail
GENTLE = 0.15  # of the span, over how many are flat: a top that falls off by less is round, and flat for want of bits
SILENT = 0.2  # of the usual strength: nothing was heard at that position
REPEATED = 0.98  # correlation of neighbours above which the turntable may not have moved ..
USUAL = 0.9  # .. if that of neighbours elsewhere is less than this
BAND_ORDER = 8  # a Butterworth filter of order 4 run both ways. Guard: test_a_band_keeps_its_sound_and_nothing_else


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """Pressure heard at positions on a circle about the object.

    `angles_deg` is counted from +x towards +y; the receiver stands at radius_mm (cos, sin). Sample k of a trace was
    taken t0_s + k / sampling_rate_hz after the middle of the excitation pulse (or of its decoded peak).
    """

    signals: NDArray[np.float64]  # (positions, samples), any unit
    angles_deg: NDArray[np.float64]  # (positions,)
    radius_mm: float
    sampling_rate_hz: float
    t0_s: float = 0.0
    sound_speed_m_s: float = 1500.0

    def __post_init__(self) -> None:
        signals, angles = np.asarray(self.signals, float), np.asarray(self.angles_deg, float)
        if signals.ndim != 2 or not 1 <= signals.shape[0] <= POSITIONS_MAX or not 16 <= signals.shape[1] <= SAMPLES_MAX:
            raise AnnulusError(
                f"signals of shape {signals.shape}, expected (positions, samples), 1..{POSITIONS_MAX} positions of "
                f"16..{SAMPLES_MAX} samples"
            )
        if angles.shape != (len(signals),) or not np.isfinite(angles).all():
            raise AnnulusError(f"angles_deg of shape {angles.shape}, expected {len(signals)} numbers, one a position")
        for name, value, low, high in (
            ("radius_mm", self.radius_mm, 0.1, 1e4),
            ("sampling_rate_hz", self.sampling_rate_hz, 1e3, 1e11),
            ("t0_s", self.t0_s, -1.0, 1.0),
            ("sound_speed_m_s", self.sound_speed_m_s, 100.0, 10_000.0),
        ):
            if not (math.isfinite(value) and low <= value <= high):
                raise AnnulusError(f"{name} is {value:g}, expected {low:g}..{high:g}")
        object.__setattr__(self, "signals", signals)
        object.__setattr__(self, "angles_deg", angles)

    @property
    def times_s(self) -> NDArray[np.float64]:
        return self.t0_s + np.arange(self.signals.shape[1]) / self.sampling_rate_hz

    @property
    def positions_mm(self) -> NDArray[np.float64]:
        turn = np.radians(self.angles_deg)
        return self.radius_mm * np.stack([np.cos(turn), np.sin(turn)], axis=1)

    def since(self, time_s: float) -> "Sweep":
        """Without the samples before that time; 16 stay at least."""
        first = int(np.clip(np.searchsorted(self.times_s, time_s), 0, max(self.signals.shape[1] - 16, 0)))
        return replace(self, signals=self.signals[:, first:], t0_s=float(self.times_s[first]))

    def only(self, kept: NDArray[np.bool_] | Sequence[int]) -> "Sweep":
        return replace(self, signals=self.signals[kept], angles_deg=self.angles_deg[kept])


@dataclass(frozen=True, slots=True)
class SweepFault:
    """Something wrong with positions of a sweep. `excluded`: they must not reach the image."""

    kind: str  # "not a number", "clipped", "silent", "same place", "timing"
    positions: tuple[int, ...]
    text: str  # one line for a person
    excluded: bool


def examine(sweep: Sweep) -> list[SweepFault]:
    """Everything about a sweep that would make a wrong image. Names positions from 0.

    Raises nothing: who calls decides. Traces with `excluded` faults must be left out (`usable`).
    """
    signals = sweep.signals
    faults = []
    bad = np.asarray(~np.isfinite(signals).all(axis=1), np.bool_)
    if bad.any():
        faults.append(_fault("not a number", bad, "hold values that are no numbers; left out", True))
    clean = np.where(bad[:, None], 0.0, signals)
    late = _after_the_spike(sweep)
    heard = clean[:, late] - clean[:, late].mean(axis=1, keepdims=True)
    clipped = ~bad & (_longest_at_rail(heard) >= CLIPPED)
    if clipped.any():
        faults.append(_fault("clipped", clipped, "are cut off at the digitizer's range; left out", True))
    strength = np.sqrt((heard**2).mean(axis=1))
    good = ~bad & ~clipped
    usual = float(np.median(strength[good])) if good.any() else 0.0
    silent = good & (strength <= SILENT * usual)
    if usual == 0.0:
        silent = good
    if silent.any():
        faults.append(_fault("silent", silent, "heard next to nothing (trigger lost, cable?); left out", True))
    good &= ~silent
    stuck = _stuck(heard, sweep.angles_deg, good)
    if stuck.any():
        text = "repeat the position before: the turntable did not move; left out"
        faults.append(_fault("same place", stuck, text, True))
    shifted = _shifted(sweep, good & ~stuck)
    if shifted is not None:
        faults.append(SweepFault("timing", (), shifted, False))
    return faults


def usable(sweep: Sweep, faults: Sequence[SweepFault]) -> NDArray[np.bool_]:
    """(positions,) True where no fault excludes the trace."""
    kept = np.ones(len(sweep.signals), bool)
    for fault in faults:
        if fault.excluded:
            kept[list(fault.positions)] = False
    return kept


def gaps_deg(angles_deg: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Holes of the circle, (from, to) in degrees rising: wider than HOLE times the usual spacing, and than HOLE_DEG."""
    turn = np.unique(np.mod(angles_deg, 360.0))
    if len(turn) < 2:
        return [(float(turn[0]), float(turn[0]) + 360.0)] if len(turn) else [(0.0, 360.0)]
    step = np.diff(np.append(turn, turn[0] + 360.0))
    widest = max(HOLE * float(np.median(step)), HOLE_DEG)
    return [(float(turn[i]), float(turn[i] + step[i])) for i in np.flatnonzero(step > widest)]


def without_coupling(sweep: Sweep, object_radius_mm: float) -> Sweep:
    """Takes out what cannot be sound: the coupling of the radio-frequency pulse into the receiver.

    Nothing from inside `object_radius_mm` can arrive before (radius - object radius) / c: faded out up to there. What
    the amplifier's recovery leaves after that instant is the same at every position and decays: where the median over
    the positions falls exponentially over the second half of the silence, that exponential is subtracted to the end.
    """
    first = max(sweep.radius_mm - object_radius_mm, 0.0) * 1e-3 / sweep.sound_speed_m_s
    times = sweep.times_s
    fade = max(0.1 * first, 4.0 / sweep.sampling_rate_hz)
    window = 0.5 - 0.5 * np.cos(math.pi * np.clip((times - (first - fade)) / fade, 0.0, 1.0))
    signals = sweep.signals
    recovery = (times >= 0.5 * first) & (times < first - 0.5 * fade)
    if np.count_nonzero(recovery) >= 8:
        common = np.median(signals[:, recovery], axis=0)
        sign = 1.0 if common.mean() > 0 else -1.0
        if (sign * common > 0).all():
            rate, level = np.polyfit(times[recovery], np.log(sign * common), 1)
            fitted = sign * np.exp(level + rate * times[recovery])
            if rate < 0 and np.linalg.norm(common - fitted) < 0.2 * np.linalg.norm(common):
                signals = signals - sign * np.exp(np.minimum(level + rate * times, 700.0))
    return replace(sweep, signals=signals * window)


def band_passed(sweep: Sweep, low_hz: float, high_hz: float) -> Sweep:
    """Only the sound between two frequencies: half the amplitude at both, 1/100 less than an octave out, no delay."""
    if not 0 <= low_hz < high_hz <= sweep.sampling_rate_hz / 2:
        raise AnnulusError(
            f"a band of {low_hz / 1e6:g}..{high_hz / 1e6:g} MHz, expected rising and at most half the sampling rate, "
            f"{sweep.sampling_rate_hz / 2e6:g} MHz"
        )
    ends = sweep.signals.shape[1] - 1  # turned over beyond both ends, so that hum has no step there
    signals = np.pad(sweep.signals, ((0, 0), (ends, ends)), mode="reflect", reflect_type="odd")
    frequency = np.maximum(fft.rfftfreq(signals.shape[1], 1 / sweep.sampling_rate_hz), 1e-9)
    gain = 1 / ((1 + (low_hz / frequency) ** BAND_ORDER) * (1 + (frequency / high_hz) ** BAND_ORDER))
    passed = fft.irfft(fft.rfft(signals, axis=1) * gain, signals.shape[1], axis=1)
    return replace(sweep, signals=passed[:, ends : 2 * ends + 1])


def _after_the_spike(sweep: Sweep) -> NDArray[np.bool_]:
    """Samples later than a twentieth of the way to the middle: the spike may clip, it is no sound."""
    late = sweep.times_s > 0.05 * sweep.radius_mm * 1e-3 / sweep.sound_speed_m_s
    return late if np.count_nonzero(late) >= 16 else np.ones(sweep.signals.shape[1], bool)


def _longest_at_rail(signals: NDArray[np.float64]) -> NDArray[np.int64]:
    longest = np.zeros(len(signals), np.int64)
    for i, trace in enumerate(signals):
        span = float(trace.max() - trace.min())
        if span == 0.0:
            continue
        for rail in (trace.max(), trace.min()):
            at = np.flatnonzero(np.abs(trace - rail) <= 1e-9 * span)
            for run in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1):
                beside = [trace[k] for k in (run[0] - 1, run[-1] + 1) if 0 <= k < len(trace)]
                if len(beside) < 2 or max(abs(value - rail) for value in beside) > GENTLE * span / len(run):
                    longest[i] = max(longest[i], len(run))
    return longest


def _stuck(heard: NDArray[np.float64], angles_deg: NDArray[np.float64], good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Positions whose trace is the one before again while the angles say that the turntable turned.

    A round object sounds the same from everywhere; so this asks whether neighbours elsewhere differ more, and at last
    whether two traces differ by nothing at all.
    """
    stuck = np.zeros(len(heard), bool)
    order = np.flatnonzero(good)
    if len(order) < 2:
        return stuck
    a, b = heard[order[:-1]], heard[order[1:]]
    power = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
    likeness = (a * b).sum(axis=1) / np.maximum(power, 1e-300)
    turned = np.abs(np.diff(angles_deg[order]))
    moved = turned > 1e-6
    same = (np.abs(a - b).max(axis=1) <= 1e-12 * np.abs(a).max(axis=1)) & (power > 0)
    usual = turned > 0.5 * float(np.median(turned))  # two receivers side by side may well hear the same
    close = usual & (likeness > REPEATED) & (float(np.median(likeness)) < USUAL)
    stuck[order[1:][moved & (same | close)]] = True
    return stuck


def _shifted(sweep: Sweep, good: NDArray[np.bool_]) -> str | None:
    """A sweep whose sound lies where none can: a wrong sampling rate, radius, or trigger."""
    if np.count_nonzero(good) < 3:
        return None
    late = _after_the_spike(sweep)
    signals, times = sweep.signals[good][:, late], sweep.times_s[late]
    power = (signals - signals.mean(axis=1, keepdims=True)) ** 2
    floor = np.median(power, axis=1, keepdims=True)  # of the noise, if half the record holds no sound
    energy = np.maximum(power - 2.2 * floor, 0.0).sum(axis=0)
    across = 2 * sweep.radius_mm * 1e-3 / sweep.sound_speed_m_s
    total = energy.sum()
    if total <= 0:
        return None
    after = float(energy[times > 1.05 * across].sum() / total)
    if after > 0.5:
        return (
            f"{100 * after:.0f} % of the sound comes after {1e6 * across:.1f} us, the time to cross the whole circle "
            f"({sweep.radius_mm:g} mm radius) at {sweep.sound_speed_m_s:g} m/s: check sampling rate, radius and t0"
        )
    middle = float((energy * times).sum() / total)
    if middle < 0.2 * across / 2:
        return (
            f"the sound is centred at {1e6 * middle:.2f} us, but the middle of the circle is {1e6 * across / 2:.1f} us "
            f"away ({sweep.radius_mm:g} mm at {sweep.sound_speed_m_s:g} m/s): check sampling rate, radius and t0"
        )
    return None


def _fault(kind: str, where: NDArray[np.bool_], text: str, excluded: bool) -> SweepFault:
    positions = tuple(int(i) for i in np.flatnonzero(where))
    shown = ", ".join(map(str, positions[:8])) + (" .." if len(positions) > 8 else "")
    return SweepFault(kind, positions, f"{len(positions)} of {len(where)} traces ({shown}) {text}", excluded)
