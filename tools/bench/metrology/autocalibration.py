"""Calibration in the pipe, simulated: Tables 4.3 and 4.4 and Fig. 4.9, the same simulation through our solver."""

import time
from collections.abc import Iterator
from dataclasses import replace

import matplotlib as mpl
import numpy as np

from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.calibration.autocalibration import calibrate
from annulus_pipe.rings.calibration.bundle import Solution
from annulus_pipe.rings.calibration.corrections import fit_corrections
from annulus_pipe.rings.calibration.cross_validation import measure
from annulus_pipe.rings.calibration.observations import Observations
from tools.bench.metrology import TABLE
from tools.bench.metrology.ring_simulation import (
    CAMERA,
    POSES,
    RADIUS_MM,
    RINGS,
    Errors,
    errors,
    noise,
    poses_within,
    simulate,
)
from tools.bench.table import Row

mpl.use("Agg")
from matplotlib import pyplot as plt

NOTE = """
A draw: where round the rings light leaves, and where in its pixel the lens's axis lies, which the source does not say.
Ring by ring the source's 0.019 deg and 0.125 mm are not reached: in one draw of ten the angle is as good, in two the
vertex. Rounding leaves 0.34 px at each of 5700 places a ring, of which least squares know an angle to 0.012 to 0.036
deg and a vertex to 0.10 to 0.12 mm (one sigma, stated), and the errors lie within that: no start, weight or bound of
the loss is at fault. A loss by the fourth power, which errors of rounding suit, had 0.028 deg and 0.124 mm in six of
these draws in place of 0.036 and 0.136; edges in a picture are not rounded, and the product's loss is not made for it.
"""
DRAWS = 10  # of directions' phase and of where the lens's axis meets its pixel
NOISY_DRAWS = 6
FRAMES = (2, 3, 4, 6, 8, 12, 16)
MORE_DEG, MORE_MM = 13.0, 14.0  # poses beyond Table 4.2's eight are drawn within so much


def rows() -> list[Row]:
    return [*_clean(), *_noisy(), *_against_frames(), *_growth()]


def _clean() -> list[Row]:
    seen = simulate(POSES)
    took = []
    for _ in range(3):
        began = time.thread_time()
        solution = calibrate(seen, RADIUS_MM)
        took.append(time.thread_time() - began)
    ring, joint = _each_alone(seen), errors(solution)
    alone, together = [], []
    for seed in range(DRAWS):
        rng = np.random.default_rng(seed)
        camera = replace(CAMERA, cx=CAMERA.cx + rng.uniform(-0.5, 0.5), cy=CAMERA.cy + rng.uniform(-0.5, 0.5))
        drawn = simulate(POSES, camera=camera, phase=rng.uniform())
        alone.append(_each_alone(drawn))
        together.append(errors(calibrate(drawn, RADIUS_MM)))
        print(f"   clean, draw {seed}: {together[-1]}, ring by ring {alone[-1]}", flush=True)
    one, all_ = "one ring at a time", "all rings together"
    return [
        *_against(
            f"{one} (Alg. 1, as the source's 0.019 deg)",
            alone,
            ("0.019 deg, one draw", "0.125 mm, one draw"),
            (0.019, 0.125),
        ),
        *_against(f"{all_} (Alg. 2)", together, ("-", "-"), (0.005, 0.02)),
        Row(
            f"{one}, the source's own directions and axis",
            "0.019 deg, 0.125 mm",
            "-",
            f"{ring.angle_deg:.4f} deg, {ring.vertex_mm:.4f} mm",
            None,
        ),
        Row(
            f"{all_}, the source's own directions and axis",
            "-",
            "-",
            f"{joint.angle_deg:.4f} deg, {joint.vertex_mm:.4f} mm",
            None,
        ),
        Row(
            "solve, 8 frames, 28800 observations, cold, CPU",
            "-",
            "<= 2 s",
            f"{np.median(took):.2f} s",
            float(np.median(took)) <= 2.0,
        ),
    ]


def _against(what: str, draws: list[Errors], source: tuple[str, str], asked: tuple[float, float]) -> Iterator[Row]:
    """Both worst errors of each draw: their median against what is asked, and the worst."""
    for name, unit, said, most, of in zip(
        ("worst full angle", "worst vertex component"), ("deg", "mm"), source, asked, _columns(draws), strict=True
    ):
        middle = float(np.median(of))
        yield Row(
            f"{what}, 8 poses, rounded pixels: {name}",
            said,
            f"<= {most:g} {unit}, median",
            f"median {middle:.4f}, worst {max(of):.4f} {unit}",
            middle <= most,
        )


def _each_alone(seen: Observations) -> Errors:
    """Every ring with poses of its own, as Alg. 1 has it; the worst of all."""
    found = [errors(calibrate(_only(seen, k), RADIUS_MM), RINGS[k : k + 1]) for k in range(len(RINGS))]
    return Errors(max(one.angle_deg for one in found), max(one.vertex_mm for one in found))


def _only(seen: Observations, ring: int) -> Observations:
    mine = np.flatnonzero(seen.ring == ring)
    return replace(seen.take(mine), ring=np.zeros(len(mine), np.int64))


def _noisy() -> list[Row]:
    fixed, alone, fresh, bound = [], [], [], []
    for seed in range(NOISY_DRAWS):
        rng = np.random.default_rng(100 + seed)
        poses = POSES + poses_within(rng, 8, MORE_DEG, MORE_MM)
        seen = simulate(poses, noise(rng), phase=rng.uniform())
        first = calibrate(seen, RADIUS_MM)
        alone.append(errors(first))
        fixed.append(errors(fit_corrections(seen, first)[0]))
        found = calibrate(simulate(poses, fresh_noise=rng, phase=rng.uniform()), RADIUS_MM)
        fresh.append(errors(found))
        bound.append(float(np.sqrt(np.diag(found.covariance)).reshape(-1, 6)[:, 3:].max()))
        print(f"   noise, draw {seed}: {fixed[-1]}, cones alone {alone[-1]}, anew {fresh[-1]}", flush=True)
    (angle, vertex), (angle0, vertex0), (angle1, vertex1) = map(_columns, (fixed, alone, fresh))
    return [
        Row(
            "16 poses, 0.325 deg of noise in the projector: worst full angle",
            "0.123 deg, one draw",
            "<= 0.025 deg, median",
            f"median {np.median(angle):.4f}, worst {max(angle):.4f} deg",
            float(np.median(angle)) <= 0.025,
        ),
        Row(
            "the same: worst vertex component",
            "0.47 mm, one draw",
            "<= 0.04 mm, median",
            f"median {np.median(vertex):.4f}, worst {max(vertex):.4f} mm",
            float(np.median(vertex)) <= 0.04,
        ),
        Row(
            "the same by Alg. 2 alone, no offsets allowed",
            "0.123 deg, 0.47 mm, one draw",
            "-",
            f"{np.median(angle0):.4f} deg, {np.median(vertex0):.4f} mm",
            None,
        ),
        Row(
            f"noise anew in each frame; these observations can tell {np.median(bound):.2f} mm (one sigma)",
            "-",
            "-",
            f"{np.median(angle1):.3f} deg, {np.median(vertex1):.3f} mm",
            None,
        ),
    ]


def _against_frames() -> list[Row]:
    """Fig. 4.9: one ring at a time (Alg. 1) and all together (Alg. 2), against the number of frames."""
    curves: dict[str, list[float]] = {"single": [], "multiple": [], "single, noise": [], "multiple, noise": []}
    rng = np.random.default_rng(7)
    poses = POSES + poses_within(rng, 8, MORE_DEG, MORE_MM)
    pattern = noise(rng)
    for frames in FRAMES:
        for suffix, with_noise in (("", None), (", noise", pattern)):
            seen = simulate(poses[:frames], with_noise)
            curves["multiple" + suffix].append(_image_error(_solved(seen)))
            each = [_image_error(_solved(_only(seen, k)), RINGS[k : k + 1]) for k in range(len(RINGS))]
            curves["single" + suffix].append(float(np.sqrt(np.mean(np.square(each)))))
        print(f"   {frames} frames: " + ", ".join(f"{n} {c[-1]:.3f}" for n, c in curves.items()), flush=True)
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for ax, suffix, title in zip(axes, ("", ", noise"), ("pixels rounded", "and 0.325 deg of noise"), strict=True):
        for name, shade in (("single", "#d1495b"), ("multiple", "#1f4e79")):
            ax.semilogy(
                FRAMES, curves[name + suffix], "o-", label=f"{name} ring{'s' * (name != 'single')}", color=shade
            )
        ax.set_xlabel("calibration frames")
        ax.set_ylabel("error of the rings' images elsewhere, px rms")
        ax.set_title(title)
        ax.legend()
        ax.grid(alpha=0.3)
    figure.savefig(TABLE.pictures / "autocalibration.png", dpi=100)
    plt.close(figure)
    at = FRAMES.index(4)
    return [
        Row(
            "4 frames: error of the rings' images in 9 other poses, one ring at a time; all together (Fig. 4.9)",
            "-",
            "-",
            f"{curves['single'][at]:.3f}; {curves['multiple'][at]:.3f} px",
            None,
        ),
        Row(
            "the same with noise",
            "-",
            "-",
            f"{curves['single, noise'][at]:.2f}; {curves['multiple, noise'][at]:.2f} px",
            None,
        ),
    ]


def _growth() -> list[Row]:
    """Time against frames, rings, observations."""
    times: dict[str, tuple[list[float], list[float]]] = {}
    rng = np.random.default_rng(3)
    poses = POSES + poses_within(rng, 24, MORE_DEG, MORE_MM)

    def timed(seen: Observations) -> float:
        began = time.thread_time()
        calibrate(seen, RADIUS_MM)
        return time.thread_time() - began

    many = tuple(replace(RINGS[0], half_angle=float(a)) for a in np.linspace(0.3, 0.52, 15))
    eight = simulate(POSES)
    times["frames"] = [4, 8, 16, 32], [timed(simulate(poses[:n])) for n in (4, 8, 16, 32)]
    times["rings"] = [1, 5, 10, 15], [timed(simulate(POSES, rings=many[:n])) for n in (1, 5, 10, 15)]
    parts = (8, 4, 2, 1)
    times["observations"] = (
        [len(eight) / n for n in parts],
        [timed(eight.take(np.arange(0, len(eight), n))) for n in parts],
    )
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.4), layout="constrained")
    for ax, (name, (x, y)) in zip(axes, times.items(), strict=True):
        ax.plot(x, y, "o-", color="#1f4e79")
        ax.set_xlabel(name)
        ax.set_ylim(0)
        ax.set_ylabel("CPU seconds, cold start")
        ax.grid(alpha=0.3)
    figure.savefig(TABLE.pictures / "autocalibration_time.png", dpi=100)
    plt.close(figure)
    told = ", ".join(f"{n} frames {t:.1f} s" for n, t in zip(*times["frames"], strict=True))
    return [Row("time against frames, rings, observations (picture)", "-", "-", told, None)]


def _solved(seen: Observations) -> Solution | None:
    try:
        return calibrate(seen, RADIUS_MM)
    except Exception as error:
        print(f"   {error}")
        return None


def _image_error(solution: Solution | None, truth: tuple[Cone, ...] = RINGS) -> float:
    """How far the images of the found rings lie from those of the true ones, px rms, in poses of no calibration frame;
    the pipe is put where the found rings see it best."""
    if solution is None:
        return float("nan")
    poses = tuple(Pose(np.radians(a), np.radians(b), 0.0, 0.0) for a in (-8, 0, 8) for b in (-8, 0, 8))
    seen = simulate(poses, rings=truth, rounded=False)
    return float(np.sqrt(np.nanmean(measure(seen, solution, poses).error_px ** 2)))


def _columns(found: list[Errors]) -> tuple[list[float], list[float]]:
    return [e.angle_deg for e in found], [e.vertex_mm for e in found]
