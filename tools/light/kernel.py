"""How far along a pipe light comes out of a wall that scatters, behind or ahead of where a projector sent it in.

Measured on a patch by Mitsuba's `volpath`: a half-space that scatters evenly in all directions, lit by a thin line of
light at the angle to which its surface bent it, looked at along the angle to which the surface bends what a lens sees.
Lengths are in mean free paths, so one table is for every wall; `python -m tools.light.kernel` makes it anew (minutes).
The boundary is index-matched: light that the surface throws back inside is left out, and with it a wider, fainter halo.
"""

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TABLE = Path(__file__).with_name("kernel.json")
HALF_ANGLES_DEG = (12.0, 18.0, 25.0, 33.0, 42.0)  # of rings at the projector
ALBEDOS = (0.5, 0.9, 0.99)  # of one scattering
BEHIND_OF_RADIUS = 0.75  # projector behind the camera
INDEX = 1.5
LINE, REACH, BINS = 0.12, 12.0, 241  # width of the line, how far is looked to either side: mean free paths
ROWS, SAMPLES = 16, 256
SPREAD, TEXELS = 0.08, 2000  # of the lamp's picture: radians across, and its grain


def bent(half_angle: float) -> tuple[float, float]:
    """Angles within the wall, from its normal, of the projector's light and of the camera's rays at a ring."""
    ahead = 1.0 / math.tan(half_angle)  # of the projector, in radii
    into, seen = math.atan(ahead), math.atan(ahead - BEHIND_OF_RADIUS)
    return math.asin(math.sin(into) / INDEX), math.asin(math.sin(seen) / INDEX)


def scatterings(reflectance: Array) -> Array:
    """The albedo of one scattering of half-spaces that throw back `reflectance` of diffuse light.

    With g = sqrt(1 - albedo), they throw back (1 - g) / (1 + g) of it, near enough (Hapke's two streams)."""
    kept = np.clip(reflectance, 0.01, 0.98)
    g = (1.0 - kept) / (1.0 + kept)
    return np.asarray(1.0 - g * g)


def parts(half_angle: float, reflectance: Array, scatter_mm: float) -> tuple[Array, Array]:
    """Displacements (S,) along the pipe, mm, downstream positive, and weights (S, 3) that sum to 1 for each colour.
    scatter_mm : way between two scatterings; absorption shortens the mean free path below it."""
    shifts, table = _table()
    albedo = scatterings(reflectance)
    free = albedo * scatter_mm
    grid = np.linspace(-REACH, REACH, BINS) * scatter_mm
    angles = np.radians(HALF_ANGLES_DEG)
    weights = np.empty((len(grid), 3))
    for c in range(3):
        row = _between(angles, half_angle, _across(table, float(albedo[c])))
        weights[:, c] = np.interp(grid / free[c], shifts, row, left=0.0, right=0.0)
    return grid, weights / weights.sum(axis=0)


def mean_shift(half_angle: float, reflectance: Array, scatter_mm: float) -> Array:
    """(3,) mm that the middle of what comes out lies downstream of where light came in."""
    shifts, weights = parts(half_angle, reflectance, scatter_mm)
    return np.asarray(shifts @ weights)


def _across(table: Array, albedo: float) -> Array:
    """(angles, bins) between albedos, along sqrt(1 - albedo)."""
    g = np.sqrt(1.0 - np.array(ALBEDOS))
    return _between(-g, -math.sqrt(1.0 - albedo), table)


def _between(nodes: Array, at: float, rows: Array) -> Array:
    """Rows (nodes, ..) interpolated, and no farther than the last."""
    place = float(np.interp(at, nodes, np.arange(len(nodes))))
    low = min(int(place), len(nodes) - 2)
    return np.asarray((low + 1 - place) * rows[low] + (place - low) * rows[low + 1])


@cache
def _table() -> tuple[Array, Array]:
    """Bins (BINS,) and weights (albedos, angles, BINS)."""
    data: dict[str, Any] = json.loads(TABLE.read_text(encoding="utf-8"))
    return np.linspace(-REACH, REACH, BINS), np.array(data["weights"])


def measure(albedo: float, half_angle: float, samples: int = SAMPLES, seed: int = 1) -> Array:
    """(BINS,) of one albedo and ring, summing to 1, by Mitsuba."""
    from tools.light.mitsuba3 import mi

    into, seen = bent(half_angle)
    far, wide = 1000.0, 2.0 * REACH * math.cos(seen)
    lamp = far * np.array([-math.sin(into), 0.0, math.cos(into)])
    eye = 100.0 * np.array([-math.sin(seen), 0.0, math.cos(seen)])
    line = np.zeros((TEXELS, TEXELS, 3), np.float32)  # as long as light wanders, or it would be a dot
    texels = LINE * math.cos(into) / far / SPREAD * TEXELS
    line[:, round((TEXELS - texels) / 2) : round((TEXELS + texels) / 2)] = 1.0
    up = [0.0, 1.0, 0.0]
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volpath", "max_depth": 400, "rr_depth": 60},
            "wall": {
                "type": "cube",
                "to_world": mi.ScalarTransform4f().translate([0, 0, -40]).scale([80, 80, 40]),
                "bsdf": {"type": "null"},
                "interior": {
                    "type": "homogeneous",
                    "albedo": {"type": "rgb", "value": albedo},
                    "sigma_t": 1.0,
                    "phase": {"type": "isotropic"},
                },
            },
            "lamp": {
                "type": "projector",
                "irradiance": {
                    "type": "bitmap",
                    "bitmap": mi.Bitmap(line),
                    "raw": True,
                    "filter_type": "nearest",
                    "wrap_mode": "clamp",
                },
                "fov": math.degrees(2.0 * math.atan(SPREAD / 2)),
                "scale": far**2,
                "to_world": mi.ScalarTransform4f().look_at(list(lamp), [0.0, 0.0, 0.0], up),
            },
            "camera": {
                "type": "orthographic",
                "near_clip": 1.0,
                "far_clip": 1000.0,
                "to_world": mi.ScalarTransform4f().look_at(list(eye), [0.0, 0.0, 0.0], up)
                @ mi.ScalarTransform4f().scale([wide / 2, wide / 2, 1.0]),
                "sampler": {"type": "independent", "sample_count": samples},
                "film": {
                    "type": "hdrfilm",
                    "width": BINS,
                    "height": BINS,
                    "crop_width": BINS,
                    "crop_height": ROWS,
                    "crop_offset_x": 0,
                    "crop_offset_y": (BINS - ROWS) // 2,
                    "pixel_format": "rgb",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                },
            },
        }
    )
    row = np.array(mi.render(scene, seed=seed))[..., 0].mean(axis=0, dtype=np.float64)
    return np.asarray(row / row.sum())


def main() -> None:
    weights = [[measure(a, math.radians(t)).round(7).tolist() for t in HALF_ANGLES_DEG] for a in ALBEDOS]
    TABLE.write_text(json.dumps({"made_by": "python -m tools.light.kernel", "weights": weights}), encoding="utf-8")


if __name__ == "__main__":
    main()
