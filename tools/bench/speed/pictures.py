"""What a frame costs the publisher's process for those who watch: a preview, the light of rows, its slits, the wall.

    python -m tools.bench speed pictures

CPU time of the one thread, median over the frames (least in brackets: a busy machine slows the caches). The frames are
drawn, 1664x1232 as a mosaic; the wall's words are those that a scan at 40 mm/s needs.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from annulus_pipe.daemon.live_wall import LiveWall
from annulus_pipe.daemon.pictures import preview, slits
from annulus_pipe.daemon.pictures import rows as light_of_rows
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import Label
from tests.unit.rings.drawn import Paint, calibration, draw
from tools.bench.table import Row

FRAMES, FPS, SPEED_MM_S = 200, 25.0, 40.0
ASKED_MS = {"preview": 2.3, "rows": 1.0, "slits": 1.5, "wall: a frame's points": 1.5, "wall: its words": 1.0}


def rows() -> list[Row]:
    cv2.setNumThreads(1)
    cal = calibration(scale=1.0)
    image = draw(cal, Pose(0.02, -0.015, 2.0, -1.5), paint=Paint(supersample=1, noise=2.0))
    mosaic = np.ascontiguousarray(image[..., 1])
    height, width = mosaic.shape
    header = FrameHeader(0, None, 0, Label.PROJECTOR, "", None, None, None, 0.0, "bayer_rggb8", width, height)
    profile = Reconstructor(cal).profile(image, frame=0, z_mm=0.0)
    wall, took = LiveWall(cal, 1), dict[str, list[float]]()

    def timed(name: str, call: Callable[[], object]) -> None:
        start = time.thread_time()
        call()
        took.setdefault(name, []).append(1e3 * (time.thread_time() - start))

    for n in range(FRAMES):
        moved = np.array([0.0, 0.0, n * SPEED_MM_S / FPS], np.float32)
        here = replace(profile, z_mm=float(moved[2]), points_mm=profile.points_mm + moved)
        timed("preview", lambda: preview(header, mosaic))
        timed("rows", lambda: light_of_rows(header, mosaic))
        timed("slits", lambda: slits(profile, cal))
        timed("wall: a frame's points", lambda one=here: wall.add(one))  # type: ignore[misc]
        timed("wall: its words", lambda at=n / FPS: list(wall.say(at)))  # type: ignore[misc]
    size = len(preview(header, mosaic)[1]) / 1000
    out = []
    for name, values in took.items():
        value = statistics.mean(values) if name.endswith("words") else statistics.median(values)
        asked = ASKED_MS[name]
        out.append(Row(name, "-", f"<= {asked:g} ms", f"{value:.2f} ms ({min(values):.2f})", value <= asked))
    return [
        *out,
        Row("points a frame", "-", "-", f"{len(profile.points_mm)}"),
        Row("preview", "-", "-", f"{size:.0f} kB"),
    ]
