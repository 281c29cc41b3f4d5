"""What a head is qualified on: a pipe of another diameter, a spool with machined defects, at another temperature.

The head goes on with the calibration that it has: that of its own world at CALIBRATED_C, whatever pipe it is pulled
through. Warmth moves its optics as `wall.optics` has them for a plastic lens, a film slide and an acrylic tube, and
makes the pipe wider.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from annulus_pipe.geometry.drift import Drift, drifted
from annulus_pipe.qualification.trial_files import read_truths
from annulus_pipe.qualification.trials import TrueDefect
from annulus_pipe.twin.worlds.features import FeatureKind, WorldFeature, wrap_deg
from annulus_pipe.twin.worlds.sensor_head import Projector
from annulus_pipe.twin.worlds.world import World
from annulus_pipe.untrusted import shown
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.optics import KELVIN_MOST, Optics

CALIBRATED_C = 20.0  # of lengths in a drawing, ISO 1
PE_PER_K = 1.6e-4  # of a length: makers of polyethylene pipe state 0.13 to 0.2 mm a metre and kelvin
WIDER_MOST = 0.10  # of the head's own pipe: rings of the demo's head land in its picture there; test_reference_pipe.py
STEP_MOST_MM = 8.0  # between two frames: a pocket of 20 by 20 mm is passed by three rings or more in each place
BEYOND_MM = 20.0  # of wall behind the last defect, that its end is told from the pipe's
PIPE_MOST_MM = 6000.0  # a length of pipe as it is sold; bounds the wall's map to half a gigabyte
DEEPEST_MM = 10.0  # the wall of a 6-inch SDR 11 pipe has 15 mm
SMALLEST_MM = 1.0  # of a length or a width: the wall's map has cells of 0.4 mm
DEFECTS_MOST = 1000  # of a spool: all pairs are looked at
BOUNDS: Mapping[str, tuple[float, float]] = {
    "z_mm": (0.0, PIPE_MOST_MM),
    "depth_mm": (0.01, DEEPEST_MM),
    "length_mm": (SMALLEST_MM, PIPE_MOST_MM),
    "width_mm": (SMALLEST_MM, PIPE_MOST_MM),
}


def of_diameter(world: World, diameter_mm: float) -> World:
    """The same head in a pipe of that inner diameter. Raises AnnulusError beyond WIDER_MOST of its own."""
    own = 2 * _qualified(world).radius_mm
    least, most = own * (1 - WIDER_MOST), own * (1 + WIDER_MOST)
    if not least <= diameter_mm <= most:
        raise AnnulusError(
            f"a pipe of {diameter_mm:g} mm inside: expected {least:.1f} to {most:.1f}, this head's is {own:g}"
        )
    return replace(world, radius_mm=diameter_mm / 2)


def at_temperature(world: World, celsius: float) -> World:
    """The same head and pipe so warm, which are at CALIBRATED_C before. Raises AnnulusError for a head that is warmed
    already, and beyond KELVIN_MOST either way."""
    kelvin = celsius - CALIBRATED_C
    if not abs(kelvin) <= KELVIN_MOST:
        raise AnnulusError(
            f"{celsius:g} degrees Celsius: expected {CALIBRATED_C - KELVIN_MOST:g} to {CALIBRATED_C + KELVIN_MOST:g}"
        )
    slide, before = world.projector, _qualified(world).calibration()
    assert isinstance(slide, Projector)
    now = drifted(before, optics_at(celsius, float(np.linalg.norm(before.rings[0].vertex_mm))))
    warm = replace(slide, cones=now.rings)
    return replace(world, camera=now.camera, projector=warm, radius_mm=world.radius_mm * (1 + PE_PER_K * kelvin))


def optics_at(celsius: float, tube_mm: float) -> Drift:
    """What a head of plastic lens, film slide and acrylic tube has drifted by since CALIBRATED_C. tube_mm : how far its
    slide stands behind the camera."""
    prior = Optics(calibrated_c=CALIBRATED_C).prior([celsius] * 3)
    return Drift(prior.focal_mean, prior.slide_mean, prior.tube_mean * tube_mm)


def with_spool(world: World, path: Path, frames: int) -> World:
    """The same head in a pipe with the defects of a file in place of the world's, pulled as far as all its rings pass
    all of them. path : truths, as `annulus pod plan` writes them; a loss is drawn as a pocket, a bump as the cap of a
    ball. Raises AnnulusError for a row that cannot be drawn, and too few frames for it."""
    defects = read_truths(path)
    _require_drawable(path, defects)
    features = tuple(_drawn(_qualified(world), one) for one in defects)
    slide = world.projector
    assert isinstance(slide, Projector)
    reach = [world.radius_mm / math.tan(cone.half_angle) + cone.vertex_mm[2] for cone in slide.cones]
    for one in defects:
        if one.z_mm - one.length_mm / 2 < max(reach):
            raise AnnulusError(
                f"{path}: {shown(one.name)} begins at {one.z_mm - one.length_mm / 2:.0f} mm, expected "
                f"{math.ceil(max(reach))} or beyond: from 0 mm on the head's rings pass no wall before"
            )
    _require_apart(path, defects, world.radius_mm)
    travel = max(one.z_mm + one.length_mm / 2 for one in defects) + BEYOND_MM - min(reach)
    needed = math.ceil(travel / STEP_MOST_MM) + 1
    if frames < needed:
        raise AnnulusError(f"{path}: the head travels {travel:.0f} mm past it, {frames} frames; at least {needed} do")
    return replace(world, features=features, travel_mm=travel)


def _require_drawable(path: Path, defects: Sequence[TrueDefect]) -> None:
    if not 1 <= len(defects) <= DEFECTS_MOST:
        raise AnnulusError(f"{path}: {len(defects)} defects, expected 1 to {DEFECTS_MOST}, a row for each")
    for one in defects:
        for column, (low, high) in BOUNDS.items():
            value = float(getattr(one, column))
            if not low <= value <= high:
                stated = "not stated" if math.isnan(value) else f"{value:g}"
                raise AnnulusError(
                    f"{path}: {shown(one.name)}: {column} is {stated}, expected a number in {low:g}..{high:g}"
                )
        if one.kind == "bump" and not (one.width_mm == one.length_mm >= 2 * one.depth_mm):
            raise AnnulusError(
                f"{path}: {shown(one.name)}: a bump {one.length_mm:g} mm long, {one.width_mm:g} wide and "
                f"{one.depth_mm:g} high, expected a round one, at most half as high as it is long: it is drawn as the "
                "cap of a ball"
            )


def _drawn(world: World, one: TrueDefect) -> WorldFeature:
    kind: FeatureKind = "pocket" if one.kind == "loss" else "bump"
    arc = min(math.degrees(one.width_mm / world.radius_mm), 360.0)
    return WorldFeature(kind, one.z_mm, one.length_mm, one.depth_mm, one.clock_deg, arc)


def _require_apart(path: Path, defects: Sequence[TrueDefect], radius_mm: float) -> None:
    """AnnulusError for the first two whose outlines, as rectangles on the wall, overlap."""
    z, clock, length, width = (
        np.array([getattr(one, name) for one in defects]) for name in ("z_mm", "clock_deg", "length_mm", "width_mm")
    )
    along = np.abs(z[:, None] - z) < (length[:, None] + length) / 2
    around = np.abs(np.radians(wrap_deg(clock[:, None] - clock))) * radius_mm < (width[:, None] + width) / 2
    first, second = np.nonzero(np.triu(along & around, 1))
    if len(first):
        one, other = (shown(defects[k[0]].name) for k in (first, second))
        raise AnnulusError(f"{path}: {one} and {other} overlap, expected wall between any two")


def _qualified(world: World) -> World:
    """The world itself; AnnulusError for one whose head, or pipe, is of another kind."""
    if not isinstance(world.projector, Projector) or world.others or world.course or not world.camera.central:
        raise AnnulusError("world: a reference pipe is drawn for one camera before five rings: demo or clean")
    return world
