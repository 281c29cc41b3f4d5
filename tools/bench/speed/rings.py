"""Time of one projector frame, stage by stage, on one core, next to what one would write with OpenCV, NumPy and SciPy.

Frames are the ray-traced scene's where that is at hand, else drawn; one after the other, so that none is in a cache.
Times are CPU time of the one thread used, median over the frames (least in brackets: a busy machine slows the caches).
ANNULUS_LOOPS=x86-64-v3 measures that library on a processor that could run a better one.
"""

import csv
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.signal import find_peaks

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.mosaic import Mosaic
from annulus_pipe.rings.polar import Unroller, polar_grid
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.wall.pose import fit_pose
from tests.unit.rings.drawn import Paint, calibration, draw
from tools.bench.table import SCENES, Row

FRAMES = 40
ASKED_MS, ASKED_MOSAIC_MS = 2.0, 2.6


def frames_of(scan: Path, limit: int) -> tuple[Calibration, list[np.ndarray]]:
    calibration = Calibration.from_dict(json.loads((scan / "calibration.json").read_text()))
    with (scan / "frames.csv").open() as rows:
        files = [row["file"] for row in csv.DictReader(rows) if row["light"] == "projector"][:limit]
    return calibration, [np.asarray(cv2.imread(str(scan / name))) for name in files]


def drawn_frames(limit: int) -> tuple[Calibration, list[np.ndarray]]:
    cal = calibration(scale=1.0)
    poses = [Pose(0.02 * np.sin(i), 0.02 * np.cos(i), 2 * np.cos(i), -2 * np.sin(i)) for i in range(min(limit, 5))]
    return cal, [draw(cal, p, paint=Paint(supersample=1, noise=2.0), seed=i) for i, p in enumerate(poses)]


def as_mosaic(image: np.ndarray) -> Mosaic:
    """Cells of a frame (H, W, 3) BGR, red first."""
    cells = np.array(image[:, :, 1])
    cells[::2, ::2], cells[1::2, 1::2] = image[::2, ::2, 2], image[1::2, 1::2, 0]
    return Mosaic(cells, "rggb")


def timed(call: Callable[[], object]) -> float:
    start = time.thread_time()
    call()
    return 1e3 * (time.thread_time() - start)


def by_hand(image: np.ndarray, calibration: Calibration, tables: list[np.ndarray]) -> None:
    """What one would pick instead: undistort, cv2.warpPolar, luma, scipy's peaks on every ray. Whole pixels only: no
    decoding, no points. `tables`: cv2.initUndistortRectifyMap, cached."""
    camera = calibration.camera
    flat = cv2.remap(image, tables[0], tables[1], cv2.INTER_LINEAR)
    polar = cv2.warpPolar(flat, (620, 720), (camera.cx, camera.cy), 620, cv2.WARP_POLAR_LINEAR)
    dark = -cv2.GaussianBlur(cv2.cvtColor(polar, cv2.COLOR_BGR2GRAY), (5, 1), 1.2).astype(np.float32)
    for line in dark:
        find_peaks(line, prominence=10, width=(2, 20))


def minima_by_hand(lines: np.ndarray) -> None:
    """The least one would do with NumPy: dark places along lines that lie ready, (J, L) float32, to whole samples. No
    colours, no rings, no points."""
    smooth = (lines[:, :-2] + 2.0 * lines[:, 1:-1] + lines[:, 2:]) / 4.0
    middle = smooth[:, 1:-1]
    np.nonzero((middle < smooth[:, :-2]) & (middle <= smooth[:, 2:]) & (middle < 0.5 * middle.max()))


def pose_by_hand(points: np.ndarray, radius_mm: float) -> None:
    """scipy's robust least squares for rx, ry, tx, ty on the same points (N, 3) of one frame."""

    def off(x: np.ndarray) -> np.ndarray:
        along = np.array([np.sin(x[1]), -np.sin(x[0]) * np.cos(x[1]), np.cos(x[0]) * np.cos(x[1])])
        from_axis = points - np.array([x[2], x[3], 0.0])
        return np.linalg.norm(from_axis - np.outer(from_axis @ along, along), axis=1) - radius_mm

    least_squares(off, np.zeros(4), loss="cauchy", f_scale=0.1)


def rows() -> list[Row]:
    cv2.setNumThreads(1)
    scan = SCENES / "pipe-a" if (SCENES / "pipe-a").is_dir() else None
    calibration, images = frames_of(scan, FRAMES) if scan else drawn_frames(FRAMES)
    start = time.perf_counter()
    reconstructor = Reconstructor(calibration)
    pose = reconstructor.profile(images[0], frame=0, z_mm=0.0).pose
    setup_s = time.perf_counter() - start
    stages: dict[str, list[float]] = {}
    points = []
    for _ in range(max(1, FRAMES // len(images))):
        for image in images:
            profile = reconstructor.profile(image, frame=0, z_mm=0.0, seed=pose, clock=time.thread_time)
            pose = profile.pose
            points.append(len(profile.ring))
            for name, ms in profile.timing_ms.items():
                stages.setdefault(name, []).append(ms)
    cold = [
        reconstructor.profile(image, frame=0, z_mm=0.0, clock=time.thread_time).timing_ms["pose"]
        for image in images[:10]
    ]
    camera = calibration.camera
    mosaic = np.ascontiguousarray(images[0].max(axis=2))
    demosaic = statistics.median(timed(lambda: cv2.cvtColor(mosaic, cv2.COLOR_BayerRGGB2BGR)) for _ in range(20))
    k = np.array([*camera.distortion, 0, 0, 0, 0, 0][:5] if camera.model == "pinhole" else np.zeros(5))
    tables = list(
        cv2.initUndistortRectifyMap(
            camera.matrix, k, np.eye(3), camera.matrix, (camera.width, camera.height), cv2.CV_16SC2
        )
    )
    hand = statistics.median(timed(lambda i=i: by_hand(i, calibration, tables)) for i in images[:20])
    mosaics = [as_mosaic(image) for image in images]
    of_mosaics = [
        reconstructor.profile(one, frame=0, z_mm=0.0, seed=pose, clock=time.thread_time).timing_ms["total"]
        for _ in range(max(1, FRAMES // len(images)))
        for one in mosaics
    ]
    lines = np.array(Unroller(polar_grid(calibration, 720))(images[0]).top, np.float32)
    minima = statistics.median(timed(lambda: minima_by_hand(lines)) for _ in range(20))
    seen = reconstructor.profile(images[0], frame=0, z_mm=0.0)
    at = seen.points_mm.astype(float)
    fit_ms = statistics.median(
        timed(lambda: fit_pose(at, calibration.pipe_radius_mm, seen.sigma_mm)) for _ in range(20)
    )
    least_ms = statistics.median(timed(lambda: pose_by_hand(at, calibration.pipe_radius_mm)) for _ in range(5))
    median = {name: statistics.median(values) for name, values in stages.items()}
    what = f"{camera.width}x{camera.height}, {len(calibration.rings)} rings, {scan.name if scan else 'drawn'}"

    def ms(what: str, value: float, source: str = "-", least: float | None = None) -> Row:
        return Row(what, source, "-", f"{value:.2f} ms" + ("" if least is None else f" ({least:.2f})"))

    return [
        *(ms(f"{what}: {name}", value, least=min(stages[name])) for name, value in median.items() if name != "total"),
        ms("polar map to points, without pose", median["total"] - median["pose"], "9.2 ms (prototype)"),
        ms("pose, not seeded by the last frame", statistics.median(cold)),
        Row(
            "all: image to points with sigma and pose",
            "-",
            f"<= {ASKED_MS:.0f} ms",
            f"{median['total']:.2f} ms ({min(stages['total']):.2f})",
            bool(median["total"] <= ASKED_MS),
        ),
        Row(
            "the same from the mosaic, no colours made but beside slits",
            "-",
            f"<= {ASKED_MOSAIC_MS:.1f} ms",
            f"{statistics.median(of_mosaics):.2f} ms ({min(of_mosaics):.2f})",
            bool(statistics.median(of_mosaics) <= ASKED_MOSAIC_MS),
        ),
        ms("instead: undistort + warpPolar + find_peaks, no points", hand),
        ms("instead: numpy's minima of lines that lie ready, no colours, no points", minima),
        ms("the pose alone, not seeded", fit_ms),
        ms(f"instead: scipy.optimize.least_squares, Cauchy, {least_ms / fit_ms:.0f} times", least_ms),
        ms("demosaic, where the camera is raw", demosaic),
        Row("points a frame", "-", "-", f"{statistics.median(points):.0f}"),
        Row("set-up and first frame", "-", "-", f"{setup_s:.2f} s"),
    ]
