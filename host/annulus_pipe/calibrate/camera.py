"""`annulus calibrate camera`: photographs of a target in, a camera out, with what it is worth."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.calibrate.sample import Progress
from annulus_pipe.calibrate.strangers import misfits, refuse_many, strangers
from annulus_pipe.geometry.calibration import camera_to_dict
from annulus_pipe.geometry.camera import Camera, Model
from annulus_pipe.geometry.chessboard import TargetView, cropped, find_target
from annulus_pipe.geometry.intrinsics import Intrinsics, TargetObservation, fit_intrinsics, target_pose
from annulus_pipe.geometry.origin import AGREE, DICTIONARIES, from_colours, from_markers, read_markers
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.scans.scan import read_image
from annulus_pipe.storage.calibration_file import update_calibration
from annulus_pipe.vocabulary import AnnulusError

IMAGES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
# By topic intrinsics: the spoilt photographs left out and no other, rays off the truth <= 0.1 px. BLURRED, CORNER_OFF
# by test_camera, too. FISHEYE_GAIN (within a factor of three), FEW, LARGE_PX: unguarded.
BLURRED, BLURRED_PX = 2.5, 1.5  # times as blurred as the usual photograph, and so many pixels
PARTIAL = 12  # corners: fewer say less than their own pose needs
CORNER_OFF = 6.0  # robust standard deviations: a corner that was mistaken for one
VIEW_BROKEN = 0.25  # of a photograph's corners are off like that
VIEW_OFF, VIEW_OFF_PX = 3.0, 0.1  # times the usual residual and so many pixels more: the target bent, or it moved
FISHEYE_GAIN = 0.9  # of the pinhole's residual, when the model is free; two models of one lens are often equally good
FEW = 8  # photographs
MISFIT = "does not fit the others"
LARGE_PX = 1.0  # of residual
COVERED_PX = 8.0  # from place to place where coverage is asked


@dataclass(frozen=True, slots=True)
class Target:
    """What was photographed: inner corners each way and the squares' side. `markers`: between the squares, ChArUco."""

    columns: int
    rows: int
    square_mm: float
    markers: str = ""

    def __str__(self) -> str:
        kind = f"ChArUco {self.markers}" if self.markers else "chessboard"
        return f"{kind}, {self.columns}x{self.rows} inner corners"


@dataclass(frozen=True, slots=True, eq=False)
class TargetPhotograph:
    """One image's part in a calibration. `rejected`: why it has none. `rms_px`: NaN where no target was found. `pose`:
    (3, 3) and (3,) mm, target to camera, of those kept; `own_origin`: counted from the target's own first corner, so
    that poses of one place of it are comparable; else from the first corner that was seen."""

    file: str
    corners: int
    left_out: int  # corners far off, mistaken for one
    blur_px: float
    rms_px: float
    rejected: str
    pose: tuple[FloatArray, FloatArray] | None = None
    own_origin: bool = False


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A measured camera and what it rests on."""

    intrinsics: Intrinsics
    target: Target
    target_was_given: bool
    photographs: tuple[TargetPhotograph, ...]
    rms_everything_px: float  # of a plain fit to every corner of every target found, nothing rejected
    coverage: float  # part of the image inside the outline of some target's corners
    warnings: tuple[str, ...]

    @property
    def camera(self) -> Camera:
        return self.intrinsics.camera

    def sigma_map(self, steps: int = 60) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x and y of a grid over the image, and how well a pixel's ray is known there, px; NaN where no target was."""
        x = np.linspace(0, self.camera.width - 1, steps)
        y = np.linspace(0, self.camera.height - 1, max(round(steps * self.camera.height / self.camera.width), 2))
        at = np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2)
        return x, y, self.intrinsics.ray_sigma_px(at).reshape(len(y), len(x))

    def to_dict(self) -> dict[str, Any]:
        camera = self.camera
        sigma = np.sqrt(np.diag(self.intrinsics.covariance))
        spread = self.intrinsics.ray_sigma_px(np.concatenate(self.intrinsics.seen))
        return {
            "camera": camera_to_dict(camera),
            "sigma": {name: float(s) for name, s in zip(("fx", "fy", "cx", "cy"), sigma[:4], strict=True)},
            "target": str(self.target),
            "square_mm": self.target.square_mm,
            "rms_px": self.intrinsics.rms_px,
            "rms_everything_px": self.rms_everything_px,
            "kept": sum(not p.rejected for p in self.photographs),
            "found": len(self.photographs),
            "coverage": self.coverage,
            "ray_sigma_px": {"median": float(np.nanmedian(spread)), "worst": float(np.nanmax(spread))},
            "photographs": [
                {
                    "file": p.file,
                    "corners": p.corners,
                    "left_out": p.left_out,
                    "rms_px": p.rms_px if np.isfinite(p.rms_px) else None,
                    "blur_px": p.blur_px if np.isfinite(p.blur_px) else None,
                    "rejected": p.rejected or None,
                    "pose": None
                    if p.pose is None
                    else {
                        "rotation": p.pose[0].tolist(),
                        "translation_mm": p.pose[1].tolist(),
                        "own_origin": p.own_origin,
                    },
                }
                for p in self.photographs
            ],
            "warnings": list(self.warnings),
        }


def parse_target(text: str) -> tuple[int, int, bool]:
    """Corners the long way and the short way of "9x6" (inner corners) or "charuco 8x6" (squares), and if the latter."""
    match = re.fullmatch(r"\s*(chessboard|charuco)?[\s:,]*(\d+)\s*[xX*]\s*(\d+)(?:[\s:,]+\w+)?\s*", text)
    if match is None:
        raise AnnulusError(
            f'the target is "{text[:40]}", expected like 9x6 (inner corners of a chessboard) or "charuco 8x6" (squares)'
        )
    charuco = match[1] == "charuco"
    a, b = (int(v) - charuco for v in match.group(2, 3))
    if min(a, b) < 3 or max(a, b) > 200:
        raise AnnulusError(f"the target {text.strip()} has {a}x{b} inner corners, expected at least 3x3")
    return max(a, b), min(a, b), charuco


def image_files(given: Sequence[Path]) -> list[Path]:
    """The files themselves, and of folders the images in them. Raises AnnulusError for what is not there."""
    files: list[Path] = []
    for path in given:
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGES)
            if not inside:
                raise AnnulusError(f"{path}: no images in this folder. Expected photographs of a calibration target.")
            files += inside
        elif path.exists():
            files.append(path)
        else:
            raise AnnulusError(f"{path}: no such file. Expected a photograph of a calibration target.")
    return list(dict.fromkeys(files))


def calibrate_camera(
    files: Sequence[Path],
    *,
    model: Model | None = None,
    target: str | None = None,
    square_mm: float = 25.0,
    progress: Progress | None = None,
) -> CameraCalibration:
    """Find the target in each photograph, choose the lens model if need be, fit, leave out what does not belong.

    The squares' side sets no more than the scale of the targets' distances: the camera comes out the same. Raises
    AnnulusError where the photographs cannot make a camera.
    """
    wanted = None if target is None else parse_target(target)
    if len(files) < 2:
        raise AnnulusError(
            f"{len(files)} image, expected at least 2, better 10 to 20 with the target near, tilted and in every corner"
        )
    images, views, rejected = _look(files, progress)
    size = _common_size(files, images, views, rejected)
    found = [i for i, view in enumerate(views) if view is not None]
    if not found:
        raise AnnulusError(
            f"no chessboard in any of {len(files)} images. Expected at least 3x3 inner corners, squares of 8 pixels "
            "or more, lit evenly."
        )
    shown, given = _target(views, wanted, square_mm)
    shown = replace(shown, markers=_dictionary(files, views))
    views = [None if v is None else cropped(v, shown.columns, shown.rows) for v in views]
    _number(files, views, shown, rejected)
    _reject_poor(views, rejected)

    def observations_of(which: Sequence[int]) -> list[TargetObservation]:
        return [
            TargetObservation(np.asarray(square_mm * view.cells, float), view.pixels)
            for i in which
            if (view := views[i]) is not None
        ]

    kept = [i for i in found if not rejected[i]]
    if len(kept) < 2:
        why = "; ".join(f"{files[i].name}: {rejected[i]}" for i in range(len(files)) if rejected[i])
        raise AnnulusError(f"only {len(kept)} of {len(files)} images can be used ({why[:300]}). Expected at least 2.")
    if progress:
        progress("fitting", 0, 3)
    first = _choose_model(observations_of(kept), size, model)
    if progress:
        progress("fitting", 1, 3)

    def inliers_of(which: Sequence[int]) -> list[TargetObservation]:
        return [
            TargetObservation(s.target_mm[good[i]], s.pixels[good[i]])
            for i, s in zip(which, observations_of(which), strict=True)
        ]

    good = {i: np.ones(len(s.pixels), bool) for i, s in zip(kept, observations_of(kept), strict=True)}
    for _ in range(3):
        changed = _reject_far(first, kept, good, rejected)
        kept = [i for i in kept if not rejected[i]]
        if len(kept) < 2:
            raise AnnulusError("the photographs do not agree on one camera: are all from it, unzoomed, target flat?")
        some = inliers_of(kept)
        first = fit_intrinsics(some, *size, first.camera.model, first.camera)
        if not changed:
            break
    while strange := strangers(first, some, [files[i].name for i in kept]):
        for n, reason in strange.items():
            rejected[kept[n]] = reason
        kept = [i for i in kept if not rejected[i]]
        some = inliers_of(kept)
        first = fit_intrinsics(some, *size, first.camera.model, first.camera)
    odd = [i for i in found if rejected[i].startswith(MISFIT)]
    for n, reason in misfits(first, observations_of(odd), [files[i].name for i in odd]).items():
        rejected[odd[n]] = reason
    if progress:
        progress("fitting", 2, 3)
    usable = [i for i in found if views[i] is not None]
    plain = len(kept) == len(usable) and all(good[i].all() for i in kept)
    everything = first if plain else fit_intrinsics(observations_of(usable), *size, first.camera.model, first.camera)
    rms = dict(zip(kept, first.view_rms_px, strict=True))
    pose = dict(zip(kept, zip(first.rotations, first.translations, strict=True), strict=True))
    photographs = []
    for i, file in enumerate(files):
        view = views[i]
        if i not in rms and view is not None:
            rms[i] = target_pose(first.camera, observations_of([i])[0])[2]
        photographs.append(
            TargetPhotograph(
                file.name,
                0 if view is None else len(view.cells),
                int(np.count_nonzero(~good[i])) if i in kept else 0,
                np.nan if view is None else view.blur_px,
                float(rms.get(i, np.nan)),
                rejected[i],
                pose.get(i),
                view is not None and view.own_origin,
            )
        )
    coverage = _coverage(first)
    if progress:
        progress("fitting", 3, 3)
    return CameraCalibration(
        first, shown, given, tuple(photographs), everything.rms_px, coverage, _warnings(first, coverage)
    )


def save_camera(result: CameraCalibration, path: Path, sensor_crop: tuple[int, int, int, int] | None = None) -> bool:
    """Write the `camera` section and its provenance. True when rings measured with another camera stand beside it.

    sensor_crop : what the photographs show of the sensor, where that is known.
    """
    details = result.to_dict()
    del details["camera"]
    section = camera_to_dict(replace(result.camera, sensor_crop=sensor_crop))
    kept = update_calibration(path, {"camera": section}, {"camera": {"by": "annulus calibrate camera", **details}})
    return "rings" in kept


def _look(
    files: Sequence[Path], progress: Progress | None
) -> tuple[list[tuple[int, int] | None], list[TargetView | None], list[str]]:
    """Each file's size, the target in it, and why it cannot be used. One photograph is held at a time."""
    sizes: list[tuple[int, int] | None] = []
    views: list[TargetView | None] = []
    rejected = []
    for n, file in enumerate(files):
        if progress:
            progress("looking for the target", n, len(files))
        try:
            image = read_image(file)  # knows a torn file
        except AnnulusError as error:
            sizes.append(None)
            views.append(None)
            rejected.append("cannot be read: " + str(error).removeprefix(f"{file}: "))
            continue
        sizes.append((image.shape[1], image.shape[0]))
        views.append(find_target(image))
        rejected.append("" if views[-1] is not None else "no target found")
    if progress:
        progress("looking for the target", len(files), len(files))
    return sizes, views, rejected


def _common_size(
    files: Sequence[Path], sizes: Sequence[tuple[int, int] | None], views: list[TargetView | None], rejected: list[str]
) -> tuple[int, int]:
    """Of all photographs, but for a few that lie on their side: those are rejected."""
    counts = Counter(size for size in sizes if size is not None)
    if not counts:
        raise AnnulusError(f"none of {len(files)} files can be read as an image ({files[0]} ..)")
    (width, height), most = counts.most_common(1)[0]
    if counts.keys() - {(width, height), (height, width)}:
        each = ", ".join(
            f"{w}x{h} ({n}, {next(f.name for f, s in zip(files, sizes, strict=True) if s == (w, h))})"
            for (w, h), n in counts.most_common()
        )
        raise AnnulusError(f"images of different sizes: {each}. One calibration is of one camera at one size.")
    aside = [i for i, size in enumerate(sizes) if size not in (None, (width, height))]
    why = f"turned by 90 degrees ({height}x{width}), unlike the {most} others ({width}x{height})"
    refuse_many([files[i].name for i in aside], most, why)
    for i in aside:
        views[i], rejected[i] = None, why
    return width, height


def _target(
    views: Sequence[TargetView | None], wanted: tuple[int, int, bool] | None, square_mm: float
) -> tuple[Target, bool]:
    """As given, or what most photographs that show it whole agree on."""
    sizes = Counter(view.size for view in views if view is not None)
    if wanted is not None:
        larger = sum(n for (a, b), n in sizes.items() if a > wanted[0] or b > wanted[1])
        if larger > sum(sizes.values()) / 2:
            a, b = sizes.most_common(1)[0][0]
            raise AnnulusError(
                f"the target given has {wanted[0]}x{wanted[1]} inner corners, the images show {a}x{b}. Count where "
                "black squares touch, not squares."
            )
        return Target(wanted[0], wanted[1], square_mm), True
    whole = Counter(v.size for v in views if v is not None and len(v.cells) == v.size[0] * v.size[1])
    if whole:
        # seen whole at least twice, or in a tenth: the largest such; parts of it are smaller, clutter is not repeated
        often = [size for size, n in whole.items() if n >= max(2, 0.1 * sum(whole.values()))] or list(whole)
        a, b = max(often, key=lambda size: (size[0] * size[1], whole[size]))
    else:
        a, b = (max(size[i] for size in sizes) for i in (0, 1))
    return Target(a, b, square_mm), False


def _dictionary(files: Sequence[Path], views: Sequence[TargetView | None]) -> str:
    """Of the markers on the target, from the photographs that show most of it; empty for none. Mirrored ones count:
    that they are is found out later."""
    best = sorted((i for i, v in enumerate(views) if v is not None), key=lambda i: -len(views[i].pixels))  # type: ignore[union-attr]
    for i in best[:2]:
        image = read_image(files[i])
        votes = {
            name: max(len(read_markers(one, name).numbers) for one in (image, image[:, ::-1])) for name in DICTIONARIES
        }
        name = max(votes, key=lambda n: votes[n])
        if votes[name] > AGREE:
            return name
    return ""


def _number(files: Sequence[Path], views: list[TargetView | None], target: Target, rejected: list[str]) -> None:
    """Numbers corners as on the target, where it tells; rejects what its markers show to be mirrored."""
    if not target.markers:
        views[:] = [None if v is None else from_colours(v, target.columns, target.rows) for v in views]
        return
    found = [(i, view) for i, view in enumerate(views) if view is not None]
    seen = [read_markers(read_image(files[i]), target.markers) for i, _ in found]
    placed = from_markers([view for _, view in found], seen, target.columns, target.rows)
    for (i, _), view in zip(found, placed, strict=True):
        views[i] = view
        if not view.own_origin and len(read_markers(read_image(files[i])[:, ::-1], target.markers).numbers) >= AGREE:
            rejected[i] = "mirrored: its markers are read in a mirror only"


def _reject_poor(views: list[TargetView | None], rejected: list[str]) -> None:
    usual = float(np.median([view.blur_px for view in views if view is not None]))
    for i, view in enumerate(views):
        if view is None:
            continue
        if len(view.cells) < PARTIAL:
            rejected[i] = f"only {len(view.cells)} corners of the target, {PARTIAL} needed"
        elif view.blur_px > max(BLURRED * usual, BLURRED_PX):
            rejected[i] = f"blurred: edges {view.blur_px:.1f} px wide, usual here {usual:.1f}"


def _choose_model(observations: list[TargetObservation], size: tuple[int, int], model: Model | None) -> Intrinsics:
    if model is not None:
        return fit_intrinsics(observations, *size, model, robust=True)
    fits: dict[Model, tuple[float, Intrinsics]] = {}
    for name in ("pinhole", "fisheye"):
        try:
            fit = fit_intrinsics(observations, *size, name, robust=True)
        except AnnulusError:
            continue
        fits[name] = float(np.median(np.abs(np.concatenate(fit.residuals)))), fit
    if not fits:
        raise AnnulusError("no camera fits these targets: is every photograph from one camera, and the target flat?")
    if "pinhole" not in fits or ("fisheye" in fits and fits["fisheye"][0] < FISHEYE_GAIN * fits["pinhole"][0]):
        return fits["fisheye"][1]
    return fits["pinhole"][1]


def _reject_far(fit: Intrinsics, kept: Sequence[int], good: dict[int, NDArray[np.bool_]], rejected: list[str]) -> bool:
    """Marks corners far off and photographs that have many or are off as a whole; whether anything was marked."""
    pooled = np.concatenate([r.ravel() for r in fit.residuals])
    sigma = robust_sigma(pooled)
    usual = float(np.median(fit.view_rms_px))
    before = sum(int(np.count_nonzero(g)) for g in good.values()), sum(map(bool, rejected))
    for i, off, rms in zip(kept, fit.residuals, fit.view_rms_px, strict=True):
        far = np.linalg.norm(off, axis=1) > CORNER_OFF * max(sigma, 0.02)
        inside = good[i].copy()
        inside[np.flatnonzero(good[i])[far]] = False
        broken = np.mean(~inside)
        left = float(np.sqrt(np.mean((off[~far] ** 2).sum(axis=1)))) if not far.all() else float(rms)
        if broken > VIEW_BROKEN or np.count_nonzero(inside) < PARTIAL:
            rejected[i] = f"{MISFIT}: {rms:.2f} px, usual here {usual:.2f}"
        elif left > VIEW_OFF * usual and left > usual + VIEW_OFF_PX:
            rejected[i] = f"{MISFIT}: {left:.2f} px, usual here {usual:.2f}"
        good[i] = inside
    return before != (sum(int(np.count_nonzero(g)) for g in good.values()), sum(map(bool, rejected)))


def _coverage(fit: Intrinsics) -> float:
    x, y = (np.arange(COVERED_PX / 2, size, COVERED_PX) for size in (fit.camera.width, fit.camera.height))
    return float(fit.covered(np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2)).mean())


def _warnings(fit: Intrinsics, coverage: float) -> tuple[str, ...]:
    camera, views = fit.camera, len(fit.residuals)
    out = []
    if views < FEW:
        out.append(f"{views} photographs: take {FEW} or more")
    if fit.rms_px > LARGE_PX:
        other = "fisheye" if camera.model == "pinhole" else "pinhole"
        out.append(
            f"{fit.rms_px:.1f} px is much for corners read to a tenth: try the {other} model, or is the target bent?"
        )
    tilt = np.degrees(np.arccos(np.clip(np.abs(fit.rotations[:, 2, 2]), 0, 1)))
    if float(np.max(tilt)) < 15.0:
        out.append(
            f"no target leans more than {np.max(tilt):.0f} deg, better 30 to 45: focal length and distance are mixed up"
        )
    if coverage < 0.6:
        out.append(f"targets cover {100 * coverage:.0f} % of the image: where none was, the lens is only extrapolated")
    sigma = float(np.sqrt(fit.covariance[0, 0])) / camera.fx
    if sigma > 0.005:
        out.append(f"the focal length is known to {100 * sigma:.1f} % only: more photographs, nearer, tilted both ways")
    if max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5)) > 0.2:
        out.append("the principal point is far from the image's middle: a cropped image, or too alike poses")
    return tuple(out)
