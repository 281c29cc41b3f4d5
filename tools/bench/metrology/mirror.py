"""§3.6's small sensor, a camera that looks at a ball: pipes of 2, 3 and 4 inches, with noise, blur and a mosaic.

The source built one and shows pictures (Fig. 3.13 to 3.15), no numbers. Here one head, its rings laid out for a 3-inch
pipe, is pulled through the twin's pipes; the rings, the pose and the wall come out of the same code as for any camera.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.rings.calibration.autocalibration import calibrate
from annulus_pipe.rings.calibration.contours import close_grid, follow, wide_grid
from annulus_pipe.rings.calibration.observations import observe
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.score import CloudScore, score_cloud, score_defects
from annulus_pipe.twin.worlds import CameraOptics, World, mirror_world
from annulus_pipe.wall.consistency import without_inconsistent
from annulus_pipe.wall.defects import find_defects
from annulus_pipe.wall.grid import Wall, build_wall
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.registration import register
from tools.bench.metrology import TABLE
from tools.bench.table import Row

mpl.use("Agg")
from matplotlib import pyplot as plt

INCH = 25.4
FRAMES = 80  # of the 3-inch scan; a frame every 2 mm
LEAN_DEG, ASIDE_MM, POSES = 3.0, 3.0, 16  # how the head is held to calibrate itself
WORSE = CameraOptics(blur_px=1.6, read=3.0, shot=0.06)


@dataclass(frozen=True)
class Scan:
    world: World
    profiles: Sequence[Profile]
    score: CloudScore
    inside: float  # part of the true radii that lie within k = 2


def scan(world: World, frames: int, calibration: Calibration | None = None) -> Scan:
    renderer, reconstructor = Renderer(world), Reconstructor(calibration or world.calibration())
    profiles: list[Profile] = []
    for i, z in enumerate(np.linspace(0.0, world.travel_mm, frames)):
        image = to_bgr(renderer.render(world.pose(z), float(z), 1.0, seed=i), "bayer_rggb8")
        seed = profiles[-1].pose if profiles else None
        profiles.append(reconstructor.profile(image, frame=i, z_mm=float(z), seed=seed))
    print(f"{2 * world.radius_mm / INCH:.0f} inch, {frames} frames", file=sys.stderr)
    points = np.concatenate([p.points_mm for p in profiles]).astype(float)
    sigma = np.concatenate([p.sigma_mm for p in profiles])
    clock = np.degrees(np.arctan2(points[:, 0], -points[:, 1])) % 360
    error = np.hypot(points[:, 0], points[:, 1]) - world.radius_mm - world.deviation(clock, points[:, 2])
    clear = np.min(
        [f.edge_distance_mm(clock, points[:, 2], world.radius_mm) for f in world.features], axis=0, initial=np.inf
    )
    inside = np.abs(error[clear > 1.5]) <= 2 * sigma[clear > 1.5]
    score = score_cloud(world, points, np.concatenate([p.ring for p in profiles]))
    return Scan(world, profiles, score, float(inside.mean()))


def own_calibration(world: World) -> tuple[Calibration, float, tuple[float, float]]:
    """The head calibrates itself in a clean pipe of its world's: the calibration, its largest error of a full angle
    (degrees), and what it thinks of the radius that it was told (mm, with its standard deviation)."""
    clean = replace(world, features=(), wobble_deg=LEAN_DEG, wobble_mm=ASIDE_MM)
    renderer, truth = Renderer(clean), clean.calibration()
    images = [
        to_bgr(renderer.render(clean.pose(z), float(z), 1.0, seed=1000 + i), "bayer_rggb8")
        for i, z in enumerate(np.linspace(0.0, clean.travel_mm, POSES))
    ]
    camera = truth.camera
    first = [follow(image, wide_grid(camera, np.array([camera.cx, camera.cy])), truth.colours) for image in images]
    grid = close_grid(camera, first)
    seen = [follow(image, grid, truth.colours) for image in images]
    observations = observe(
        camera,
        np.concatenate([np.full(len(one.ring), i) for i, one in enumerate(seen)]),
        np.concatenate([one.ring for one in seen]),
        np.concatenate([one.pixels for one in seen]),
        np.array(grid.centre),
        np.concatenate([one.width for one in seen]),
    )
    found = calibrate(observations, clean.radius_mm)
    worst = max(abs(a.half_angle - b.half_angle) for a, b in zip(found.rings, truth.rings, strict=True))
    covariance = tuple(tuple(float(v) for v in row) for row in found.covariance)
    calibration = Calibration(camera, truth.colours, found.rings, clean.radius_mm, covariance)
    return calibration, math.degrees(2 * worst), found.off_radius_mm


def rows() -> list[Row]:
    small = mirror_world()
    three = scan(small, FRAMES)
    others = [scan(mirror_world(radius_mm=inches * INCH / 2), 16) for inches in (2, 4)]
    rough = scan(replace(small, optics=WORSE), 16)
    calibration, angle, (off, sd) = own_calibration(small)
    own = scan(small, 16, calibration)

    profiles = without_inconsistent(register(three.profiles))
    wall = build_wall(profiles)
    narrowest = min(cone.half_angle for cone in calibration.rings)
    found = find_defects(wall, shadow_ratio=1.0 / math.tan(narrowest)).defects
    defects = score_defects(small, [asdict(d) for d in found])
    draw(small, wall, [others[0], three, others[1]])

    def rms(one: Scan) -> str:
        return f"{one.score.rms_mm:.3f} mm"

    return [
        Row("mirror sensor, 3-inch pipe: rms of the radius", "-", "<= 0.15 mm", rms(three), three.score.rms_mm <= 0.15),
        Row("the same, noise twice as strong, blur 1.6 px", "-", "<= 0.15 mm", rms(rough), rough.score.rms_mm <= 0.15),
        Row("the same, rings calibrated by itself in a pipe", "-", "<= 0.15 mm", rms(own), own.score.rms_mm <= 0.15),
        Row("the same head in a 2-inch pipe", "-", "-", rms(others[0]), None),
        Row("the same head in a 4-inch pipe", "-", "-", rms(others[1]), None),
        Row(
            "3-inch pipe: pocket, bump and groove found, false ones",
            "-",
            "3, 0",
            f"{defects['found']}, {defects['false']}",
            defects["found"] == 3 and defects["false"] == 0,
        ),
        Row("3-inch pipe: true radii within k = 2", "-", "-", f"{100 * three.inside:.1f} %", None),
        Row(f"calibrated by itself, {POSES} poses: largest error of a full angle", "-", "-", f"{angle:.3f} deg", None),
        Row("the pipe's radius as the ball alone tells it", "-", "-", f"{off:+.2f} mm, sigma {sd:.2f} mm", None),
    ]


def draw(world: World, wall: Wall, scans: Sequence[Scan]) -> None:
    image: NDArray[np.uint8] = to_bgr(Renderer(world).render(world.pose(70.0), 70.0, 1.0, seed=1), "bayer_rggb8")
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.4), layout="constrained")
    left.imshow(np.clip(1.6 * image[:, 216:1448, ::-1].astype(float), 0, 255).astype(np.uint8))
    left.set_title("what the camera sees in the ball, 3-inch pipe")
    left.set_axis_off()
    for one in scans:
        rms = [math.nan if v is None else v for v in one.score.rms_by_ring_mm]
        middle.plot(range(1, len(rms) + 1), rms, "o-", label=f"{2 * one.world.radius_mm / INCH:.0f} inch")
    middle.set(
        xlabel="ring, innermost first", ylabel="rms of the radius, mm", title="noise, blur, mosaic; no truth told"
    )
    middle.set_ylim(0)
    middle.legend()
    shown = right.imshow(
        wall.filled_mm().T - world.radius_mm,
        aspect="auto",
        cmap="RdBu_r",
        vmin=-2,
        vmax=2,
        extent=(float(wall.z_mm[0]), float(wall.z_mm[-1]), 12.0, 0.0),
        interpolation="nearest",
    )
    right.set(xlabel="distance, mm", ylabel="clock", title="the 3-inch wall: deviation, mm")
    figure.colorbar(shown)
    figure.savefig(TABLE.pictures / "mirror.png", dpi=90)
    plt.close(figure)
