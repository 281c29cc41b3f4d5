"""Time of one projector frame, stage by stage, on one core, next to what one would write with OpenCV and SciPy alone.

Frames are the ray-traced scene's where that is at hand, else drawn. Times are CPU time of the one thread used, median
over the frames (least in brackets: a busy machine slows the caches).
"""

import csv
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", NUMBA_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import cv2
import numpy as np
from scipy.signal import find_peaks

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.reconstructor import Reconstructor
from tests.unit.rings.drawn import Paint, calibration, draw
from tools.bench.table import SCENES, Row

FRAMES = 40
ASKED_MS = 4.0


def frames_of(scan: Path, limit: int) -> tuple[Calibration, list[np.ndarray]]:
    calibration = Calibration.from_dict(json.loads((scan / "calibration.json").read_text()))
    with (scan / "frames.csv").open() as rows:
        files = [row["file"] for row in csv.DictReader(rows) if row["light"] == "projector"][:limit]
    return calibration, [np.asarray(cv2.imread(str(scan / name))) for name in files]


def drawn_frames(limit: int) -> tuple[Calibration, list[np.ndarray]]:
    cal = calibration(scale=1.0)
    poses = [Pose(0.02 * np.sin(i), 0.02 * np.cos(i), 2 * np.cos(i), -2 * np.sin(i)) for i in range(min(limit, 5))]
    return cal, [draw(cal, p, paint=Paint(supersample=1, noise=2.0), seed=i) for i, p in enumerate(poses)]


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
        ms("undistort + warpPolar + find_peaks instead", hand),
        ms("demosaic, where the camera is raw", demosaic),
        Row("points a frame", "-", "-", f"{statistics.median(points):.0f}"),
        Row("set-up and first frame", "-", "-", f"{setup_s:.2f} s"),
    ]
