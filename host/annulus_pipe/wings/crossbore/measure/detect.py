"""Where a pipe was drilled through a sewer, by three capacitive sectors along the pipe; what else it may be, by name.

Round a buried pipe is soil. Where it passes through a sewer's air every sector that looks there falls to what it reads
in air, and the mean of the three, which lift-off and roll hardly touch, falls with them for a stretch as long as the
sewer is wide. Not so: stones and voids are too short, near misses do not show, and a coupling is more plastic all
round, which takes off about as much in any soil, over one length, from all sectors alike. Water reads like moist soil:
it stands out in dry soil only, or by its loss where the log has it. Where neither can tell it the account says so.

Direction: the sewer's wall leaves a part of the pipe's circumference in air, phi +- beta, and a sector reads by how
much of its own width that covers. Three readings give both, and how well.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import ndimage, signal
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.wings.crossbore.measure.grid import NARROW_MM, STEP_MM, PipeGrid
from annulus_pipe.wings.crossbore.measure.odds import MIDDLE, odds
from annulus_pipe.wings.crossbore.measure.readings import HEAD, SECTORS, CapacitiveHead, Gap

UP_DEG = 270.0  # the obvert; angles run from the right over the invert, 90
SMOOTH_MM = 15.0
LOSS_SMOOTH_MM = 30.0
BESIDE_MM = (225.0, 600.0)  # from a peak to what is beside any sewer, soil only
BESIDE_LEAST = 10  # places: with fewer on one side nothing is judged
ENDS_MM = BESIDE_MM[0] + BESIDE_LEAST * STEP_MM  # so the first and last of a log are not
CLOSE_MM = (50.0, 200.0)  # beyond where it is half over: closer, where its own length is known
UNEVEN_MM = 3000.0  # to either side: soil whose unevenness counts
UNEVEN_FF = (3.0, 8.0)  # of one sector against the others, pose known and not: logs a2, a1
LOSS_UNEVEN_FF = 1.0  # the same of its loss, smoothed
BLURRED = 4.0  # standard deviations of that, of a head that wanders, are no side
SHAPE = 0.04  # of what air takes off: what the model of a sector's width leaves
BEAD_FF = 25.0  # a bead of plastic inside stands so far over all three sectors
MERGED_MM = 150.0
SLANT_MM = 12.0  # of a 3-inch pipe that crosses sewers at 58 to 90 degrees, rms
LEAST_SECTOR_FF = 25.0  # a sector that falls by less does not say where
EDGE_MM = 80.0  # of a dip, over which its middle moves by as much as unevenness is of its depth
NEAR_UP_DEG = 40.0  # air that lies so may be above water that nothing told
JOINT_MM = 60.0  # of a joint's place, half a coupling: sectors and rings are not at one place along the head
CLOSE = round(CLOSE_MM[1] / STEP_MM)
DRY = 0.75  # of the deepest: in soil that reads less than that over air, water stands out
PART_UP_DEG = 15.0  # a level of water is horizontal: air within so much of straight up
PART_BETA_DEG = (70.0, 110.0)
PART_WET = 0.12  # of soil to air: a sector that rises by so much beside one that falls sees water
PART_LOSS = 0.3  # of what soil loses: a sector that sees no air and loses so much less sees water


class BoreKind(StrEnum):
    AIR = "air"
    PART = "part"  # half full of water
    WATER = "water"
    COUPLING = "coupling"
    VOID = "void"  # a stone's hollow or loose backfill: too short for a sewer
    BEAD = "bead"
    UNKNOWN = "unknown"  # something is there, and nothing here says what


BORES = (BoreKind.AIR, BoreKind.PART, BoreKind.WATER)


@dataclass(frozen=True, slots=True)
class BoreLimits:
    """What is listed: lengths at half the change, mm; changes of the sectors' mean, fF, or as a part of soil to air."""

    least_ff: float = 8.0
    bore_mm: tuple[float, float] = (108.0, 600.0)
    bore_part: float = 0.22  # of the strongest sector
    short_mm: float = 75.0  # a narrow sewer, right through: no hollow beside the wall takes so much off
    short_part: float = 0.45
    water_mm: tuple[float, float] = (75.0, 400.0)
    water_sigma: float = 7.0  # of the soil's own unevenness
    loss_ff: float = 3.0
    even: float = 0.2  # of the mean: sectors that differ by less are alike all round
    all_air: float = 0.58  # of soil to air, where it is alike all round
    coupling_part: tuple[float, float] = (0.12, 0.3)  # of what it takes off: where air would do as well; where not
    coupling_off_mm: float = 20.0


LIMITS = BoreLimits()


@dataclass(frozen=True, slots=True, eq=False)
class BoreIndication:
    """One place. phi_deg is NaN where it is alike all round or not told; change_ff (3,) over what is beside it.

    speed_mm_s : of a coupling, by its known length and how long it took to pass, and by the odometer meanwhile. The
    first is known to a quarter: where they differ by more the odometer slips, or it is another coupling.
    arc_deg : how much of the circumference it has, about phi. odds : of what it may be, see `crossbore.odds`.
    """

    odometer_mm: float
    kind: BoreKind
    extent_mm: float
    phi_deg: float
    phi_sigma_deg: float
    change_ff: FloatArray = field(repr=False)
    part: float = math.nan  # of soil to air, the strongest sector
    loss_ff: float = math.nan
    arc_deg: float = 360.0
    odds: Mapping[str, float] = field(default_factory=dict)
    speed_mm_s: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True, slots=True, eq=False)
class BoreDetections:
    """What was found, in order; how much of the log was seen; where water could have been told, mm of all.

    ends_mm : of either end, where nothing is judged, for want of what lies beyond. wanders : the head stood off the
    axis by millimetres, nobody knows where, so that nothing but what is alike all round is called a bore.
    """

    indications: list[BoreIndication]
    length_mm: float
    unseen_mm: float
    water_told_mm: float
    ends_mm: float = ENDS_MM
    wanders: bool = False
    gaps: tuple[Gap, ...] = ()

    @property
    def bores(self) -> list[BoreIndication]:
        return [one for one in self.indications if one.kind in BORES]


@dataclass(frozen=True, slots=True)
class _Peak:
    """A peak of the sectors' mean: where, how far over what is beside it, how long at half of that, uneven beside."""

    index: int
    depth: float
    low: int
    high: int
    sigma: float
    left: float
    right: float

    @property
    def middle(self) -> int:
        return (self.low + self.high) // 2

    @property
    def extent_mm(self) -> float:
        return (self.high - self.low) * STEP_MM


def likely(one: BoreIndication) -> float:
    """Probability of what it is called, 0..1; for what is no bore, that no sewer is there. NaN where nobody counted."""
    return one.odds.get(str(one.kind) if one.kind in BORES else "soil", math.nan)


def detect(
    grid: PipeGrid, head: CapacitiveHead = HEAD, limits: BoreLimits = LIMITS, joints_mm: Sequence[float] = ()
) -> BoreDetections:
    """What lies along a log. Nothing is said of stretches that were not seen.

    joints_mm : along the same odometer, where something else has seen a joint of the pipe: what is alike all round and
    no longer than a coupling is one there, whatever it takes off.
    """
    mean = ndimage.gaussian_filter1d(grid.c_ff.mean(axis=1), SMOOTH_MM / STEP_MM)
    dips = [(one, _dip(grid, one, head, limits)) for one in _places(mean, -1, limits.least_ff)]
    found = [
        indication for one, indication in dips if indication.kind is not BoreKind.UNKNOWN or _stands_out(one, limits)
    ]
    found += [_rise(grid, one, head, limits) for one in _places(mean, 1, limits.least_ff) if _stands_out(one, limits)]
    if grid.loss_ff is not None:
        loss = ndimage.gaussian_filter1d(grid.loss_ff.mean(axis=1), LOSS_SMOOTH_MM / STEP_MM)
        found += [
            _by_loss(grid, one, head, limits) for one in _places(loss, -1, limits.loss_ff) if _stands_out(one, limits)
        ]
        decidable_mm = float(STEP_MM * np.count_nonzero(grid.seen))
    else:
        dry = ndimage.gaussian_filter1d(mean, UNEVEN_MM / STEP_MM / 3) - head.air_ff < DRY * _wet(mean, head)
        decidable_mm = float(STEP_MM * np.count_nonzero(grid.seen & dry))
    if _wanders(grid):
        found = [_all_round_or_unknown(one) for one in found]
    found = [_weak_air_is_part(_explained(one, joints_mm, head, limits)) for one in found]
    found = [_unknown(one) if _cut(grid, one) else one for one in found]
    found += _beads(grid)
    kept = [one for one in found if grid.seen[int(np.argmin(np.abs(grid.z_mm - one.odometer_mm)))]]
    kept = [replace(one, speed_mm_s=_speed(grid, one, head)) if one.kind is BoreKind.COUPLING else one for one in kept]
    listed = (
        _merged(kept)
        if _wanders(grid)
        else [
            replace(one, odds=odds(str(one.kind), one.part, math.isfinite(one.phi_deg), one.loss_ff))
            for one in _merged(kept)
        ]
    )
    unseen = float(STEP_MM * np.count_nonzero(~grid.seen))
    return BoreDetections(
        listed, float(np.ptp(grid.z_mm)), unseen, decidable_mm, wanders=_wanders(grid), gaps=grid.gaps
    )


def _all_round_or_unknown(one: BoreIndication) -> BoreIndication:
    """What a log says whose head wandered, nobody knows where: it lifts off one side, and a little off the mean."""
    sure = one.kind not in BORES or math.isfinite(one.loss_ff) or (one.kind is BoreKind.AIR and math.isnan(one.phi_deg))
    return one if sure else _unknown(one)


def _unknown(one: BoreIndication) -> BoreIndication:
    return replace(one, kind=BoreKind.UNKNOWN, phi_deg=math.nan, phi_sigma_deg=math.nan, arc_deg=360.0)


def _weak_air_is_part(one: BoreIndication) -> BoreIndication:
    """Air on one side that takes off less than MIDDLE of what air does lies over water: so were 12 of 12 in the pipes
    of both drawers (`crossbore.odds`). The air is above it then, and says no direction."""
    weak = one.kind is BoreKind.AIR and math.isfinite(one.phi_deg) and one.part < MIDDLE
    return replace(one, kind=BoreKind.PART, phi_deg=math.nan, phi_sigma_deg=math.nan, arc_deg=360.0) if weak else one


def _cut(grid: PipeGrid, one: BoreIndication) -> bool:
    """Whether a part of a place, or of the stretches that show its edges, was not seen: its length and change are
    then unknown."""
    return not grid.seen[np.abs(grid.z_mm - one.odometer_mm) <= 0.5 * one.extent_mm + NARROW_MM].all()


def _explained(
    one: BoreIndication, joints_mm: Sequence[float], head: CapacitiveHead, limits: BoreLimits
) -> BoreIndication:
    """Whether the place is a joint that the ring sensor saw there."""
    at_joint = any(abs(joint - one.odometer_mm) < JOINT_MM for joint in joints_mm)
    short = one.extent_mm < head.coupling_mm + 2 * limits.coupling_off_mm
    mean = max(abs(float(one.change_ff.mean())), 1e-9)
    even = float(np.ptp(one.change_ff)) < 3 * 1.5 * limits.even * mean
    if at_joint and short and even and one.kind in (BoreKind.AIR, BoreKind.VOID, BoreKind.UNKNOWN):
        return replace(one, kind=BoreKind.COUPLING, phi_deg=math.nan, phi_sigma_deg=math.nan, arc_deg=360.0)
    return one


def _speed(grid: PipeGrid, one: BoreIndication, head: CapacitiveHead) -> tuple[float, float]:
    """The head's speed by a coupling's transient, and by the odometer; NaN where it stood or turned back there."""
    here = np.abs(grid.z_mm - one.odometer_mm) <= max(0.5 * one.extent_mm, STEP_MM)
    by_odometer = np.abs(grid.speed_mm_s[here])
    if by_odometer.min() < 1.0 or np.ptp(np.sign(grid.speed_mm_s[here])) > 0:
        return math.nan, math.nan
    transit_s = one.extent_mm / len(by_odometer) * float(np.sum(1 / by_odometer))
    return head.coupling_mm / transit_s, one.extent_mm / transit_s


def _wet(mean: FloatArray, head: CapacitiveHead) -> float:
    return float(np.percentile(mean, 98)) - head.air_ff


def _stands_out(place: _Peak, limits: BoreLimits) -> bool:
    """Whether a place differs from its surroundings by more than soil does, and is no boundary between two soils."""
    return place.depth > limits.water_sigma * place.sigma and abs(place.left - place.right) < 0.5 * place.depth


def _places(line: FloatArray, sign: int, least: float) -> list[_Peak]:
    near, far = (round(v / STEP_MM) for v in BESIDE_MM)
    peaks, _ = signal.find_peaks(sign * line, prominence=least, wlen=2 * far)
    quick = line - ndimage.gaussian_filter1d(line, 300.0 / STEP_MM, mode="nearest")
    found = []
    for i in peaks:
        wider = _medians(line, i - near, i + near, far - near)
        if not math.isfinite(sum(wider)):
            continue
        low, high = _half(line, int(i), sign, *wider)
        left, right = _medians(line, low - round(CLOSE_MM[0] / STEP_MM), high + round(CLOSE_MM[0] / STEP_MM), CLOSE)
        if not math.isfinite(left + right):
            continue
        low, high = _half(line, int(i), sign, left, right)
        depth = sign * float(line[i]) - max(sign * left, sign * right)
        # Between two other things a place stands out from them alone.
        if depth < least or sign * float(line[i]) - max(sign * one for one in wider) < 0.5 * depth:
            continue
        wide = round(UNEVEN_MM / STEP_MM)
        around = np.r_[quick[max(i - wide, 0) : max(i - far, 0)], quick[i + far : i + wide]]
        sigma = robust_sigma(around) if len(around) > near else math.inf
        found.append(_Peak(int(i), depth, low, high, sigma, left, right))
    return found


def _medians(line: FloatArray, before: int, after: int, count: int) -> tuple[float, float]:
    """Of `count` values before and after; NaN where the log ends."""
    left, right = line[max(before - count, 0) : max(before, 0)], line[after : after + count]
    if min(len(left), len(right)) < BESIDE_LEAST:
        return math.nan, math.nan
    return float(np.median(left)), float(np.median(right))


def _half(line: FloatArray, peak: int, sign: int, left: float, right: float) -> tuple[int, int]:
    """First and last place that stands out by half or more of what the peak does."""
    beside = sign * max(sign * left, sign * right)
    half = beside + 0.5 * (float(line[peak]) - beside)
    low = high = peak
    while low > 0 and sign * (line[low] - half) > 0:
        low -= 1
    while high < len(line) - 1 and sign * (line[high] - half) > 0:
        high += 1
    return low, high


def _change(values: FloatArray, place: _Peak) -> FloatArray:
    """(3,) in the middle of a place over what is beside it."""
    near = round(CLOSE_MM[0] / STEP_MM)
    left = values[max(place.low - near - CLOSE, 0) : max(place.low - near, 1)]
    right = values[place.high + near : place.high + near + CLOSE]
    here = values[max(place.middle - 2, 0) : place.middle + 3].mean(axis=0)
    return np.asarray(here - 0.5 * (np.median(left, axis=0) + np.median(right, axis=0)))


def _dip(grid: PipeGrid, place: _Peak, head: CapacitiveHead, limits: BoreLimits) -> BoreIndication:
    change = _change(grid.c_ff, place)
    soil = 0.5 * (place.left + place.right) - head.air_ff
    z, extent = float(grid.z_mm[place.middle]), place.extent_mm
    uneven = float(np.ptp(change)) / max(3.0 * abs(float(change.mean())), 1e-9)
    share = -change / max(soil, 1.0)
    strongest = float(share.max())
    # At a boundary between soils half of the lower change is sooner reached: a place looks shorter.
    short = limits.coupling_off_mm * (2.0 if abs(place.left - place.right) > 0.1 * place.depth else 1.0)
    near = -short < extent - head.coupling_mm < limits.coupling_off_mm
    off = abs(-float(change.mean()) - head.coupling_ff) / head.coupling_ff
    all_air = float(share.mean()) > limits.all_air
    # A coupling is alike all round, but for lift-off where that is not known. A sewer's air reads as air, and only in
    # dry soil is that as much as a coupling takes off.
    even = limits.even * (1.0 if grid.lift_ff_mm is not None else 1.5)
    # What a head that wanders adds to one side says nothing of a side.
    blurred = _wanders(grid) and float(np.ptp(change)) < BLURRED * grid.uneven_ff
    if near and (uneven < even or blurred) and off < limits.coupling_part[0 if all_air else 1]:
        return BoreIndication(z, BoreKind.COUPLING, extent, math.nan, math.nan, change, strongest)
    if (extent >= limits.bore_mm[0] and uneven < limits.even) or blurred:
        kind = BoreKind.AIR if all_air else BoreKind.UNKNOWN
        return BoreIndication(z, kind, extent, math.nan, math.nan, change, strongest)
    phi, sigma, beta = _direction(share, grid.looks_deg(place.middle), head, _lift_off(grid) / max(soil, 1.0))
    long = limits.bore_mm[0] <= extent <= limits.bore_mm[1] and strongest >= limits.bore_part
    if strongest < limits.short_part and abs(place.left - place.right) > 0.5 * place.depth:
        long = False  # beside something that stands out the other way
    if not long and not (limits.short_mm <= extent < limits.bore_mm[0] and strongest >= limits.short_part):
        kind = BoreKind.VOID if extent < limits.bore_mm[0] else BoreKind.UNKNOWN
        return BoreIndication(z, kind, extent, phi, sigma, change, strongest)
    if _half_full(grid, place, share, phi, beta):  # its air is above, wherever the sewer lies
        z = _level_middle(grid, place, head)
        return BoreIndication(z, BoreKind.PART, extent, math.nan, math.nan, change, strongest)
    if abs((phi - UP_DEG + 180) % 360 - 180) < NEAR_UP_DEG:
        z = _level_middle(grid, place, head)
    return BoreIndication(z, BoreKind.AIR, extent, phi, sigma, change, strongest, arc_deg=_arc(phi, beta))


def _arc(phi: float, beta: float) -> float:
    return min(2 * beta, 360.0) if math.isfinite(phi) else 360.0


def _level_middle(grid: PipeGrid, place: _Peak, head: CapacitiveHead) -> float:
    """Where a sewer half full is crossed, mm. One that is crossed at a slant meets the pipe's upper side, where its air
    is, before or behind its middle: by A cos + B sin of the direction, R cot(angle) at most. Each sector's own dip lies
    where the air it sees is; two unknowns beside the middle, and what sewers are crossed at (SLANT_MM) where sectors do
    not tell them.
    """
    rows, places, weights = [], [], []
    for k, look in enumerate(grid.looks_deg(place.middle)):
        line = ndimage.gaussian_filter1d(grid.c_ff[:, k], SMOOTH_MM / STEP_MM)
        seen = np.radians(look + np.linspace(-0.5, 0.5, 56) * head.sector_deg)
        above = seen[np.sin(seen) < 0]
        near = round(CLOSE_MM[0] / STEP_MM)
        left, right = _medians(line, place.low - near, place.high + near, CLOSE)
        peak = place.low + int(np.argmin(line[place.low : place.high + 1]))
        depth = max(left, right) - float(line[peak])
        if not len(above) or not depth > LEAST_SECTOR_FF:
            continue
        low, high = _half(line, peak, -1, left, right)
        rows.append((1.0, float(np.cos(above).mean()), float(np.sin(above).mean())))
        places.append(float(np.interp(0.5 * (low + high), np.arange(len(grid.z_mm)), grid.z_mm)))
        weights.append(1.0 / (2.0 + EDGE_MM * _lift_off(grid) / depth))
    if not rows:
        return float(grid.z_mm[place.middle])
    terms = np.array(rows) * np.array(weights)[:, None]
    prior = np.array([[0.0, 1 / SLANT_MM, 0.0], [0.0, 0.0, 1 / SLANT_MM]])
    fit, *_ = np.linalg.lstsq(np.vstack([terms, prior]), np.r_[np.array(places) * weights, 0.0, 0.0], rcond=None)
    return float(fit[0])


def _half_full(grid: PipeGrid, place: _Peak, share: FloatArray, phi: float, beta: float) -> bool:
    """Air above and water below: a level at the pipe's height, told by its being level or by the water itself."""
    if share.min() < -PART_WET:
        return True
    if grid.loss_ff is not None:
        loss = _change(ndimage.gaussian_filter1d(grid.loss_ff, LOSS_SMOOTH_MM / STEP_MM, axis=0), place)
        soil = float(np.median(grid.loss_ff[max(place.low - 2 * CLOSE, 0) : place.high + 2 * CLOSE]))
        dry = share < 0.2
        return bool(dry.any() and (-loss[dry]).max() > max(PART_LOSS * soil, 4.0))
    level = math.isfinite(phi) and abs((phi - UP_DEG + 180) % 360 - 180) < PART_UP_DEG
    return bool(level and PART_BETA_DEG[0] <= beta <= PART_BETA_DEG[1] and share.max() > 0.85)


def _rise(grid: PipeGrid, place: _Peak, head: CapacitiveHead, limits: BoreLimits) -> BoreIndication:
    change = _change(grid.c_ff, place)
    z, extent = float(grid.z_mm[place.middle]), place.extent_mm
    water = limits.water_mm[0] <= extent <= limits.water_mm[1]
    share = change / max(float(change.max()), 1e-9)
    noise = _lift_off(grid) / max(float(change.max()), 1.0)
    phi, sigma, beta = _direction(share, grid.looks_deg(place.middle), head, noise)
    kind = BoreKind.WATER if water else BoreKind.UNKNOWN
    return BoreIndication(z, kind, extent, phi, sigma, change, arc_deg=_arc(phi, beta))


def _by_loss(grid: PipeGrid, place: _Peak, head: CapacitiveHead, limits: BoreLimits) -> BoreIndication:
    assert grid.loss_ff is not None
    change = _change(grid.c_ff, place)
    loss = _change(ndimage.gaussian_filter1d(grid.loss_ff, LOSS_SMOOTH_MM / STEP_MM, axis=0), place)
    most = max(float((-loss).max()), 1e-9)
    phi, sigma, beta = _direction(-loss / most, grid.looks_deg(place.middle), head, LOSS_UNEVEN_FF / most)
    water = limits.water_mm[0] <= place.extent_mm <= limits.water_mm[1]
    kind = BoreKind.WATER if water else BoreKind.UNKNOWN
    z = float(grid.z_mm[place.middle])
    return BoreIndication(
        z, kind, place.extent_mm, phi, sigma, change, loss_ff=float(loss.mean()), arc_deg=_arc(phi, beta)
    )


def _beads(grid: PipeGrid) -> list[BoreIndication]:
    """Rings of plastic inside: over all sectors, shorter than anything outside can show."""
    ring = grid.raised.min(axis=1)
    peaks, _ = signal.find_peaks(ring, height=BEAD_FF, distance=round(MERGED_MM / STEP_MM))
    return [
        BoreIndication(float(grid.z_mm[i]), BoreKind.BEAD, STEP_MM * 2, math.nan, math.nan, grid.raised[i].copy())
        for i in peaks
    ]


def _wanders(grid: PipeGrid) -> bool:
    """Whether the head moves about more than any log that was judged with a truth beside it; nobody counted odds so."""
    return grid.uneven_ff > 2 * UNEVEN_FF[1]


def _lift_off(grid: PipeGrid) -> float:
    """FF by which the head's place and the soil's unevenness may change one sector against the others."""
    return max(UNEVEN_FF[0] if grid.lift_ff_mm is not None else UNEVEN_FF[1], grid.uneven_ff)


def _direction(
    share: FloatArray, looks_deg: FloatArray, head: CapacitiveHead, noise: float
) -> tuple[float, float, float]:
    """(phi, its sigma, beta), degrees: NaN where it is alike all round. share, noise : of what air takes off.

    A sector's reading is the part of its width that phi +- beta covers, all times how far from the wall the soil is.
    """
    phi = np.arange(0.0, 360.0, 2.0)
    beta = np.arange(10.0, 181.0, 5.0)
    off = (looks_deg[:, None] - phi + 180) % 360 - 180  # (3, F)
    half = 0.5 * head.sector_deg
    covered = np.zeros((SECTORS, len(phi), len(beta)))
    for turn in (-360.0, 0.0, 360.0):
        low = np.maximum(off[:, :, None] + turn - half, -beta)
        high = np.minimum(off[:, :, None] + turn + half, beta)
        covered += np.clip(high - low, 0, None)
    covered = np.clip(covered / head.sector_deg, 0, 1)
    size = np.clip(np.einsum("kfb,k->fb", covered, share) / np.maximum(np.sum(covered**2, axis=0), 1e-9), 0.05, 1.05)
    chi = np.sum((share[:, None, None] - size * covered) ** 2, axis=0) / math.hypot(SHAPE, noise) ** 2
    odds = np.exp(-0.5 * (chi - chi.min()))
    by_phi = odds.sum(axis=1)
    mean = complex(np.sum(by_phi * np.exp(1j * np.radians(phi))) / by_phi.sum())
    length = min(abs(mean), 1.0)
    best_beta = float(np.sum(odds * beta) / odds.sum())
    if length < 0.5:
        return math.nan, math.nan, best_beta
    return float(np.degrees(np.angle(mean)) % 360), math.degrees(math.sqrt(-2 * math.log(max(length, 1e-9)))), best_beta


def _merged(found: list[BoreIndication]) -> list[BoreIndication]:
    """One a place: what is surest of what lies together, bores and couplings before what is not known."""
    rank = {
        kind: k
        for k, kind in enumerate(
            (
                BoreKind.AIR,
                BoreKind.PART,
                BoreKind.COUPLING,
                BoreKind.VOID,
                BoreKind.WATER,
                BoreKind.BEAD,
                BoreKind.UNKNOWN,
            )
        )
    }
    kept: list[BoreIndication] = []
    for one in sorted(found, key=lambda i: (rank[i.kind], -float(np.abs(i.change_ff).max()))):
        near = [k for k in kept if abs(k.odometer_mm - one.odometer_mm) < max(MERGED_MM, k.extent_mm)]
        if not near or (one.kind is BoreKind.BEAD and all(k.kind is not BoreKind.BEAD for k in near)):
            kept.append(one)
    return sorted(kept, key=lambda i: i.odometer_mm)
