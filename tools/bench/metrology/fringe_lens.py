"""Slides through a lens that distorts (§6.6): what that costs a measurement.

The plate is the other drawer's (tools.bench.blind.others.fringe: its own rays, its own lens), the pipes are the twin's.
Every calibration is found by the product from drawn reference frames; of a pipe it begins with a design that is off and
knows no lens. Constants were set on seeds 2 to 4.
"""

import json
import math
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.scan import write_scan
from annulus_pipe.twin.worlds import World
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.calibrate_pipe import calibrate_fringe_pipe, save_fringe_pipe
from annulus_pipe.wings.fringe.calibrate_plate import calibrate_fringe, save_fringe
from annulus_pipe.wings.fringe.heads import series_world
from annulus_pipe.wings.fringe.job import open_fringe
from annulus_pipe.wings.fringe.light import Fringes
from annulus_pipe.wings.fringe.pipe import open_fringe_pipe, reconstruct_fringe_pipe
from annulus_pipe.wings.fringe.plate import reconstruct_fringe
from tools.bench.blind.others import fringe as drawer
from tools.bench.table import Row

BARREL = -0.03  # of the tangent, at the farthest corner of the picture
WORSE = 1.5  # times the rms of a slide without distortion
PLATES, PIPES = (1, 5, 7), (11,)  # seeds, held out
EDGE_MM = 1.5  # nearer to a step the truth jumps
WIDTH_PX = 560  # of a pipe's cameras: half the head's, a quarter of its time
ASIDE_MM = ((0.0, 0.0), (4.0, 0.0), (-2.0, 3.4), (-2.0, -3.4), (2.0, 3.4), (2.0, -3.4))


def rows() -> list[Row]:
    out = []
    for seed in PLATES:
        straight, bent, ignored, found = plate(seed)
        out.append(_row(f"Plate, seed {seed}, a barrel of 3 %", straight, bent, ignored, found))
    for seed in PIPES:
        world = series_world(seed, travel_mm=46.0).scaled(WIDTH_PX)
        straight, bent, ignored, found = pipe(world, with_barrel(world), 25)
        out.append(_row(f"Model A, seed {seed}, a barrel of 3 %", straight, bent, ignored, found))
    return out


def _row(what: str, straight: float, bent: float, ignored: float, found: str) -> Row:
    without = f"{ignored:.4f}" if math.isfinite(ignored) else "refused"
    return Row(
        f"{what}: height rms over that without; it ignored; calibrated",
        "reconstructed (Fig. 6.8)" if "Plate" in what else "-",
        f"<= {WORSE:g}",
        f"{bent / straight:.2f} ({bent:.4f} over {straight:.4f} mm); {without} mm; {found}",
        bent <= WORSE * straight,
    )


def plate(seed: int, barrel: float = BARREL) -> tuple[float, float, float, str]:
    """rms of height without distortion, with it, and with it as the calibration less its lens has it, mm; what the
    calibration found."""
    values = []
    for bend in (0.0, barrel):
        random = np.random.default_rng([seed, 95])
        head, things = drawer.draw(random)
        edge = _corner(head)
        head.slide_bend = bend / edge**2
        studio = drawer.Studio(head, random)
        step = head.period * head.distance * 0.2
        place = np.concatenate([[0.0], np.cumsum(step * random.uniform(0.6, 1.4, 9))])
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            drawer.write(folder / "reference", studio, [([], h, 0.0, 0.0) for h in drawer.REFERENCE_MM])
            drawer.write(folder / "scan", studio, [(things, 0.0, float(at), float(at)) for at in place])
            file = folder / "calibration.json"
            file.write_text(json.dumps(drawer.cameras(studio)))
            found = calibrate_fringe(folder / "reference", file)
            save_fringe(found, file)
            values.append(_plate_rms(folder / "scan", file, things))
            if bend:
                values.append(_plate_rms(folder / "scan", _without(file, "distortion"), things))
    at = found.found
    true = 100 * head.slide_bend * at.edge**2
    return (*values, f"{100 * at.barrel:.2f} +- {100 * at.barrel_sigma:.2f} % ({true:.2f}) at {at.edge:.2f}")  # type: ignore[return-value]


def _corner(head: drawer.Head) -> float:
    """The widest tangent at which the slide lights what the first camera sees."""
    wide, high = 0.5 * drawer.WIDTH / head.focal, 0.5 * drawer.HEIGHT / head.focal
    corners = head.distance * np.array([[a * wide, b * high, 1.0] for a in (-1, 1) for b in (-1, 1)])
    own = (corners - head.slide_at) @ head.slide_turn.T
    return float((np.hypot(own[:, 0], own[:, 1]) / own[:, 2]).max())


def _plate_rms(scan: Path, file: Path, things: list[drawer.Thing]) -> float:
    try:
        seen = reconstruct_fringe(open_fringe(scan, file))
    except AnnulusError:
        return math.nan
    x, y = np.meshgrid(seen.x_mm, seen.y_mm)
    away = np.isfinite(seen.height_mm) & ~np.any([thing.near(x, y) for thing in things], axis=0)
    return _rms((seen.height_mm - drawer.relief(things, x, y))[away])


def with_barrel(world: World, barrel: float = BARREL) -> World:
    """The same head, its slide behind a lens that distorts so much where its light ends."""
    light = world.projector
    assert isinstance(light, Fringes)
    (one,) = light.slides
    k1 = barrel / math.tan(math.radians(one.field_deg[1])) ** 2
    slide = replace(one.slide, distortion=(k1, 0.0, 0.0, 0.0, 0.0))
    return replace(world, projector=replace(light, slides=(replace(one, slide=slide),)))


def pipe(straight: World, bent: World, frames: int) -> tuple[float, float, float, str]:
    """As `plate`, of two heads in one pipe: with the lens and without."""
    values = []
    for world in (straight, bent):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            design = reference(world, folder / "reference")
            file = folder / "calibration.json"
            found = calibrate_fringe_pipe(folder / "reference", design)
            save_fringe_pipe(found, file)
            write_scan(world, folder / "scan", frames)
            values.append(_pipe_rms(folder / "scan", file, world))
            if world is bent:
                values.append(_pipe_rms(folder / "scan", _without(file, "distortion"), world))
    at = found.found
    true = 100 * BARREL * (at.edge / math.tan(math.radians(_field_deg(bent)))) ** 2
    return (*values, f"{100 * at.barrel:.2f} +- {100 * at.barrel_sigma:.2f} % ({true:.2f}) at {at.edge:.2f}")  # type: ignore[return-value]


def _field_deg(world: World) -> float:
    light = world.projector
    assert isinstance(light, Fringes)
    return light.slides[0].field_deg[1]


def reference(world: World, folder: Path) -> Path:
    """Frames of a clean pipe, the head aside; the slide's design, which is off and knows no distortion."""
    folder.mkdir()
    clean = replace(world, features=(), texture=False, wobble_deg=0.15, wobble_mm=0.0)
    lines = ["index,file,light,z_mm,camera,tx_mm,ty_mm"]
    for index, (right, down) in enumerate(ASIDE_MM):
        aside = replace(clean, centre_mm=(-right, -down))
        for camera in range(len(clean.cameras)):
            raw = Renderer(aside, camera).render(aside.pose(0.0), 0.0, 1.0, seed=index)
            cv2.imwrite(str(folder / f"{index}-{camera}.png"), to_bgr(raw, "bayer_rggb8"))
            lines.append(f"{index},{index}-{camera}.png,projector,0,{camera},{right},{down}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    data = clean.calibration().to_dict()
    slide = dict(data["pattern"]["projector"])
    slide.pop("distortion", None)
    off = (1.0, -1.2, 1.5)
    slide["centre_mm"] = [a + b for a, b in zip(slide["centre_mm"], off, strict=True)]
    slide |= {"period_mm": 1.004 * slide["period_mm"], "phase0": 0.0}
    design = folder / "design.json"
    design.write_text(json.dumps({**data, "pattern": {"kind": "fringe", "projector": slide}}))
    return design


def _without(file: Path, key: str) -> Path:
    """The same calibration without its lens."""
    data = json.loads(file.read_text())
    data["pattern"]["projector"].pop(key, None)
    out = file.with_name("without.json")
    out.write_text(json.dumps(data))
    return out


def _pipe_rms(scan: Path, file: Path, world: World) -> float:
    try:
        seen = reconstruct_fringe_pipe(open_fringe_pipe(scan, file)).map
    except AnnulusError:
        return math.nan
    clock, z = (seen.phi_deg + 90.0) % 360.0, seen.z_mm[:, None]
    off = seen.radius_mm - world.radius_mm - world.deviation(clock[None], z)
    away = np.isfinite(off)
    for one in world.features:
        away &= np.abs(one.edge_distance_mm(clock[None] + 0 * z, z + 0 * clock[None], world.radius_mm)) > EDGE_MM
    return _rms(off[away] - float(np.median(off[away])))


def _rms(off: FloatArray) -> float:
    return float(np.sqrt(np.mean(off**2)))
