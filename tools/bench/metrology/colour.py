"""White, yellow and orange pipes in the twin: how many of the visible slit points are read, and how many wrongly."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.colour import ColourProfile, Stripes, learn, stripes
from annulus_pipe.rings.polar import polar_grid, ring_pixels
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import CONTAMINATED, ORANGE, WHITE, YELLOW, World, clean_world, painted
from annulus_pipe.wall.profile import Profile
from tools.bench.metrology import TABLE
from tools.bench.table import Row

PAINTS = {"white": WHITE, "yellow (MDPE)": YELLOW, "orange": ORANGE}
STATIONS = (8.0, 41.0, 103.0)  # what is measured; learnt from others
LEARNT_AT = (20.0, 90.0)
ABOVE_NOISE = 4.0  # standard deviations of a pixel
ROD_MARGIN_MM = 0.15  # of a rod's silhouette, beyond which its blurred shadow ends
DIRECTIONS = 720


@dataclass(frozen=True)
class Count:
    visible: int
    read: int
    points: int
    wrong: int

    def __add__(self, other: "Count") -> "Count":
        return Count(*(getattr(self, n) + getattr(other, n) for n in ("visible", "read", "points", "wrong")))


def picture(world: World, renderer: Renderer, z_mm: float) -> NDArray[np.uint8]:
    raw = renderer.render(world.pose(z_mm), z_mm, 1.0, seed=round(z_mm))
    return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BayerRGGB2BGR), np.uint8)


def true_rings(world: World, pose: Pose, centre: tuple[float, float]) -> NDArray[np.float64]:
    """(K, J) px: how far from the centre each ring is truly seen in each direction, NaN where it is not visible."""
    turn = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    out = np.full((len(world.projector.cones), DIRECTIONS), np.nan)
    for k, cone in enumerate(world.projector.cones):
        pixels = ring_pixels(world.camera, cone, pose, world.radius_mm, steps=7200)
        lit = ~rod_shadow(world, cone.vertex_mm, pixels, pose)
        offset = pixels - centre
        angle = np.arctan2(offset[:, 1], offset[:, 0]) % (2 * np.pi)
        far = np.where(lit, np.hypot(offset[:, 0], offset[:, 1]), np.nan)
        nearest = np.abs((angle[:, None] - turn + np.pi) % (2 * np.pi) - np.pi).argmin(axis=0)
        out[k] = far[nearest] if bright_enough(world, k) else np.nan
    return out


def bright_enough(world: World, k: int) -> bool:
    """Whether both stripes beside slit k stand above a pixel's noise."""
    projector, optics = world.projector, world.optics
    fall = (np.sin(projector.cones[k].half_angle) / np.sin(projector.cones[-1].half_angle)) ** 3
    albedo = np.array(world.albedo) / max(world.albedo)
    sides = [np.array(projector.response["RGB".index(c)]) * albedo for c in projector.colours[k : k + 2]]
    light = [projector.peak * fall * float(side.max()) for side in sides]
    return all(one > ABOVE_NOISE * np.sqrt(optics.read**2 + optics.shot * one) for one in light)


def rod_shadow(
    world: World, vertex: tuple[float, float, float], pixels: NDArray[np.float64], pose: Pose
) -> NDArray[np.bool_]:
    """Which wall places, given by their pixels, lie in a rod's shadow."""
    rays = world.camera.rays(pixels)
    way, start = rays @ pose.rotation, -pose.translation @ pose.rotation
    a, b = (way[:, :2] ** 2).sum(axis=1), way[:, :2] @ start[:2]
    s = (-b + np.sqrt(b * b - a * (start[:2] @ start[:2] - world.radius_mm**2))) / a
    path = s[:, None] * rays - np.array(vertex)
    out = np.isnan(s)
    for rod in world.rods:
        to = np.array([rod.x_mm, rod.y_mm]) - vertex[:2]
        t = (path[:, :2] @ to) / (path[:, :2] ** 2).sum(axis=1)  # where the light passes nearest to the rod
        apart = np.linalg.norm(to - t[:, None] * path[:, :2], axis=1)
        z = vertex[2] + t * path[:, 2]
        out |= (t > 0) & (t < 1) & (apart < rod.radius_mm + ROD_MARGIN_MM) & (z > rod.z0_mm - 1) & (z < rod.z1_mm + 1)
    return out


def count(world: World, profile: Profile, true: NDArray[np.float64], centre: tuple[float, float]) -> Count:
    seen = np.isfinite(true)
    if profile.pose is None:
        return Count(int(seen.sum()), 0, 0, 0)
    pixels = world.camera.project(profile.pose.to_camera(profile.points_mm.astype(float), profile.z_mm)) - centre
    far = np.hypot(pixels[:, 0], pixels[:, 1])
    everywhere = np.where(seen, true, np.inf)[:, profile.direction]  # (K, N)
    nearest = np.abs(everywhere - far).argmin(axis=0)
    known = np.isfinite(everywhere).any(axis=0)
    wrong = known & (nearest != profile.ring) & np.isfinite(everywhere[profile.ring, np.arange(len(far))])
    read = np.zeros_like(seen)
    read[profile.ring[~wrong], profile.direction[~wrong]] = True
    return Count(int(seen.sum()), int((read & seen).sum()), len(far), int(wrong.sum()))


def learnt(world: World) -> tuple[ColourProfile, list[Stripes]]:
    renderer, reconstructor = Renderer(world), Reconstructor(world.calibration())
    seen = []
    for z in LEARNT_AT:
        slits, placed = reconstructor.slits_by_order(picture(world, renderer, z))
        if placed is not None:
            seen.append(stripes(slits, placed, world.calibration()))
    return learn(seen, (world.optics.balance[0], world.optics.balance[2])), seen


def measure(world: World, profile: ColourProfile | None) -> Count:
    renderer = Renderer(world)
    reconstructor = Reconstructor(world.calibration(), DIRECTIONS, colour=profile)
    centre = polar_grid(world.calibration(), DIRECTIONS).centre
    total = Count(0, 0, 0, 0)
    for z in STATIONS:
        found = reconstructor.profile(picture(world, renderer, z), frame=0, z_mm=z)
        total += count(world, found, true_rings(world, world.pose(z), centre), centre)
    return total


def rows() -> list[Row]:
    out = []
    drawn: list[tuple[str, Stripes, Stripes]] = []
    for name, albedo in PAINTS.items():
        for filters, response in (("", None), (", leaking filters", CONTAMINATED)):
            world = painted(clean_world(seed=3), albedo, response)
            profile, before = learnt(world)
            red, blue = profile.gains
            balanced = replace(world, optics=replace(world.optics, balance=(red, 1.0, blue)))
            again, after = learnt(balanced)
            if response is not None and albedo is not WHITE:
                drawn.append((name, before[0], after[0]))
            for how, count_ in (
                ("no profile", measure(world, None)),
                ("profile", measure(world, profile)),
                (f"profile, gains set (red {red:.1f}, blue {blue:.1f})", measure(balanced, again)),
            ):
                read, wrong = 100 * count_.read / count_.visible, 100 * count_.wrong / max(count_.points, 1)
                out.append(
                    Row(
                        f"{name}{filters}; {how}: visible slit points read, wrong ring",
                        "-",
                        ">= 95 %, <= 0.1 %",
                        f"{read:.1f} %, {wrong:.3f} % of {count_.visible}",
                        read >= 95 and wrong <= 0.1,
                    )
                )
                print(out[-1].what, out[-1].measured, flush=True)
            out.append(
                Row(
                    f"{name}{filters}; two colours most alike: as they come, seen through the profile, gains set",
                    "Fig. 3.11",
                    "-",
                    "{:.0f}, {:.0f}, {:.0f} degrees apart".format(*profile.separation, again.separation[0]),
                    None,
                )
            )
    draw(drawn)
    return out


def draw(drawn: list[tuple[str, Stripes, Stripes]]) -> None:
    """The stripes' colours in the camera's RGB cube, before and after the white balance, as in Fig. 3.11."""
    figure = Figure(figsize=(9, 4.4 * len(drawn)), dpi=110, layout="constrained")
    for row, (name, before, after) in enumerate(drawn):
        for column, (how, seen) in enumerate((("gains 1", before), ("recommended gains", after))):
            axes = figure.add_subplot(len(drawn), 2, 2 * row + column + 1, projection="3d")
            for s, colour in enumerate(("#c8322b", "#2e8b3d", "#2b59c8")):
                light = seen.light[seen.colour == s][::12]
                axes.scatter(*np.clip(light, 0, 255).T, s=3, color=colour)
            axes.set(xlabel="red", ylabel="green", zlabel="blue", xlim=(0, 255), ylim=(0, 255), zlim=(0, 255))
            axes.view_init(elev=22, azim=-52)
            axes.set_title(f"{name}, {how}", fontsize=10)
    figure.savefig(TABLE.pictures / "colour.png")
