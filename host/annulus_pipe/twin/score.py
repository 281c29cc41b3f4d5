"""How close a reconstruction of the twin came to the wall that was really there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.twin.worlds import World, WorldFeature

NEAR_EDGE_MM = 1.5  # closer to a step or its shadow than this the truth jumps; scored apart
GROSS_MM = 2.0
MATCH_Z_MM, MATCH_DEG = 6.0, 8.0


@dataclass(frozen=True, slots=True)
class CloudScore:
    """Radius error of points, mm; positive = measured too large."""

    points: int
    rms_mm: float  # away from edges
    median_mm: float
    p99_abs_mm: float
    gross_percent: float  # of the points away from edges, more than 2 mm off
    near_edges_rms_mm: float | None
    rms_by_ring_mm: tuple[float | None, ...]

    def to_dict(self) -> dict[str, Any]:
        return {
            "points": self.points,
            "rms_mm": self.rms_mm,
            "median_mm": self.median_mm,
            "p99_abs_mm": self.p99_abs_mm,
            "gross_over_2mm_percent": self.gross_percent,
            "near_edges_rms_mm": self.near_edges_rms_mm,
            "rms_by_ring_mm": list(self.rms_by_ring_mm),
        }


def score(
    world: World,
    points_mm: NDArray[np.floating[Any]],
    ring: NDArray[np.integer[Any]] | None = None,
    defects: Sequence[Mapping[str, Any]] = (),
    seen_mm: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """Cloud and defect list against the truth, as plain data for `summary.json`.

    points_mm : (N, 3) in the pipe frame. ring : (N,) from 0, innermost first. defects : rows as in `summary.json`.
    seen_mm : stretch of wall the scan covered; only features whose whole length lies in it count as missed. By default
    from the points.
    """
    cloud = score_cloud(world, points_mm, ring)
    if seen_mm is None and len(points_mm):
        low, high = np.percentile(points_mm[:, 2], [0.5, 99.5])
        seen_mm = float(low), float(high)
    return {"cloud": cloud.to_dict(), "defects": score_defects(world, defects, seen_mm)}


def score_cloud(
    world: World, points_mm: NDArray[np.floating[Any]], ring: NDArray[np.integer[Any]] | None = None
) -> CloudScore:
    """Radius errors of (N, 3) pipe-frame points against the world's wall at their clock angle and station."""
    points = np.asarray(points_mm, dtype=np.float64)
    if len(points) == 0:
        return CloudScore(0, np.nan, np.nan, np.nan, np.nan, None, ())
    clock: FloatArray = np.degrees(np.arctan2(points[:, 0], -points[:, 1])) % 360.0
    error = np.hypot(points[:, 0], points[:, 1]) - world.radius_mm - world.deviation(clock, points[:, 2])
    away = _edge_distance(world, clock, points[:, 2]) > NEAR_EDGE_MM
    rings = () if ring is None else tuple(_rms(error[away & (ring == i)]) for i in range(world.projector.rings))
    clear = error[away]
    if len(clear) == 0:
        return CloudScore(len(points), np.nan, np.nan, np.nan, np.nan, _rms(error), rings)
    return CloudScore(
        len(points),
        float(np.sqrt(np.mean(clear**2))),
        float(np.median(clear)),
        float(np.percentile(np.abs(clear), 99)),
        float(100 * np.mean(np.abs(clear) > GROSS_MM)),
        _rms(error[~away]),
        rings,
    )


def score_defects(
    world: World, defects: Sequence[Mapping[str, Any]], seen_mm: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Each true feature with the defect found for it (or None), features missed, and rows that match nothing true.

    A row matches when its kind is right and its centre lies within 6 mm and 8 degrees; a groove has no clock position,
    an oval the same one twice, and as an oval fades in and out its centre may be off by a sixth of its length.
    """
    left = list(defects)
    rows: list[dict[str, Any]] = []
    missed = outside = 0
    for feature in world.features:
        truth = feature.as_defect(world.radius_mm)
        candidates = [d for d in left if _matches(feature, truth, d)]
        best = min(candidates, key=lambda d, z=feature.z_mm: abs(float(d["z_mm"]) - z), default=None)  # type: ignore[misc]
        half = feature.length_mm / 2
        if (
            best is None
            and seen_mm is not None
            and not seen_mm[0] <= feature.z_mm - half <= feature.z_mm + half <= seen_mm[1]
        ):
            outside += 1
            continue
        row: dict[str, Any] = {"true": truth, "found": dict(best) if best is not None else None}
        if best is None:
            missed += 1
        else:
            left.remove(best)
            row["error"] = {
                "z_mm": float(best["z_mm"]) - feature.z_mm,
                "clock_deg": _clock_error(feature, float(best["clock_deg"])),
                "depth_mm": float(best["depth_mm"]) - truth["depth_mm"],
            }
        rows.append(row)
    return {
        "true": len(rows),
        "found": len(rows) - missed,
        "missed": missed,
        "false": len(left),
        "not_scanned": outside,
        "rows": rows,
        "false_rows": [dict(d) for d in left],
    }


def _matches(feature: WorldFeature, truth: Mapping[str, Any], row: Mapping[str, Any]) -> bool:
    reach = max(MATCH_Z_MM, feature.length_mm / 6) if feature.kind == "oval" else MATCH_Z_MM
    return (
        row["kind"] == truth["kind"]
        and abs(float(row["z_mm"]) - feature.z_mm) <= reach
        and abs(_clock_error(feature, float(row["clock_deg"]))) <= (12.0 if feature.kind == "oval" else MATCH_DEG)
    )


def _clock_error(feature: WorldFeature, clock_deg: float) -> float:
    if feature.arc_deg >= 360.0 and feature.kind == "groove":
        return 0.0
    period = 180.0 if feature.kind == "oval" else 360.0
    return (clock_deg - feature.clock_deg + period / 2) % period - period / 2


def _edge_distance(world: World, clock_deg: FloatArray, z_mm: FloatArray) -> FloatArray:
    nearest = np.full(len(z_mm), np.inf)
    for feature in world.features:
        nearest = np.minimum(nearest, feature.edge_distance_mm(clock_deg, z_mm, world.radius_mm))
    return nearest


def _rms(error: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(error**2))) if len(error) else None
