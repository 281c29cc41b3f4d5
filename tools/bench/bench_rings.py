"""Time of one projector frame, stage by stage, on one core, next to what one would write with OpenCV and SciPy alone.

    .venv/bin/python tools/bench/bench_rings.py [SCAN] [--frames N] [--json]

SCAN is a scan folder with calibration.json (default ../shared/scenes/pipe-a when it is there, else a frame is drawn).
Times are CPU time of the one thread used, median over the frames (least in brackets: a busy machine slows the caches).
"""

import argparse
import csv
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", NUMBA_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import cv2
import numpy as np
from scipy.signal import find_peaks

from annulus.geometry.calibration import Calibration
from annulus.geometry.pose import Pose
from annulus.rings.reconstructor import Reconstructor

HERE = Path(__file__).resolve().parents[2]
DEFAULT = HERE.parent / "shared" / "scenes" / "pipe-a"


def frames_of(scan: Path, limit: int) -> tuple[Calibration, list[np.ndarray]]:
    calibration = Calibration.from_dict(json.loads((scan / "calibration.json").read_text()))
    with (scan / "frames.csv").open() as rows:
        files = [row["file"] for row in csv.DictReader(rows) if row["light"] == "projector"][:limit]
    return calibration, [np.asarray(cv2.imread(str(scan / name))) for name in files]


def drawn_frames(limit: int) -> tuple[Calibration, list[np.ndarray]]:
    sys.path.insert(0, str(HERE / "tests" / "unit" / "rings"))
    from drawn import Paint, calibration, draw

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scan", nargs="?", type=Path)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    scan = args.scan or (DEFAULT if DEFAULT.is_dir() else None)
    calibration, images = frames_of(scan, args.frames) if scan else drawn_frames(args.frames)

    start = time.perf_counter()
    reconstructor = Reconstructor(calibration)
    pose = reconstructor.profile(images[0], frame=0, z_mm=0.0).pose
    setup_s = time.perf_counter() - start
    stages: dict[str, list[float]] = {}
    points = []
    for _ in range(max(1, 40 // len(images))):
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
    tables = list(cv2.initUndistortRectifyMap(camera.matrix, k, np.eye(3), camera.matrix,
                                              (camera.width, camera.height), cv2.CV_16SC2))  # fmt: skip
    median = {name: statistics.median(values) for name, values in stages.items()}
    result = {
        "source": str(scan) if scan else "drawn",
        "frames": len(images),
        "stages_ms": median,
        "least_ms": {name: min(values) for name, values in stages.items()},
        "polar_map_to_points_ms": median["total"] - median["pose"],
        "pose_ms": median["pose"],
        "pose_without_seed_ms": statistics.median(cold),
        "all_ms": median["total"],
        "by_hand_ms": statistics.median(timed(lambda i=i: by_hand(i, calibration, tables)) for i in images[:20]),
        "prototype_ms": 9.2,
        "demosaic_ms": demosaic,
        "points_per_frame": statistics.median(points),
        "first_frame_s": setup_s,
    }
    if args.json:
        print(json.dumps(result))
        return
    print(f"one projector frame, {camera.width}x{camera.height}, {len(calibration.rings)} rings, {result['source']}")
    for name, ms in median.items():
        if name != "total":
            print(f"  {name:34} {ms:8.2f} ms   ({min(stages[name]):.2f})")
    for label, key in (
        ("polar map to points, without pose", "polar_map_to_points_ms"), ("  KNOWN.md's prototype", "prototype_ms"),
        ("pose (seeded by the last frame)", "pose_ms"), ("pose, no seed", "pose_without_seed_ms"), ("all", "all_ms"),
        ("undistort + warpPolar + find_peaks", "by_hand_ms"), ("demosaic, where the camera is raw", "demosaic_ms"),
    ):  # fmt: skip
        print(f"{label:36} {result[key]:8.2f} ms")
    print(f"{'points a frame':36} {result['points_per_frame']:8.0f}")
    print(f"{'set-up and first frame':36} {setup_s:8.2f} s")


if __name__ == "__main__":
    main()
