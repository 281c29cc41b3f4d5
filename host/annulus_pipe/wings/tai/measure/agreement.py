"""What receivers say of each other: the speed of sound at which they agree, and the receiver that agrees with no other.

Theory of operation. Every receiver's trace, smeared back over the arcs it may have come from, must draw the same
sample as the others' do. At a wrong speed of sound opposite halves of the circle draw the same edge at two places; a
damaged or late receiver draws what the rest does not. Both need to know how sound arrives. From a small source in
space it comes as a pulse without a tail; from a long one (a plane problem, a cylinder) it trails its front by half a
derivative, a phase of 45 degrees. Taken for the other, a sweep reads a speed 0.7 to 2 % wrong. Where it is not known
which, both are tried, with the same weight on every frequency, and the better agreement is kept. The weight is that
of a derivative: low frequencies are blurred alike under either phase and would drown the difference.

Where it breaks: on a circle a delay common to all receivers and a wrong speed only scale the image, to first order, and
the less bandwidth, the more a phase is like a delay. Sound of small spheres in space was always told; of a plane's,
samples with few edges under a narrow band were not (topic sound_speed counts them). So what is known should be said.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.late import fft
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.imaging import OUTSIDE, Region, arcs, pixel_mm, source_term
from annulus_pipe.wings.tai.measure.sweep import Sweep, gaps_deg

Arrival = Literal["space", "plane"]
LAG_RAD: Mapping[Arrival, float] = {"space": 0.0, "plane": 0.25 * math.pi}

# Correlation of opposite halves at the best speed; noise alone has 0.02. Guard: test_noise_has_no_speed_of_sound.
AGREEMENT = 0.05
LOOK = 72  # pixels from the axis to a receiver, at most: finer costs time. Guard: topic sound_speed.
SMOOTHED = 0.7  # nepers at a wave of four pixels: what a look cannot carry. Guard: topic sound_speed.
WITHIN = 0.8  # of the receivers' radius is compared, if nobody says; nearer to a receiver its own arc
# outshines all. Guard: topic sound_speed.
# With fewer positions, or a wider hole, halves of the circle are no halves. Guard of both:
# test_a_maximum_at_the_end_of_the_range_is_none.
POSITIONS = 12
HOLE_DEG = 120.0
SPEEDS = 21  # tried over the range ..
FINER = 9  # .. and about the best of them. Guard of both: topic sound_speed.

# Guards of what follows: topic sound_speed, test_one_damaged_receiver_is_named, test_sound_receivers_are_not_accused.
NEIGHBOURS = 3  # to each side: agreement depends on the direction from which the sample is heard
DISAGREES = 6.0  # robust sigmas of correlation below the neighbours; sound receivers stay within 5
BY = 0.2  # of correlation at least, or it is not worth a word
BAD_PART = 0.1  # of the receivers at most: beyond, the sweep is wrong and not a receiver


@dataclass(frozen=True, slots=True, eq=False)
class SpeedFit:
    """The speed of sound, m/s, under one way to arrive, and the agreement (correlation of halves) that it reaches."""

    arrival: Arrival
    sound_speed_m_s: float
    agreement: float
    tried_m_s: NDArray[np.float64]  # rising
    agreements: NDArray[np.float64]  # at those

    @property
    def arrival_text(self) -> str:
        return {"space": "space, from small parts", "plane": "a plane, from long parts"}[self.arrival]


def search_sound_speed(
    sweep: Sweep,
    low_m_s: float,
    high_m_s: float,
    arrival: Arrival | None = None,
    region: Region | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[SpeedFit, SpeedFit]:
    """The speed of sound at which halves of the circle agree best, and what the other way to arrive would have given.

    First comes the fit for `arrival`, or, where that is not known, the one with the better agreement.

    Agreement is the correlation between quick looks from opposite half circles, averaged over four ways to halve it,
    inside `region` (mm; default WITHIN of the circle).

    Raises AnnulusError where there are too few positions, or no maximum inside the range.
    """
    if not 100 <= low_m_s < high_m_s <= 10_000:
        raise AnnulusError(f"a range of {low_m_s:g}..{high_m_s:g} m/s, expected two rising speeds in 100..10000")
    if len(sweep.signals) < POSITIONS or any(stop - start > HOLE_DEG for start, stop in gaps_deg(sweep.angles_deg)):
        raise AnnulusError(
            f"the speed of sound cannot be searched: expected at least {POSITIONS} positions and no hole over "
            f"{HOLE_DEG:g} deg"
        )
    middle = replace(sweep, sound_speed_m_s=0.5 * (low_m_s + high_m_s))
    total = 2 * (SPEEDS + FINER)
    fits: list[SpeedFit] = []
    for way in LAG_RAD:
        halves = _Halves(_Looks(middle, way, region))
        tried: dict[float, float] = {}

        def agreement(speed: float, halves: "_Halves" = halves, tried: dict[float, float] = tried) -> float:
            if speed not in tried:
                tried[speed] = halves.agreement(speed)
            if progress:
                progress("speed of sound", len(fits) * (SPEEDS + FINER) + len(tried), total)
            return tried[speed]

        fits.append(_fitted(way, agreement, tried, low_m_s, high_m_s))
    if progress:
        progress("speed of sound", total, total)
    best, other = sorted(fits, key=lambda fit: (fit.arrival != arrival if arrival else 0, -fit.agreement))
    if best.agreement < AGREEMENT:
        raise AnnulusError(
            f"halves of the circle never agree in {low_m_s:g}..{high_m_s:g} m/s (correlation {best.agreement:.2f}): "
            "widen the range, or check sampling rate and radius"
        )
    for fit in fits if arrival is None else [best]:
        if fit.sound_speed_m_s in (low_m_s, high_m_s):
            raise AnnulusError(
                f"as sound in {fit.arrival_text}, halves of the circle agree best at the end of "
                f"{low_m_s:g}..{high_m_s:g} m/s, at {fit.sound_speed_m_s:.0f} m/s: widen the range, "
                "or check sampling rate and radius"
            )
    return best, other


def _fitted(
    arrival: Arrival, agreement: Callable[[float], float], tried: dict[float, float], low: float, high: float
) -> SpeedFit:
    """A grid over the range, a finer one about its best, a parabola through that. The end itself if it is the best."""
    speeds = np.linspace(low, high, SPEEDS)
    best = int(np.argmax([agreement(float(speed)) for speed in speeds]))
    top = float(speeds[best])
    if 0 < best < SPEEDS - 1:
        fine = np.linspace(speeds[best - 1], speeds[best + 1], FINER)
        values = [agreement(float(speed)) for speed in fine]
        bend = np.polynomial.polynomial.polyfit(fine - top, values, 2)
        top = top - bend[1] / (2 * bend[2]) if bend[2] < 0 else float(fine[int(np.argmax(values))])
        top = float(np.clip(top, fine[0], fine[-1]))
    order = np.array(sorted(tried))
    return SpeedFit(arrival, top, max(tried.values()), order, np.array([tried[speed] for speed in order]))


def receiver_agreement(sweep: Sweep, arrival: Arrival, region: Region | None = None) -> NDArray[np.float64]:
    """(positions,) correlation of each trace with what the image made without it would sound like there."""
    return _Looks(sweep, arrival, region).each_with_the_rest()


def likelier_arrival(sweep: Sweep, region: Region | None = None) -> Arrival:
    """The way for sound to arrive under which halves of the circle agree better at the sweep's own speed of sound."""
    space, plane = (_Halves(_Looks(sweep, arrival, region)).agreement(sweep.sound_speed_m_s) for arrival in LAG_RAD)
    return "space" if space > plane else "plane"


def disagreeing(sweep: Sweep, arrival: Arrival, region: Region | None = None) -> list[tuple[int, float, float]]:
    """Receivers that agree with the rest far less than their neighbours do: (position, agreement, neighbours').

    The worst first; each is left out before the next is looked for, so that one does not make others look bad, and none
    beside it is accused: they hear into the hole that it leaves. Needs POSITIONS; names BAD_PART of them at most.
    """
    left = np.arange(len(sweep.signals))
    around = np.argsort(np.mod(sweep.angles_deg, 360.0), kind="stable")
    spared: set[int] = set()
    found: list[tuple[int, float, float]] = []
    while len(left) >= POSITIONS and len(found) < BAD_PART * len(sweep.signals):
        order = np.argsort(np.mod(sweep.angles_deg[left], 360.0), kind="stable")
        each = receiver_agreement(sweep.only(left.tolist()), arrival, region)[order]
        sides = [[np.roll(each, way * k) for k in range(1, NEIGHBOURS + 1)] for way in (-1, 1)]
        spread = 1.4826 * float(np.median(np.abs(np.median([*sides[0], *sides[1]], axis=0) - each)))
        beside = np.minimum(*(np.median(side, axis=0) for side in sides))  # the flank of a smooth dip is not alone
        below = np.where([int(left[i]) in spared for i in order], 0.0, beside - each)
        worst = int(np.argmax(below))
        if below[worst] <= max(DISAGREES * spread, BY):
            break
        found.append((int(left[order[worst]]), float(each[worst]), float(beside[worst])))
        place = int(np.flatnonzero(around == found[-1][0])[0])
        spared |= {int(around[(place + way) % len(around)]) for way in (-1, 1)}
        left = np.delete(left, order[worst])
    return found


class _Looks:
    """Every receiver's trace smeared back over the same pixels."""

    def __init__(self, sweep: Sweep, arrival: Arrival, region: Region | None) -> None:
        dx = max(pixel_mm(sweep), sweep.radius_mm / LOOK)
        self.sweep = _weighted(sweep, arrival, dx)
        x, y = (region or Region.about_axis(WITHIN * sweep.radius_mm)).grid_mm(dx)
        inside = np.hypot(x, y) < (sweep.radius_mm if region else WITHIN * sweep.radius_mm)
        if np.count_nonzero(inside) < 16:
            raise AnnulusError(OUTSIDE)
        self.x_mm, self.y_mm, self.dx_mm = x[inside], y[inside], dx
        self.source, self.arcs = source_term(self.sweep), arcs(sweep.angles_deg)

    def each(self, speed_m_s: float) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """(distances mm, values) of each receiver's look at the pixels."""
        times = self.sweep.times_s
        for (x, y), trace, arc in zip(self.sweep.positions_mm, self.source, self.arcs, strict=True):
            way = np.hypot(self.x_mm - x, self.y_mm - y)
            yield way, arc * np.interp(way * (1e-3 / speed_m_s), times, trace, left=0.0, right=0.0)

    def each_with_the_rest(self) -> NDArray[np.float64]:
        speed = self.sweep.sound_speed_m_s
        total = np.sum([look for _, look in self.each(speed)], axis=0)
        out = []
        bins = math.ceil(2 * self.sweep.radius_mm / self.dx_mm) + 2
        at_s = np.arange(bins) * (1e-3 * self.dx_mm / speed)
        for (way, look), trace in zip(self.each(speed), self.source, strict=True):
            first = np.floor(way / self.dx_mm).astype(np.int64)
            part = way / self.dx_mm - first
            rest = total - look
            sounds = np.bincount(first, rest * (1 - part), bins).astype(np.float64)
            sounds += np.bincount(first + 1, rest * part, bins)
            heard = np.interp(at_s, self.sweep.times_s, trace, left=0.0, right=0.0)
            out.append(correlation(sounds, np.where(np.bincount(first, minlength=bins) > 0, heard, 0.0)))
        return np.array(out)


class _Halves:
    """The circle in octants, four of which are a half."""

    def __init__(self, looks: _Looks) -> None:
        self._looks = looks
        self._octant = (np.mod(looks.sweep.angles_deg, 360.0) // 45.0).astype(np.int64) % 8

    def agreement(self, speed_m_s: float) -> float:
        octants = np.zeros((8, len(self._looks.x_mm)))
        for octant, (_, look) in zip(self._octant, self._looks.each(speed_m_s), strict=True):
            octants[octant] += look
        around = [np.roll(octants, k, axis=0) for k in range(4)]
        return float(np.mean([correlation(one[:4].sum(axis=0), one[4:].sum(axis=0)) for one in around]))


def correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Of two signals about zero; 0 where either is silent."""
    return float(a @ b / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300))


def _weighted(sweep: Sweep, arrival: Arrival, dx_mm: float) -> Sweep:
    """Each frequency's weight that of a derivative, up to what pixels of dx carry; the tail of a plane taken back."""
    samples = 2 * sweep.signals.shape[1]
    frequency = fft.rfftfreq(samples, 1 / sweep.sampling_rate_hz)
    limit = sweep.sound_speed_m_s / (4e-3 * dx_mm)
    shape = frequency / limit * np.exp(1j * LAG_RAD[arrival] - SMOOTHED * (frequency / limit) ** 2)
    signals = fft.irfft(fft.rfft(sweep.signals, samples, axis=1) * shape, samples, axis=1)
    return replace(sweep, signals=signals[:, : sweep.signals.shape[1]])
