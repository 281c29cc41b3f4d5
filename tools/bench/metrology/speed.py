"""Time of one frame, from the camera's image to points with sigma, on one core; how it grows.

CPU time of the one thread used, median over frames that follow each other as in a scan (every frame a fresh image, so
it comes from main memory). Frames are the ray-traced scene's where that is at hand, else the twin's; what grows is the
twin's. The comparison with what one would write by hand is topic rings of table speed.
"""

import json
import os
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import cv2
import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World, clean_world
from tools.bench.metrology import TABLE
from tools.bench.table import SCENES, Row

mpl.use("Agg")
from matplotlib import pyplot as plt

TARGET_MS = 5.0
PROTOTYPE_MS = 9.2
WIDTHS = (640, 832, 1248, 1664, 2080)
ROUNDS = 3

Image = NDArray[np.uint8]


def timed(calibration: Calibration, images: Sequence[Image], rounds: int = ROUNDS) -> dict[str, float]:
    """Median ms of every stage, "total", "without pose", and "scan": all frames, ms."""
    reconstructor = Reconstructor(calibration)
    pose = reconstructor.profile(images[0], frame=0, z_mm=0.0).pose  # compiles, fills the tables
    stages: dict[str, list[float]] = {}
    began = time.thread_time()
    for _ in range(rounds):
        for image in images:
            profile = reconstructor.profile(image, frame=0, z_mm=0.0, seed=pose, clock=time.thread_time)
            pose = profile.pose
            for name, ms in profile.timing_ms.items():
                stages.setdefault(name, []).append(ms)
            stages.setdefault("without pose", []).append(profile.timing_ms["total"] - profile.timing_ms["pose"])
    out = {name: statistics.median(values) for name, values in stages.items()}
    out["scan"] = 1e3 * (time.thread_time() - began) / rounds
    return out


def twin_frames(world: World, count: int = 8) -> list[Image]:
    renderer = Renderer(world)
    stations = np.linspace(0.0, world.travel_mm, count)
    return [
        to_bgr(renderer.render(world.pose(z), float(z), 1.0, 0.0, seed=i), "bayer_rggb8")
        for i, z in enumerate(stations)
    ]


def first_frames() -> tuple[str, Calibration, list[Image]]:
    scene = SCENES / "pipe-a"
    if not scene.is_dir():
        world = clean_world()
        return "twin", world.calibration(), twin_frames(world, 30)
    rows = [row.split(",") for row in (scene / "frames.csv").read_text().split()[1:]]
    files = [file for _, file, light, _ in rows if light == "projector"]
    calibration = Calibration.from_dict(json.loads((scene / "calibration.json").read_text()))
    return "pipe-a", calibration, [np.asarray(cv2.imread(str(scene / file))) for file in files]


def with_rings(world: World, rings: int) -> World:
    p = world.projector
    few = replace(p, cones=p.cones[-rings:], slit_half_deg=p.slit_half_deg[-rings:], colours=p.colours[-rings - 1 :])
    return replace(world, projector=few)


def draw(growth: dict[str, tuple[list[float], list[dict[str, float]]]]) -> None:
    figure, axes = plt.subplots(1, len(growth), figsize=(12, 3.8), constrained_layout=True)
    for axis, (name, (x, values)) in zip(axes, growth.items(), strict=True):
        if name == "frames":
            axis.plot(x, [value["scan"] / 1e3 for value in values], "o-")
            axis.set(xlabel="frames", ylabel="CPU time, s", ylim=(0, None), xlim=(0, None))
            continue
        for key, label in (
            ("without pose", "image to points with sigma"),
            ("pose", "pose"),
            ("polar", "of it: laying out"),
        ):
            axis.plot(x, [value[key] for value in values], "o-", label=label)
        axis.axhline(TARGET_MS, color="0.6", ls=":", lw=1)
        axis.set(xlabel=name, ylabel="ms a frame, one core", ylim=(0, None), xlim=(0, None))
        axis.legend(fontsize=8)
    figure.savefig(TABLE.pictures / "speed.png", dpi=110)
    plt.close(figure)


def rows() -> list[Row]:
    cv2.setNumThreads(1)
    source, calibration, images = first_frames()
    camera = calibration.camera
    main = timed(calibration, images)
    print("  " + ", ".join(f"{name} {ms:.2f}" for name, ms in main.items()), flush=True)
    world = clean_world()
    growth: dict[str, tuple[list[float], list[dict[str, float]]]] = {"megapixels": ([], []), "rings": ([], [])}
    for width in WIDTHS:
        smaller = world.scaled(width)
        growth["megapixels"][0].append(smaller.camera.width * smaller.camera.height / 1e6)
        growth["megapixels"][1].append(timed(smaller.calibration(), twin_frames(smaller)))
    for rings in range(2, len(world.projector.cones) + 1):
        fewer = with_rings(world, rings)
        growth["rings"][0].append(rings)
        growth["rings"][1].append(timed(fewer.calibration(), twin_frames(fewer)))
    counts = sorted({5, 10, 20, len(images)} & set(range(len(images) + 1)))
    growth["frames"] = ([float(n) for n in counts], [timed(calibration, images[:n], 1) for n in counts])
    for name, (x, values) in growth.items():
        print(f"  {name}: " + ", ".join(f"{a:g}: {v['without pose']:.2f} ms" for a, v in zip(x, values, strict=True)))
    draw(growth)
    pixels, each = growth["megapixels"]
    per_mpx = np.polyfit(pixels, [value["without pose"] for value in each], 1)
    title = f"{camera.width}x{camera.height}, {len(calibration.rings)} rings, {source}"
    return [
        Row(
            f"image to points with sigma, {title}",
            f"{PROTOTYPE_MS} ms (prototype, no sigma)",
            f"<= {TARGET_MS:g} ms",
            f"{main['without pose']:.2f} ms median",
            main["without pose"] <= TARGET_MS,
        ),
        Row(
            "pose, same frames", "-", f"<= {TARGET_MS:g} ms", f"{main['pose']:.2f} ms median", main["pose"] <= TARGET_MS
        ),
        Row("both", "-", "-", f"{main['total']:.2f} ms median", None),
        Row("growth with pixels", "-", "linear", f"{per_mpx[1]:.2f} ms + {per_mpx[0]:.2f} ms a megapixel", None),
        Row(
            "growth with rings",
            "-",
            "linear",
            ", ".join(f"{n:g}: {value['without pose']:.2f} ms" for n, value in zip(*growth["rings"], strict=True)),
            None,
        ),
        Row(
            "growth with frames",
            "-",
            "linear",
            ", ".join(f"{n:g}: {value['scan'] / 1e3:.2f} s" for n, value in zip(*growth["frames"], strict=True)),
            None,
        ),
    ]
