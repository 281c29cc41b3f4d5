"""How far light goes on in a wall whose radius is known: from what the rings read there, by colour.

A ring that leaves the wall m farther along is read R m / d too wide, of a projector d behind the camera: the same for
every ring, whatever its angle. So each ring's median says one m, the mean of its two stripes' colours, and the rings
together say what each colour does. Where they say little of that colours are alike (ALIKE): a diameter rests on their
mean.

What it cannot tell apart: a wall that is wider, or optics that have drifted since they were calibrated, read the same.
The first is in the sigma, by what is said of the reference; the second is not, so measure both on one day. Edges move a
little less on rings that the lens shows sharply (`translucency.edge_shift_mm`): the rings then disagree with one number
a colour, and by how much is in the sigma, too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.calibrate.sample import Sampled
from annulus_pipe.geometry.calibration import CAMERAS, Calibration
from annulus_pipe.geometry.translucency import SHIFT_MAX_MM, slit_shift_mm, wall_to_dict
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.rings.uncertainty import RING_POINTS
from annulus_pipe.storage.calibration_file import load_sections, update_calibration
from annulus_pipe.vocabulary import AnnulusError

FRAMES_LEAST = 3  # of one ring, for its median to say what it scatters by; test_one_frame_is_too_few
# of the mean shift, sigma by which a colour's may differ from it: scattering falls as the wavelength to about the first
# power, which makes red 1.2 and blue 0.85 of the mean, and pigment takes more of the blue; test_three_rings
ALIKE = 0.3
TURNS = 5  # of a fit that learns how far the rings disagree; the last two differ by less than a percent
PROBE_MM = 0.2  # that all rings are moved by, to see what that does to their radii; the answer is straight to 0.4 %
UPSTREAM = 3.0  # sigma by which light may seem to leave before it came in; beyond, it is not the wall that is off
COLOURS = ("red", "green", "blue")

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MeasuredWall:
    """shift_mm, sigma_mm : of red, green and blue edges down the pipe; of a colour that the slide lacks 0, not known.
    wider_mm : by how much radii were read too wide, in the mean of the rings; left_mm : (K,) what one number a colour
    leaves of each ring's radius."""

    shift_mm: Triple
    sigma_mm: Triple
    wider_mm: float
    left_mm: tuple[float, ...]
    frames: int

    def to_dict(self) -> dict[str, Any]:
        more = {"wider_mm": self.wider_mm, "left_mm": list(self.left_mm), "frames": self.frames}
        return {**wall_to_dict(self.shift_mm, self.sigma_mm), **more}


def measure_wall(
    frames: Sequence[Sampled], calibration: Calibration, diameter_u_mm: float, colour: ColourProfile | None = None
) -> MeasuredWall:
    """The translucency of a wall of the calibration's radius.

    diameter_u_mm : how well that radius is known of this pipe, as k = 2 of its diameter. Raises AnnulusError, one line,
    where the rings do not say it.
    """
    opaque = replace(calibration, translucency_mm=(0.0, 0.0, 0.0), translucency_sigma_mm=None)
    probe = replace(opaque, translucency_mm=(PROBE_MM, PROBE_MM, PROBE_MM))
    radii, fixed = _radii(frames, opaque, colour)
    moved, _ = _radii(frames, probe, colour)
    seen = np.isfinite(radii) & np.isfinite(moved)
    known = seen.sum(axis=0) >= FRAMES_LEAST
    if not known.any():
        raise AnnulusError(f"no ring was seen in {FRAMES_LEAST} frames or more")
    radii = np.where(seen, radii, np.nan)[:, known]
    middle = np.nanmean(radii, axis=0)
    slope = (np.nanmean(np.where(seen, moved, np.nan)[:, known], axis=0) - middle) / PROBE_MM
    shift = (opaque.pipe_radius_mm - middle) / slope
    scatter = np.nanstd(radii, axis=0, ddof=1) / np.sqrt(seen.sum(axis=0)[known])
    sigma = np.hypot(scatter, fixed[known]) / np.abs(slope)
    used = sorted({"RGB".index(letter) for letter in opaque.colours})
    shares = _shares(opaque.colours)[known][:, used]
    fitted, covariance = _by_colour(shares, shift, sigma)
    wider = np.linalg.lstsq(shares, 1.0 / slope, rcond=None)[0]  # what 1 mm of the pipe's radius does to each colour
    variance = np.diag(covariance) + (wider * diameter_u_mm / 4) ** 2  # k = 2 of a diameter is four sigma of a radius
    values, errors = np.zeros(3), np.full(3, SHIFT_MAX_MM)
    values[used], errors[used] = fitted, np.minimum(np.sqrt(variance), SHIFT_MAX_MM)
    for c in used:
        if values[c] < -UPSTREAM * errors[c] or values[c] > SHIFT_MAX_MM:
            raise AnnulusError(
                f"{COLOURS[c]} light would leave the wall {values[c]:+.2f} +- {errors[c]:.2f} mm along the pipe, "
                f"expected 0 to {SHIFT_MAX_MM:g}: its radius is not {opaque.pipe_radius_mm:g} mm, or the optics drifted"
            )
    left = (shift - shares @ fitted) * -slope
    return MeasuredWall(
        _triple(np.maximum(values, 0.0)),
        _triple(errors),
        float(np.mean(middle)) - opaque.pipe_radius_mm,
        tuple(float(v) for v in left),
        len(frames),
    )


def save_wall(wall: MeasuredWall, calibration: Path, diameter_u_mm: float) -> None:
    """Write the section `wall` into the calibration it was measured with; all other sections stay."""
    sections = load_sections(calibration)
    listed = {"cameras": sections["cameras"]} if sections.get("format") == CAMERAS else {}
    made = {"by": "annulus calibrate colour", "diameter_u_mm": diameter_u_mm, **wall.to_dict()}
    made = {key: value for key, value in made.items() if key not in ("translucency_mm", "sigma_mm")}
    update_calibration(calibration, {**listed, "wall": wall_to_dict(wall.shift_mm, wall.sigma_mm)}, {"wall": made})


def _radii(
    frames: Sequence[Sampled], calibration: Calibration, colour: ColourProfile | None
) -> tuple[FloatArray, FloatArray]:
    """(F, K) mm, the median of each ring in each frame, NaN where not seen; (K,) what no frame can show of it."""
    reconstructor = Reconstructor(calibration, colour=colour)
    radii = np.full((len(frames), len(calibration.rings)), math.nan)
    fixed = np.zeros(len(calibration.rings))
    for i, frame in enumerate(frames):
        profile = reconstructor.profile(frame.image, frame=frame.index, z_mm=0.0)  # radii alone: wherever it stood
        radius = np.hypot(profile.points_mm[:, 0], profile.points_mm[:, 1])
        for k in range(len(fixed)):
            mine = radius[profile.ring == k]
            if len(mine) >= RING_POINTS:
                radii[i, k] = np.median(mine)
        if len(profile.ring_sigma_mm):
            fixed = np.maximum(fixed, profile.ring_sigma_mm[:, 1])
    return radii, fixed


def _by_colour(shares: FloatArray, shift: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(C,) mm and their covariance, of (K,) shifts of rings that are `shares` (K, C) of them; a ring's sigma grows with
    all others' until they agree."""
    colours = shares.shape[1]
    alike = np.eye(colours) - 1.0 / colours
    fitted, excess = np.full(colours, float(np.average(shift, weights=sigma**-2.0))), 1.0
    for _ in range(TURNS):
        about = max(ALIKE * abs(float(fitted.mean())), 1e-3)
        rows = np.vstack([shares / (excess * sigma)[:, None], alike / about])
        covariance = np.linalg.inv(rows.T @ rows)
        fitted = covariance @ rows.T @ np.concatenate([shift / (excess * sigma), np.zeros(colours)])
        off = float(np.sum(((shift - shares @ fitted) / sigma) ** 2)) / max(len(shift) - 1, 1)
        excess = max(1.0, math.sqrt(off))
    return fitted, covariance


def _shares(colours: str) -> FloatArray:
    """(K, 3) what red, green and blue edges have of each slit's shift."""
    return np.stack([slit_shift_mm(unit, colours) for unit in np.eye(3)], axis=1)


def _triple(values: FloatArray) -> Triple:
    red, green, blue = (float(value) for value in values)
    return red, green, blue
