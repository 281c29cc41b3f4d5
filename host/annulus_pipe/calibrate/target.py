"""`annulus calibrate target`: rings on a target whose place its own corners tell.

A scan folder holds pairs: the target in white light (`led`) and, with target and head left as they are, with the rings
on it (`projector`). Frames with the same z_mm belong together; if all have one z_mm, each projector frame goes with the
led frame last before it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.calibrate.sample import Progress, read_frame
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.chessboard import TargetView, find_target
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.intrinsics import TargetObservation, target_pose
from annulus_pipe.numeric.arrays import FloatArray, Image
from annulus_pipe.rings.calibration.contours import Contours, close_grid, follow, wide_grid
from annulus_pipe.rings.calibration.target import TargetCones, TargetPoints, fit_cones, on_plane, vertex_order
from annulus_pipe.scans.scan import Scan, open_scan
from annulus_pipe.storage.calibration_file import update_calibration
from annulus_pipe.vocabulary import AnnulusError, Label

# By topic intrinsics (rings on drawn targets: angle, vertex) and test_target (a pair that moved); FEW only warns.
POSE_PX = 1.0  # a target whose corners leave more over is not flat, or not seen by this camera
BEYOND = 0.8  # squares around the outermost corners that still are target
EVEN = 0.8  # of the lightest: the darkest paper beside a slit, or print has moved its edge
DARKEST = 0.08  # of white: paper is not raised from below that
MOVED, MOVED_MM = 4.0, 0.3  # times the usual residual, and so many mm more: moved between its two photographs
FEW = 6  # targets
EDGE_BLUR_PX = 3.0  # beside a slit's edges: as far as print shows in them


@dataclass(frozen=True, slots=True)
class TargetPair:
    """One pose of the target. `pose_px`: what PnP left over. `points`: slits used. `rms_mm`: their distance from the
    cones. NaN and 0 where rejected before."""

    target: str
    rings: str
    corners: int
    pose_px: float
    tilt_deg: float
    distance_mm: float
    points: int
    rms_mm: float
    rejected: str


@dataclass(frozen=True, eq=False)
class TargetCalibration:
    """Cones measured on targets."""

    fit: TargetCones
    ring: NDArray[np.int64]  # (N,) of fit.distance_mm
    pairs: tuple[TargetPair, ...]
    colours: str
    warnings: tuple[str, ...]

    @property
    def cones(self) -> tuple[Cone, ...]:
        return self.fit.cones

    @property
    def rms_mm(self) -> float:
        return float(np.sqrt(np.mean(self.fit.distance_mm[self.fit.used] ** 2)))

    def ring_rms_mm(self) -> FloatArray:
        used = self.fit.used
        return np.array(
            [np.sqrt(np.mean(self.fit.distance_mm[used & (self.ring == k)] ** 2)) for k in range(len(self.cones))]
        )

    def to_dict(self) -> dict[str, Any]:
        sigma = np.sqrt(np.maximum(np.diag(self.fit.covariance), 0.0)).reshape(-1, 6)
        return {
            "rings": [
                {
                    "theta_full_deg": float(np.degrees(2 * c.half_angle)),
                    "axis": list(c.axis),
                    "vertex_mm": list(c.vertex_mm),
                }
                for c in self.cones
            ],
            "ring_rms_mm": [float(v) for v in self.ring_rms_mm()],
            "sigma_theta_full_deg": [float(v) for v in np.degrees(2 * sigma[:, 0])],
            "sigma_vertex_mm": [[float(v) for v in row] for row in sigma[:, 3:]],
            "rms_mm": self.rms_mm,
            "points": int(np.count_nonzero(self.fit.used)),
            "outliers": int(np.count_nonzero(~self.fit.used)),
            "pairs": [
                {
                    name: (None if value != value else value)
                    for name in TargetPair.__slots__
                    if (value := getattr(p, name)) is not ...
                }
                for p in self.pairs
            ],
            "warnings": list(self.warnings),
        }


def calibrate_target(
    path: Path, camera: Camera, colours: str, square_mm: float, progress: Progress | None = None
) -> TargetCalibration:
    """Poses by PnP, slits by the detector that reconstructs, rays to the target's plane, cones through the points.

    colours : stripes from the innermost outwards. Raises AnnulusError where pairs, targets or rings are missing.
    Alzuhiri 2022, §4.3.1.
    """
    if camera.model == "mirror":
        raise AnnulusError("calibrate target: the camera looks at a mirror. Use `annulus calibrate pipe` for it.")
    scan = open_scan(path).only()
    pairs = _pairs(scan)
    first: list[Contours | None] = []
    views: list[TargetView | None] = []
    why = [""] * len(pairs)
    centre = np.array([camera.cx, camera.cy])
    wide = wide_grid(camera, centre)
    for n, (led, projector) in enumerate(pairs):
        if progress:
            progress("looking at targets", n, len(pairs))
        white, rings = (read_frame(scan, i, camera) for i in (led, projector))
        view = find_target(white)
        views.append(view)
        first.append(None)
        if view is None:
            why[n] = "no target found in the white-light frame"
            continue
        try:
            first[n] = follow(_evened(rings, white), wide, colours)
        except AnnulusError as error:
            why[n] = str(error)
            continue
        if not len(first[n].ring):  # type: ignore[union-attr]
            why[n] = "no rings read on the target"
    if progress:
        progress("looking at targets", len(pairs), len(pairs))
    seen = [contour for contour in first if contour is not None and np.isfinite(contour.reach).any()]
    if not seen:
        detail = "; ".join(f"{scan.frames[b].where}: {w}" for (b, _), w in zip(pairs, why, strict=True) if w)
        raise AnnulusError(f"{path}: rings on a target in none of {len(pairs)} pairs ({detail[:300]}).")
    grid = close_grid(camera, seen)

    parts: list[TargetPoints] = []
    rows: list[TargetPair] = []
    for n, (led, projector) in enumerate(pairs):
        if progress:
            progress("measuring rings", n, len(pairs))
        view, tilt, distance, rms = views[n], np.nan, np.nan, np.nan
        if view is not None and not why[n]:
            rotation, shift, rms = target_pose(
                camera, TargetObservation(square_mm * view.cells.astype(float), view.pixels)
            )
            tilt = float(np.degrees(np.arccos(np.clip(abs(rotation[2, 2]), 0, 1))))
            distance = float(np.linalg.norm(shift + rotation @ [*(square_mm * view.cells.mean(axis=0)), 0.0]))
            if rms > POSE_PX:
                why[n] = f"corners are off by {rms:.1f} px: another camera, or the target is not flat"
            else:
                white, rings = (read_frame(scan, i, camera) for i in (led, projector))
                contour = follow(_evened(rings, white), grid, colours)
                where = np.array([float(v) for v in grid.centre])
                good = _on_even_paper(white, contour, where)
                inner, outer = on_plane(camera, contour.pixels, where, contour.width, rotation, shift)
                flat = (0.5 * (inner + outer) - shift) @ rotation[:, :2] / square_mm
                good &= np.all((flat > -BEYOND) & (flat < view.cells.max(axis=0) + BEYOND), axis=1)
                good &= np.isfinite(inner).all(axis=1) & np.isfinite(outer).all(axis=1)
                parts.append(TargetPoints(np.full(len(contour.ring), n), contour.ring, inner, outer).take(good))
                if not good.any():
                    why[n] = "no slit on even paper"
        rows.append(
            TargetPair(
                scan.frames[led].where,
                scan.frames[projector].where,
                0 if view is None else len(view.cells),
                rms,
                tilt,
                distance,
                0,
                np.nan,
                why[n],
            )
        )
    if progress:
        progress("measuring rings", len(pairs), len(pairs))
    points = TargetPoints(
        np.concatenate([p.target for p in parts]),
        np.concatenate([p.ring for p in parts]),
        np.concatenate([p.inner_mm for p in parts]),
        np.concatenate([p.outer_mm for p in parts]),
    )
    fit = fit_cones(points, len(colours) - 1)
    for n in _moved(points, fit):
        why[n] = "its rings do not fit the other targets': moved between the two frames?"
    if any(why[n] for n in np.unique(points.target)):
        points = points.take(np.array([not why[n] for n in points.target]))
        fit = fit_cones(points, len(colours) - 1)
    done = []
    for n, row in enumerate(rows):
        mine = fit.used & (points.target == n)
        off = fit.distance_mm[mine]
        done.append(
            TargetPair(
                row.target,
                row.rings,
                row.corners,
                row.pose_px,
                row.tilt_deg,
                row.distance_mm,
                len(off),
                float(np.sqrt(np.mean(off**2))) if len(off) else np.nan,
                why[n],
            )
        )
    return TargetCalibration(fit, points.ring, tuple(done), colours, _warnings(fit, done))


def save_target(result: TargetCalibration, camera: Mapping[str, Any], radius_mm: float | None, path: Path) -> None:
    """Write `camera`, `pattern`, `rings`, `covariance` and, if given, `pipe`."""
    figures = result.to_dict()
    sections: dict[str, Any] = {
        "camera": dict(camera),
        "pattern": {"colours": result.colours},
        "rings": figures.pop("rings"),
        "covariance": result.fit.covariance.tolist(),
    }
    if radius_mm is not None:
        sections["pipe"] = {"radius_mm": radius_mm}
    update_calibration(path, sections, {"rings": {"by": "annulus calibrate target", **figures}})


def _pairs(scan: Scan) -> list[tuple[int, int]]:
    """(led, projector) frames of one pose each."""
    frames = scan.frames
    together = len({frame.z_mm for frame in frames}) > 1
    out: list[tuple[int, int]] = []
    if together:
        led = {frame.z_mm: i for i, frame in enumerate(frames) if frame.label is Label.LED}
        out = [(led[f.z_mm], i) for i, f in enumerate(frames) if f.label is Label.PROJECTOR and f.z_mm in led]
    else:
        last: int | None = None
        for i, frame in enumerate(frames):
            if frame.label is Label.LED:
                last = i
            elif frame.label is Label.PROJECTOR and last is not None:
                out.append((last, i))
    if len(out) < 3:
        raise AnnulusError(
            f"{scan.path}: {len(out)} pairs of a led and a projector frame at one z_mm, expected at least 3 poses of "
            "the target, better 15 to 20."
        )
    return out


def _evened(rings: Image, white: Image) -> Image:
    """The rings as white paper would show them, as far as the print lets light back."""
    paper = cv2.GaussianBlur(white.max(axis=2), (0, 0), 1.0).astype(np.float32)
    level = float(np.percentile(paper, 95))
    gain = np.minimum(level / np.maximum(paper, 1.0), 1.0 / DARKEST)
    # beyond the target nothing is raised: its gain is that of its surroundings
    return np.asarray(np.clip(rings * gain[:, :, None], 0, 255), np.uint8)


def _on_even_paper(white: Image, contour: Contours, centre: FloatArray) -> NDArray[np.bool_]:
    """Slits that have equally light paper under them, from stripe to stripe."""
    paper = cv2.GaussianBlur(white.max(axis=2), (0, 0), 1.0).astype(np.float32)
    way = contour.pixels - centre
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    reach = contour.width / 2 + EDGE_BLUR_PX
    part = np.linspace(-1.0, 1.0, 13)
    at = (contour.pixels[:, None] + (reach[:, None] * part)[:, :, None] * way[:, None]).astype(np.float32)
    if not len(at):
        return np.zeros(0, bool)
    light = np.empty(at.shape[:2], np.float32)
    for i in range(0, len(at), 30000):
        light[i : i + 30000] = cv2.remap(paper, at[i : i + 30000, :, 0], at[i : i + 30000, :, 1], cv2.INTER_LINEAR)
    low, high = light.min(axis=1), light.max(axis=1)
    return np.asarray((low > EVEN * high) & (high > 0.4 * np.percentile(paper, 95)))


def _moved(points: TargetPoints, fit: TargetCones) -> list[int]:
    targets = [int(n) for n in np.unique(points.target)]
    off = {n: float(np.median(np.abs(fit.distance_mm[points.target == n]))) for n in targets}
    usual = float(np.median(list(off.values())))
    return [n for n in targets if off[n] > MOVED * usual and off[n] > usual + MOVED_MM]


def _warnings(fit: TargetCones, pairs: list[TargetPair]) -> tuple[str, ...]:
    kept = [p for p in pairs if not p.rejected]
    out = []
    if len(kept) < FEW:
        out.append(f"{len(kept)} targets: take 15 to 20")
    near, far = (f(p.distance_mm for p in kept) for f in (min, max))
    if far < 1.4 * near:
        out.append(
            f"targets between {near:.0f} and {far:.0f} mm only: angle and vertex are mixed up, go nearer and farther"
        )
    out += [
        f"the vertex of ring {k} lies farther back than ring {k - 1}'s; glass moves it the other way: a ring "
        "misread, or a target bent?"
        for k in vertex_order(fit.cones, fit.covariance)
    ]
    return tuple(out)
