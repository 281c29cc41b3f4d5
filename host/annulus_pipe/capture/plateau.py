"""Where a flash lights all rows alike, found from how brightly it lit them at several delays.

    proposal = find(readings, timing, delay_us=2100, width_us=500, height=1232)   # AnnulusError: why there is none

Row r of N (from 0 to 1) exposes from opens - readout * (1 - r) to closes + readout * r after the sync edge, and sees of
a flash the share that falls in between; what falls behind its end it sees in the next frame. So a flash that lies
outside cuts the picture at a row that tells where the edge of the window is, to a fraction of the step between two
delays. Nothing here believes what head.toml says of exposure and readout: it is where the search begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.numeric.late import optimize
from annulus_pipe.vocabulary import AnnulusError

Array = NDArray[np.float64]

READINGS_MIN = 6
DARK = 1.5  # of 255: an image that varies by less over all rows and delays shows no flash
SATURATED_MAX = 0.02  # of the pixels: more, and light says nothing of a share
CHANGED_MAX = 0.05  # between two readings with the same flash
MISFIT_MAX = 0.08  # of the light, root mean square: no rolling shutter looks like that
BANDING_MAX, BANDING_NOISES = 0.02, 4.0  # of the light; and as many times the band's noise
LIT = 0.1  # of the brightest band: darker ones say nothing of evenness
MARGIN_US = 50.0  # from either edge, at least
SURE_US = 500.0  # an edge known no better was not seen
ROWS_A_BAND = 8
SHIFTS_US = np.arange(-6000.0, 6001.0, 1000.0)
READOUTS = (0.7, 0.85, 1.0, 1.15, 1.3)


@dataclass(frozen=True, slots=True)
class Reading:
    """What one flash did to the picture."""

    delay_us: float
    width_us: float
    light: Array  # (B,) mean light of equal bands of rows, 0..255, first row first
    saturated: float = 0.0  # part of the pixels
    follows_itself: bool = True  # the frame before had the same lamp, whose late light may be in this one


@dataclass(frozen=True, slots=True)
class Proposal:
    """A flash that all rows see whole, and the window it was found in. Microseconds after the sync edge."""

    delay_us: float
    width_us: float
    opens_us: float
    closes_us: float
    opens_k2_us: float | None  # None: that edge was not seen, it is as head.toml says
    closes_k2_us: float | None
    readout_us: float | None  # as measured, where an edge was seen
    widest_us: float
    predicted_us: tuple[float, float]
    why: str
    full: Array = field(repr=False, compare=False)  # (B,) light of a flash that is seen whole, without black
    black: float  # 0..255
    noise: Array = field(repr=False, compare=False)  # (B,) of the readings' light, relative to `full`
    banding: float | None = None  # of the proposed flash, once it was tried: largest deviation of a band from `full`
    light: float | None = None  # its mean, 0..255
    saturated: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain types, without the bands."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__ if name not in ("full", "noise")}


def shares(
    readings: Sequence[Reading], opens: float, closes: float, readout: float, period: float, height: int
) -> Array:
    """(readings, bands) part of each flash that a band's rows saw, 0..1, of a picture of `height` rows."""
    bands = len(readings[0].light)
    first = np.linspace(0, height, bands + 1).astype(int)  # as the bands are made
    within = (np.arange(ROWS_A_BAND) + 0.5) / ROWS_A_BAND
    rows = (first[:-1, None] + np.diff(first)[:, None] * within - 0.5).ravel() / max(height - 1, 1)
    begins, ends = opens - readout * (1 - rows), closes + readout * rows
    delay = np.array([one.delay_us for one in readings])[:, None]
    width = np.array([one.width_us for one in readings])[:, None]
    own = np.array([one.follows_itself for one in readings])[:, None]

    def seen(at: Array) -> Array:
        return np.asarray(np.clip(np.minimum(at + width, ends) - np.maximum(at, begins), 0.0, None) / width)

    share = seen(delay) + np.where(own, seen(delay - period), 0.0)
    return np.asarray(share.reshape(len(readings), bands, ROWS_A_BAND).mean(axis=2))


def find(readings: Sequence[Reading], timing: FrameTiming, delay_us: float, width_us: float, height: int) -> Proposal:
    """delay_us, width_us : of the flash in force, which is proposed again where it fits. height : of the picture, in
    rows. Raises AnnulusError with why there is nothing to propose.
    """
    if len(readings) < READINGS_MIN:
        raise AnnulusError(f"tune: {len(readings)} readings, expected at least {READINGS_MIN}")
    light = np.array([one.light for one in readings], dtype=np.float64)
    if not np.isfinite(light).all():
        raise AnnulusError("tune: the light of some rows is no number")
    if np.ptp(light) < DARK:
        raise AnnulusError(
            f"tune: dark whatever the delay, {light.mean():.1f} of 255 everywhere: is the lamp connected, is it aimed?"
        )
    if min(one.saturated for one in readings) > SATURATED_MAX:
        raise AnnulusError(
            f"tune: saturated, at best {100 * min(one.saturated for one in readings):.0f} % of the pixels: "
            "shorten the flash"
        )
    _same(readings)
    fit = _PlateauFit(readings, light, timing, height)
    if fit.misfit > MISFIT_MAX:
        raise AnnulusError(
            f"tune: the light does not follow the delay as in a rolling shutter ({100 * fit.misfit:.0f} % besides):"
            " does anything move, or does other light come in?"
        )
    opens, opens_k2 = fit.opens
    closes, closes_k2 = fit.closes
    tight = opens + _margin(opens_k2), closes - _margin(closes_k2)
    widest = tight[1] - tight[0]
    if widest <= 0.0:
        raise AnnulusError(
            f"tune: no delay lights all rows alike: the last opens at {opens:.0f} us, the first closes "
            f"at {closes:.0f} us. Expose longer"
        )
    wide = min(width_us, np.floor(widest))
    delay = float(np.clip(delay_us, np.ceil(tight[0]), max(np.ceil(tight[0]), np.floor(tight[1] - wide))))
    seen_us = f"all rows see {opens:.0f}..{closes:.0f} us"
    configured = f"head.toml says {timing.opens_us:.0f}..{timing.closes_us:.0f} us"
    kept = delay == delay_us and wide == width_us
    return Proposal(
        delay,
        float(wide),
        opens,
        closes,
        opens_k2,
        closes_k2,
        fit.readout if opens_k2 is not None or closes_k2 is not None else None,
        widest,
        (timing.opens_us, timing.closes_us),
        f"{seen_us}, {configured}: "
        + (
            "the flash in force fits"
            if kept
            else "the flash in force does not fit"
            if wide == width_us
            else f"no flash longer than {widest:.0f} us fits"
        ),
        fit.full,
        fit.black,
        fit.noise,
    )


def confirmed(proposal: Proposal, tried: Reading) -> Proposal:
    """With what the proposed flash did when it was tried. Raises AnnulusError when it bands, or saturates."""
    off = deviations(tried.light - proposal.black, proposal.full)
    uneven = float(off.max())
    if (off > BANDING_MAX + BANDING_NOISES * proposal.noise).any():
        raise AnnulusError(
            f"tune: tried, the flash at {proposal.delay_us:.0f} us leaves bands of {100 * uneven:.1f} %: "
            "is the head at rest?"
        )
    if tried.saturated > SATURATED_MAX:
        raise AnnulusError(f"tune: saturated, {100 * tried.saturated:.0f} % of the pixels: shorten the flash")
    return replace(proposal, banding=uneven, light=float(tried.light.mean()), saturated=tried.saturated)


def deviations(light: Array, reference: Array) -> Array:
    """(B,) of bands from the reference, both without black, beyond what all have in common; of dark ones 0."""
    lit = reference > LIT * reference.max()
    ratio = light / np.maximum(reference, 1e-6)
    return np.asarray(np.where(lit, np.abs(ratio / max(float(np.median(ratio[lit])), 1e-6) - 1.0), 0.0))


def _margin(k2_us: float | None) -> float:
    return MARGIN_US if k2_us is None else max(MARGIN_US, k2_us)


def _same(readings: Sequence[Reading]) -> None:
    for n, one in enumerate(readings):
        for other in readings[:n]:
            if (other.delay_us, other.width_us) == (one.delay_us, one.width_us):
                before, after = other.light.mean(), one.light.mean()
                if abs(after - before) > CHANGED_MAX * max(before, after, DARK):
                    raise AnnulusError(
                        f"tune: the scene changed while it was measured: {before:.1f}, then {after:.1f} of 255 "
                        "with the same flash. Hold the head still"
                    )


class _PlateauFit:
    """opens, closes and readout that explain the readings best; light of a whole flash and black besides."""

    def __init__(self, readings: Sequence[Reading], light: Array, timing: FrameTiming, height: int) -> None:
        self._readings, self._period, self._height, self._timing = readings, timing.period_us, height, timing
        width = np.array([one.width_us for one in readings])[:, None]
        self._relative = width / width.max()  # light grows with the width
        self._light = light
        brightest = light.max(axis=0)
        self._weight = 1.0 / (brightest + LIT * brightest.max())
        begin = self._begin(timing)
        low = [-0.5 * self._period, 0.0, 0.0, 0.0]
        high = [self._period, 1.5 * self._period, self._period, float(light.min()) + 1.0]
        found = optimize.least_squares(
            lambda x: self._residual(x).ravel(),
            np.clip(begin, np.add(low, 1e-6), np.subtract(high, 1e-6)),
            bounds=(low, high),
            x_scale=[100.0, 100.0, 1000.0, 1.0],
            diff_step=1e-5,
            loss="soft_l1",
            f_scale=0.02,
        )
        self._x = found.x
        residual = self._residual(found.x)
        self.misfit = float(np.sqrt(np.mean(residual**2)))
        self.black, self.readout = float(found.x[3]), float(found.x[2])
        self.full = self._full(self._share(found.x), self.black)
        spread = np.sqrt(np.mean((residual / self._weight) ** 2, axis=0))
        self.noise = np.asarray(spread / np.maximum(np.abs(self.full), 1e-6))
        self._sigma = self._uncertainty(residual)

    @property
    def opens(self) -> tuple[float, float | None]:
        """With k = 2; None where no lit row was cut: then head.toml is believed, as far as flashes were tried."""
        if self._sigma[0] * 2 < SURE_US:
            return max(float(self._x[0]), 0.0), max(2 * float(self._sigma[0]), 1.0)
        return max(self._timing.opens_us, min(one.delay_us for one in self._readings)), None

    @property
    def closes(self) -> tuple[float, float | None]:
        if self._sigma[1] * 2 < SURE_US:
            return float(self._x[1]), max(2 * float(self._sigma[1]), 1.0)
        return min(self._timing.closes_us, max(one.delay_us + one.width_us for one in self._readings)), None

    def _full(self, share: Array, black: float) -> Array:
        weight = (share**2).sum(axis=0)
        return np.asarray(((self._light - black) * share).sum(axis=0) / np.maximum(weight, 1e-9))

    def _share(self, x: Array) -> Array:
        opens, closes, readout = (float(one) for one in x[:3])
        share = shares(self._readings, opens, closes, readout, self._period, self._height)
        return np.asarray(share * self._relative)

    def _residual(self, x: Array) -> Array:
        share = self._share(x)
        return np.asarray((self._light - x[3] - self._full(share, float(x[3])) * share) * self._weight)

    def _begin(self, timing: FrameTiming) -> Array:
        black = max(float(self._light.min()) - 0.5, 0.0)
        best, at = np.inf, np.zeros(4)
        for readout in READOUTS:
            for opens in SHIFTS_US + timing.opens_us:
                for closes in SHIFTS_US + timing.closes_us:
                    x = np.array([opens, closes, readout * timing.readout_us, black])
                    cost = float(np.abs(self._residual(x)).sum())
                    if cost < best:
                        best, at = cost, x
        return at

    def _uncertainty(self, residual: Array) -> Array:
        """(4,) standard deviations; infinite for what the readings do not say."""
        columns = []
        for n, step in enumerate((20.0, 20.0, 100.0, 0.05)):
            up, down = self._x.copy(), self._x.copy()
            up[n] += step
            down[n] -= step
            columns.append((self._residual(up) - self._residual(down)).ravel() / (2 * step))
        jacobian = np.array(columns).T
        scale = np.array([100.0, 100.0, 1000.0, 1.0])
        normal = (jacobian * scale).T @ (jacobian * scale)
        free = max(residual.size - residual.shape[1] - 4, 1)
        variance = float((residual**2).sum()) / free
        value, vector = np.linalg.eigh(normal)
        safe = np.maximum(value, 1e-12 * max(value.max(), 1e-12))
        sigma = np.sqrt(np.einsum("ij,j,ij->i", vector, 1.0 / safe, vector) * max(variance, 1e-8))
        return np.asarray(sigma * scale)
