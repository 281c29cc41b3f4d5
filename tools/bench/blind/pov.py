"""A scene in POV-Ray's words, and POV-Ray run on it: linear light, 16 bits, no noise of its own.

The projector is a point light in a small ball of glass whose colour depends on the angle to the slide's axis. A camera
is three vectors, so that a principal point off the middle is a camera like any other.
"""

import math
import os
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from annulus_pipe.vocabulary import AnnulusError
from tools.bench.blind.mesh import mesh
from tools.bench.blind.pipe import Head, Material, Scene, Stand, Thing
from tools.bench.blind.surface import BOTTOMS, Array, Surface, out

PROGRAM = "povray"
AHEAD_OF_RADIUS, FIRST_OF_RADIUS = (
    1.2,
    0.2,
)  # wall beyond what the rings reach; and where it begins, for no lens sees before
SOFT = 0.15  # of a slit's width: its edges
BRIGHT = 0.5  # of white: the wall before the outermost stripe
LED_ASIDE_OF_RADIUS, LEDS = 0.12, 3
HEADER = "#version 3.7;\nglobal_settings { assumed_gamma 1.0 max_trace_level 4 }\n"
MOST_S = 1800  # of a frame; one takes 2 on a free core


def need_povray() -> None:
    """Raises AnnulusError, one line, where there is no POV-Ray."""
    if shutil.which(PROGRAM) is None:
        raise AnnulusError(
            f"{PROGRAM}: is not installed. The blind bench draws with it: tools/need.sh povray installs it."
        )


def vector(values: Iterable[float]) -> str:
    return "<" + ",".join(f"{value:.6f}" for value in values) + ">"


# ---- what stands still ---------------------------------------------------------------------------------------------
def pipe_text(scene: Scene, last_mm: float) -> str:
    """Everything that is not the head, as far as `last_mm` of the rings' light."""
    surface, radius = Surface(scene.pipe), scene.pipe.radius_mm
    points, faces = mesh(surface, FIRST_OF_RADIUS * radius, last_mm + AHEAD_OF_RADIUS * radius)
    corners = ",".join(f"<{x:.4f},{y:.4f},{z:.4f}>" for x, y, z in points.tolist())
    triangles = ",".join(f"<{a},{b},{c}>" for a, b, c in faces.tolist())
    vertices = f"vertex_vectors {{ {len(points)},{corners} }}"
    holes, rest = [], []
    for thing in scene.pipe.things:
        hole, more = _object(surface, thing, radius)
        holes += hole
        rest += more
    clip = f"intersection {{ {' '.join(holes)} }}" if len(holes) > 1 else "".join(holes)
    clip = clip and f"clipped_by {{ {clip} }}"
    return (
        f"#declare Plastic = texture {{ {_texture(scene.pipe.material, radius)} }}\n"
        f"#declare Wall = mesh2 {{ {vertices} face_indices {{ {len(faces)},{triangles} }}\n"
        f"{clip} texture {{ Plastic }} }}\nobject {{ Wall }}\n" + "\n".join(rest) + "\n"
    )


def _texture(material: Material, radius: float) -> str:
    base = f"rgb {vector(material.albedo)}"
    pigment = base
    if material.dirt:
        dark = f"rgb {vector(0.25 * value + 0.01 for value in material.albedo)}"
        edge = 0.5 - 0.16 * math.sqrt(2.0) * _normal(1.0 - 2.0 * material.dirt)
        stops = f"[0 {dark}] [{edge:.3f} {dark}] [{edge + 0.04:.3f} {base}] [1 {base}]"
        pigment = f"bozo turbulence 0.7 color_map {{ {stops} }} scale {0.05 * radius:.3f}"
    else:
        pigment = f"color {base}"
    mirror = f"reflection {{ 0, {material.mirror:.3f} falloff 3 }}" if material.mirror else ""
    grain = f"normal {{ bumps {material.grain:.3f} scale {0.02 * radius:.3f} }}" if material.grain > 0.02 else ""
    gloss = f"specular {material.gloss:.3f} roughness {material.gloss_width:.4f}"
    return f"pigment {{ {pigment} }} finish {{ ambient 0 diffuse 1 {gloss} {mirror} }} {grain}"


def _normal(part: float) -> float:
    """The inverse of the error function, well enough for a share of dirt."""
    sign, square = math.copysign(1.0, part), math.log(max(1.0 - part * part, 1e-9))
    half = 2.0 / (math.pi * 0.147) + square / 2.0
    return sign * math.sqrt(math.sqrt(half * half - square / 0.147) - half)


def _object(surface: Surface, thing: Thing, radius: float) -> tuple[list[str], list[str]]:
    """What a thing leaves of the wall (all but a hole), and what it adds."""
    if thing.kind not in (*BOTTOMS, "branch", "tee", "cable", "hose"):
        return [], []
    origin, frame = surface.frame_at(thing.z_mm)
    way = frame @ np.array([*out(np.array(thing.clock_deg)), 0.0])
    across, ahead = np.cross(frame[:, 2], way), frame[:, 2]
    half = thing.length_mm / 2
    wall = float(surface.shape(np.array(thing.clock_deg), np.array(thing.z_mm)))
    if thing.kind in BOTTOMS:
        level = thing.numbers["level_mm"]
        rows = " ".join(f"{v:.6f}," for v in np.stack([across, ahead, way]).ravel()) + vector(origin)[1:-1]
        wet = "specular 0.5 roughness 0.01 reflection { 0, 0.3 falloff 4 }" if thing.kind == "water" else ""
        look = f"pigment {{ rgb <0.17,0.13,0.09> }} finish {{ ambient 0 diffuse 1 {wet} }}"
        box = f"box {{ {vector((-1.2 * radius, -half, level))}, {vector((1.2 * radius, half, 1.2 * radius))}"
        return [], [f"{box} matrix <{rows}> {look} }}"]
    if thing.kind == "cable":
        middle = origin + thing.numbers["aside_mm"] * way
        ends = vector(middle - 1.3 * radius * across), vector(middle + 1.3 * radius * across)
        look = "pigment { rgb <0.05,0.05,0.06> } finish { ambient 0 diffuse 1 specular 0.2 }"
        return [], [f"cylinder {{ {ends[0]}, {ends[1]}, {half:.4f} {look} }}"]
    if thing.kind == "hose":
        thick = thing.numbers["thick_mm"] / 2
        middle = origin + (wall - thick) * way
        ends = vector(middle - (half - thick) * ahead), vector(middle + (half - thick) * ahead)
        look = "pigment { rgb <0.3,0.3,0.32> } finish { ambient 0 diffuse 1 specular 0.2 }"
        return [], [
            f"sphere_sweep {{ linear_spline 2, {ends[0]}, {thick:.4f} {ends[1]}, {thick:.4f} tolerance 1e-4 {look} }}"
        ]
    inner, outer = thing.numbers["inner_d_mm"] / 2, thing.numbers["outer_d_mm"] / 2
    far = origin + 2.2 * radius * way
    hole = f"cylinder {{ {vector(origin)}, {vector(far)}, {inner:.4f} inverse }}"
    if thing.kind == "branch":
        ends = vector(origin - 9 * radius * ahead), vector(origin + 9 * radius * ahead)
        bore = f"cylinder {{ {ends[0]}, {ends[1]}, {0.998 * wall:.4f} inverse }}"
        start = vector(origin + 0.3 * radius * way)
        return [hole], [
            f"cylinder {{ {start}, {vector(far)}, {inner:.4f} open clipped_by {{ {bore} }} texture {{ Plastic }} }}"
        ]
    start = origin + (wall - thing.depth_mm) * way
    tube = f"cylinder {{ {vector(start)}, {vector(far)}, {outer:.4f} }}"
    bore = f"cylinder {{ {vector(origin)}, {vector(far + radius * way)}, {inner:.4f} }}"
    return [hole], [f"difference {{ {tube} {bore} texture {{ Plastic }} }}"]


# ---- what moves ----------------------------------------------------------------------------------------------------
def camera_axes(surface: Surface, stand: Stand) -> tuple[Array, Array]:
    """Where the camera is, and its axes (columns x, y, ahead), in space."""
    origin, frame = surface.frame_at(stand.z_mm)
    turned = turn_of(stand)
    return origin - frame @ turned.T @ np.array([stand.tx_mm, stand.ty_mm, 0.0]), frame @ turned.T


def turn_of(stand: Stand) -> Array:
    """Ry Rx."""
    (a, b), (c, d) = ((math.cos(v), math.sin(v)) for v in (stand.rx, stand.ry))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, a, -b], [0.0, b, a]])
    about_y = np.array([[c, 0.0, d], [0.0, 1.0, 0.0], [-d, 0.0, c]])
    return np.asarray(about_y @ about_x)


def camera_text(head: Head, focal: float, at: Array, axes: Array) -> str:
    x, y, ahead = axes.T
    wide, high = head.width, head.height
    if head.model == "pinhole":
        aim = focal * ahead + ((wide - 1) / 2 - head.centre_px[0]) * x + ((high - 1) / 2 - head.centre_px[1]) * y
        sides = f"right {vector(wide * x)} up {vector(-high * y)}"
        return f"camera {{ perspective location {vector(at)} direction {vector(aim)} {sides} }}\n"
    side = math.hypot(wide, high)
    angle = math.degrees(side / focal)
    sides = f"right {vector(wide / side * x)} up {vector(-high / side * y)} angle {angle:.6f}"
    return f"camera {{ fisheye location {vector(at)} direction {vector(ahead)} {sides} }}\n"


def frame_text(scene: Scene, stand: Stand) -> str:
    """Camera, lamp and rods of one frame."""
    head, radius, change = scene.head, scene.pipe.radius_mm, scene.change
    at, axes = camera_axes(Surface(scene.pipe), stand)
    part = stand.drift if change.grows else 1.0
    text = [HEADER, camera_text(head, head.focal_px * (1.0 + part * change.focal), at, axes)]
    power = BRIGHT / max(scene.pipe.material.albedo)
    if stand.lamp == "led":
        fade = f"fade_distance {1.3 * radius:.3f} fade_power 2"
        for k in range(LEDS):
            turn = 2.0 * math.pi * k / LEDS
            aside = LED_ASIDE_OF_RADIUS * radius * np.array([math.cos(turn), math.sin(turn), 0.0])
            text.append(f"light_source {{ {vector(at + axes @ aside)} rgb {power / LEDS:.4f} {fade} }}\n")
    else:
        text.append(_projector(head, radius, at, axes, part, scene, power))
    for clock, away, thick in head.rods:
        x, y = away * out(np.array(clock))
        ends = (at + axes @ np.array([x, y, z]) for z in (head.vertex_mm[2] + 0.02 * radius, 0.0))
        text.append(
            f"cylinder {{ {vector(next(ends))}, {vector(next(ends))}, {thick:.4f} no_image pigment {{ rgb 0.02 }} }}\n"
        )
    return "".join(text)


def _projector(head: Head, radius: float, at: Array, axes: Array, part: float, scene: Scene, power: float) -> str:
    change = scene.change
    vertex = at + axes @ (np.array(head.vertex_mm) + np.array(change.shift_mm))
    x, y = change.turn_rad
    axis = np.array(head.axis) + np.array([x, y, 0.0])
    ahead = axes @ (axis / np.linalg.norm(axis))
    side = np.cross(ahead, axes[:, 0])
    side /= np.linalg.norm(side)
    rows = np.stack([np.cross(side, ahead), side, ahead])
    matrix = ",".join(f"{v:.9f}" for v in rows.ravel()) + "," + vector(vertex)[1:-1]
    outer = sum(head.slits[-1]) / 2
    fade = f"fade_distance {radius / math.sin(outer):.3f} fade_power 2"
    stops = "".join(
        f"[{angle / math.pi:.9f} rgbf {vector((*colour, 1.0))}]"
        for angle, colour in slide(head, 1.0 + part * change.angles)
    )
    glass = f"pigment {{ function {{ acos(z/sqrt(x*x+y*y+z*z))/pi }} color_map {{ {stops} }} }}"
    return (
        f"light_source {{ {vector(vertex)} rgb {power:.4f} {fade} }}\n"
        f"sphere {{ 0, {0.01 * radius:.4f} hollow no_image no_reflection {glass} matrix <{matrix}> }}\n"
    )


def slide(head: Head, scale: float) -> list[tuple[float, tuple[float, float, float]]]:
    """Half-angle and colour of every stop of the slide, black before the first stripe and after the last."""
    black = (0.0, 0.0, 0.0)
    edges = [head.slits[0][0] - head.margin_rad, *(v for pair in head.slits for v in pair)]
    edges.append(head.slits[-1][1] + head.margin_rad)
    soft = SOFT * (head.slits[0][1] - head.slits[0][0]) / 2
    stops: list[tuple[float, tuple[float, float, float]]] = [(0.0, black)]
    for k, letter in enumerate(head.colours):
        colour = head.dyes["RGB".index(letter)]
        first, last = edges[2 * k], edges[2 * k + 1]
        stops += [(first - soft, black), (first + soft, colour), (last - soft, colour), (last + soft, black)]
    return [(angle * scale, colour) for angle, colour in stops] + [(math.pi, black)]


# ---- run -----------------------------------------------------------------------------------------------------------
def render(text: Path, picture: Path, width: int, height: int, options: Sequence[str] = ()) -> Array:
    """(H, W, 3) float64, blue first, 0..1 linear. Raises AnnulusError with what POV-Ray says."""
    run_povray(text, [f"+O{picture}", f"+W{width}", f"+H{height}", "+FN16", "File_Gamma=1.0", *options])
    image = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise AnnulusError(f"{picture}: POV-Ray wrote no picture.")
    return np.asarray(image[..., :3], dtype=np.float64) / 65535.0


def run_povray(text: Path, options: Sequence[str]) -> None:
    """One thread, no window. Raises AnnulusError, one line."""
    need_povray()
    command = [PROGRAM, f"+I{text}", "-D", "+WT1", "-GA", "-P", *options]
    done = subprocess.run(
        command,
        cwd=text.parent,
        capture_output=True,
        text=True,
        timeout=MOST_S,
        check=False,
        env={**os.environ, "HOME": str(text.parent)},
    )
    if done.returncode:
        reported = [line for line in done.stderr.splitlines() if "rror" in line]
        raise AnnulusError(f"{text.name}: POV-Ray ended with {done.returncode}: {' '.join(reported)[:300]}")
