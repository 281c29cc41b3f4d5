"""Butt-fusion joints drawn as a scanner gives them: a field of density, and what a scanner makes of it.

The pipe is a field of density: a wall between two oval surfaces, two rolls of bead on either (superellipses, each of
its own size), a heat-affected zone with flaring logistic edges, voids, grains, gaps. The scanner: hardening of the
beam by the parabola of its path integrals, turned back by the inverse Abel transform of each slice; scatter that
follows the slice's plastic; a round blur; noise of a ramp-filtered reconstruction; rings about the table's axis; slow
drifts; and any scale of grey, in 8, 16 or 32 bits, plastic brighter than air or darker.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter

RADII_MM = (16.7, 24.1, 30.2, 44.5, 57.2)  # outer, of pipes of 1 to 4 inch
SDR = (7.0, 9.0, 11.0, 13.5, 17.0)
INNER, OF = 4.0, 5.6  # the wall's part over which a zone's width is a mean
PLASTIC_PER_MM = 0.02  # attenuation of polyethylene at 50 keV
SPREAD = 0.08, 0.25  # of it over a tube's spectrum: 90 kV with a filter, 60 kV without
BELL = 1.0  # voxels: what noise is smoothed with before flaws are held against it


@dataclass(slots=True)
class Flaw:
    """phi in rad, rho and z from the fusion plane, mm. size_mm : a sphere's radius, a gap's thickness."""

    kind: str
    phi: float
    rho: float
    z: float
    size_mm: float
    contrast: float
    arc: float = 0.0  # half of a gap's, rad
    deep: float = 0.0  # half of a gap's, mm across the wall


@dataclass(slots=True)
class Joint:
    """Lengths in mm, angles in rad. A wave is (2, K) of cos and sin of orders 1 .. K."""

    radius: float
    wall: float
    voxel: tuple[float, float, float]  # z, y, x
    shape: tuple[int, int, int]
    centre: tuple[float, float]
    lean: tuple[float, float]
    tilt: tuple[float, float]  # of the fusion plane
    aside: tuple[float, float]  # of the second pipe
    outer_wave: np.ndarray
    wall_wave: np.ndarray
    rolls: list[tuple[float, float, float, float]]  # outside before, after, inside before, after: height, width, p, q
    floors: tuple[float, float]  # of the notch outside and inside
    bead_wave: np.ndarray
    zone_width: float
    zone_drop: float
    zone_edge: float
    flare: float
    zone_wave: np.ndarray
    cold: tuple[float, float, float]  # at, half its width, what it takes off
    flaws: list[Flaw] = field(default_factory=list)

    @property
    def bead_mm(self) -> float:
        return max(roll[1] for roll in self.rolls)

    def surface(self, inside: bool, phi: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Distance from the axis; z from the fusion plane at this phi."""
        second = 0.5 * np.sign(z) * (self.aside[0] * np.cos(phi) + self.aside[1] * np.sin(phi))
        plain = self.radius * (1 + wave(self.outer_wave, phi)) + second
        if inside:
            plain = plain - self.wall * (1 + wave(self.wall_wave, phi))
        size = 1 + wave(self.bead_wave, phi)
        before, after = self.rolls[2:] if inside else self.rolls[:2]
        over = np.where(z < 0, roll(-z, before, size), roll(z, after, size))
        narrow = np.abs(z) < 0.5 * size * np.where(z < 0, before[1], after[1])
        over = np.where(narrow, np.maximum(over, self.floors[int(inside)] * size), over)
        return plain - over if inside else plain + over

    def width(self, phi: np.ndarray) -> np.ndarray:
        """Of the zone in the middle of the wall."""
        at, half, off = self.cold
        turned = (phi - at + math.pi) % (2 * math.pi) - math.pi
        return self.zone_width * (1 + wave(self.zone_wave, phi) - off * np.exp(-0.5 * (turned / half) ** 2))

    def mean_width(self, phi: np.ndarray) -> np.ndarray:
        return self.width(phi) * (1 + self.flare * (INNER / OF) ** 2 / 3)


def wave(parts: np.ndarray, phi: np.ndarray) -> np.ndarray:
    out = np.zeros_like(phi)
    for k in range(parts.shape[1]):
        out += parts[0, k] * np.cos((k + 1) * phi) + parts[1, k] * np.sin((k + 1) * phi)
    return out


def roll(z: np.ndarray, one: tuple[float, float, float, float], size: np.ndarray) -> np.ndarray:
    height, width, p, q = one
    u = np.clip(np.abs(2 * z / (width * size) - 1), 0, 1)
    return height * size * (1 - u**p) ** (1 / q)


def draw(rng: np.random.Generator) -> Joint:
    radius, sdr = float(rng.choice(RADII_MM)), float(rng.choice(SDR))
    wall, across = 2 * radius / sdr, int(rng.integers(140, 221))
    x = 2.5 * radius / across
    z, y = x * rng.uniform(0.6, 1.8), x * (rng.uniform(0.95, 1.05) if rng.random() < 0.3 else 1.0)
    tall, wide = wall * rng.uniform(0.2, 0.5), wall * rng.uniform(0.6, 1.2)
    inner = rng.uniform(0.7, 1.1)
    rolls = [
        (
            tall * part * rng.uniform(0.85, 1.15),
            wide * part * rng.uniform(0.85, 1.15),
            rng.uniform(1.7, 2.6),
            rng.uniform(1.7, 2.4),
        )
        for part in (1.0, 1.0, inner, inner)
    ]
    bead = 2 * max(one[1] for one in rolls)
    shape = (int(np.clip((bead + wall * rng.uniform(4.0, 6.0)) / z, 60, 230)), int(across * x / y), across)
    lean = rng.uniform(0, 0.05) if rng.random() < 0.7 else 0.0
    way, hilo, towards = rng.uniform(0, 2 * math.pi, 3)
    aside = wall * rng.uniform(0, 0.1) if rng.random() < 0.6 else 0.0
    joint = Joint(
        radius,
        wall,
        (z, y, x),
        shape,
        (rng.uniform(-0.04, 0.04) * radius, rng.uniform(-0.04, 0.04) * radius),
        (lean * math.cos(way), lean * math.sin(way)),
        (rng.normal(0, 0.012), rng.normal(0, 0.012)),
        (aside * math.cos(hilo), aside * math.sin(hilo)),
        rng.normal(0, 1, (2, 4)) * np.array([0.0, 0.006, 0.002, 0.001]),
        rng.normal(0, 0.012, (2, 3)),
        rolls,
        (tall * rng.uniform(0.15, 0.55), tall * inner * rng.uniform(0.15, 0.55)),
        rng.normal(0, 0.04, (2, 3)),
        bead * rng.uniform(0.45, 0.9),
        0.0 if rng.random() < 0.15 else rng.uniform(0.005, 0.02),
        wall * rng.uniform(0.05, 0.15),
        rng.uniform(-0.15, 0.35),
        rng.normal(0, 0.03, (2, 3)),
        (float(towards), rng.uniform(0.25, 0.6), rng.uniform(0.2, 0.45) if rng.random() < 0.4 else 0.0),
    )
    voxel = (z * y * x) ** (1 / 3)
    for _ in range(int(rng.integers(0, 4))):
        kind, phi = str(rng.choice(["void", "grain", "gap"])), float(rng.uniform(0, 2 * math.pi))
        inner_at = float(joint.surface(True, np.array(phi), np.array(1e3)))
        rho = inner_at + wall * rng.uniform(0.35, 0.65)
        if kind == "gap":
            joint.flaws.append(
                Flaw(
                    kind,
                    phi,
                    inner_at + 0.5 * wall,
                    0.0,
                    rng.uniform(0.2, 0.9) * z,
                    -1.0,
                    rng.uniform(0.1, 0.4),
                    wall * rng.uniform(0.15, 0.3),
                )
            )
        else:
            joint.flaws.append(
                Flaw(
                    kind,
                    phi,
                    rho,
                    rng.uniform(-0.6, 0.6) * bead,
                    rng.uniform(0.8, 2.0) * voxel,
                    -1.0 if kind == "void" else rng.uniform(0.1, 0.8),
                )
            )
    return joint


def density(joint: Joint) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(Z, Y, X) density, and mapped distance from the axis; (2, Z) mean inner and outer radius of each slice."""
    (dz, dy, dx), (slices, rows, columns) = joint.voxel, joint.shape
    along = np.array([*joint.lean, 1.0]) / math.sqrt(1 + joint.lean[0] ** 2 + joint.lean[1] ** 2)
    across = np.array([1.0, 0.0, 0.0]) - along[0] * along
    across /= np.linalg.norm(across)
    down = np.cross(along, across)
    y, x = np.mgrid[:rows, :columns].astype(float)
    x, y = (x - (columns - 1) / 2) * dx - joint.centre[0], (y - (rows - 1) / 2) * dy - joint.centre[1]
    grey, mapped = (np.zeros(joint.shape, np.float32) for _ in range(2))
    radii = np.empty((2, slices))
    for k in range(slices):
        height = (k - (slices - 1) / 2) * dz
        z = x * along[0] + y * along[1] + height * along[2]
        right = x * across[0] + y * across[1] + height * across[2]
        below = x * down[0] + y * down[1] + height * down[2]
        rho, phi = np.hypot(right, below), np.arctan2(below, right)
        z = z - rho * (joint.tilt[0] * np.cos(phi) + joint.tilt[1] * np.sin(phi))
        inner, outer = joint.surface(True, phi, z), joint.surface(False, phi, z)
        solid = np.clip(0.5 + (outer - rho) / dx, 0, 1) * np.clip(0.5 + (rho - inner) / dx, 0, 1)
        depth = (rho - inner) / (outer - inner)
        half = 0.5 * joint.width(phi) * (1 + joint.flare * (2 * np.clip(depth, 0, 1) - 1) ** 2)
        edge = joint.zone_edge
        with np.errstate(over="ignore"):
            zone = 1 / (1 + np.exp((np.abs(z) - half) / (0.5 * edge)))
        one = solid * (1 - joint.zone_drop * zone)
        for flaw in joint.flaws:
            one += flaw.contrast * solid * inside(flaw, rho, phi, z, (dx, dz))
        grey[k] = one
        radii[:, k] = inner.mean(), outer.mean()
        low, high = radii[:, k]
        mapped[k] = np.where(
            depth < 0, low + rho - inner, np.where(depth > 1, high + rho - outer, low + depth * (high - low))
        )
    return grey, mapped, radii


def inside(flaw: Flaw, rho: np.ndarray, phi: np.ndarray, z: np.ndarray, voxel: tuple[float, float]) -> np.ndarray:
    """What part of each voxel a flaw fills."""
    turned = (phi - flaw.phi + math.pi) % (2 * math.pi) - math.pi
    if flaw.kind == "gap":
        filled = np.clip((0.5 * (flaw.size_mm + voxel[1]) - np.abs(z)) / voxel[1], 0, min(1, flaw.size_mm / voxel[1]))
        return filled * (np.abs(turned) < flaw.arc) * (np.abs(rho - flaw.rho) < flaw.deep)
    away = np.sqrt((rho * np.cos(turned) - flaw.rho) ** 2 + (rho * np.sin(turned)) ** 2 + (z - flaw.z) ** 2)
    return np.clip(0.5 + (flaw.size_mm - away) / voxel[0], 0, 1)


def hardening(radii: np.ndarray, radius: float, count: int = 240) -> tuple[np.ndarray, np.ndarray]:
    """(R,) radii, mm, and (R, Z) what the square of the paths through a tube is by the inverse Abel transform, mm."""
    edge = np.linspace(0, 1.3 * radius, count + 1)
    ray = 0.5 * (edge[1:] + edge[:-1])
    reach = np.sqrt(np.maximum(edge**2 - ray[:, None] ** 2, 0))  # (ray, edge)
    chords = 2 * np.diff(reach, axis=1)
    paths = 2 * (
        np.sqrt(np.maximum(radii[1] ** 2 - ray[:, None] ** 2, 0))
        - np.sqrt(np.maximum(radii[0] ** 2 - ray[:, None] ** 2, 0))
    )
    return ray, np.linalg.solve(chords, paths**2)


def scanned(joint: Joint, rng: np.random.Generator) -> tuple[np.ndarray, float, str]:
    """The volume in greys as they are stored, what its noise is after BELL as a part of plastic, and its form."""
    grey, smooth = reconstructed(joint, rng)
    if rng.random() < 0.3:
        grey[:, beyond_disc(joint)] = grey.min() if rng.random() < 0.5 else 0.0
    return stored(grey, smooth, rng)


def beyond_disc(joint: Joint) -> np.ndarray:
    """(Y, X) what a reconstruction of the largest disc in a slice leaves out."""
    _, rows, columns = joint.shape
    y, x = np.mgrid[:rows, :columns]
    return np.asarray(np.hypot(x - columns / 2, y - rows / 2) > 0.5 * min(rows, columns))


def reconstructed(joint: Joint, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """The volume as a scanner computes it, air 0 and plastic 1, and what its noise is after BELL."""
    grey, mapped, radii = density(joint)
    plastic = grey.sum(axis=(1, 2))
    plastic /= np.median(plastic)
    ray, curve = hardening(radii, joint.radius)
    # Of a spectrum whose attenuation has this relative spread, a path p is measured as p - spread^2 p^2 / 2.
    strength, scatter = 0.5 * rng.uniform(*SPREAD) ** 2 * PLASTIC_PER_MM, rng.uniform(0.0, 0.02)
    for k in range(len(grey)):
        grey[k] -= strength * np.interp(mapped[k], ray, curve[:, k])
        grey[k] -= scatter * (plastic[k] - 1)
    blur = rng.uniform(0.45, 0.9)
    grey = gaussian_filter(grey, (blur * rng.uniform(0.7, 1.0), blur, blur))
    slices, rows, columns = joint.shape
    noise = rng.normal(0, 1, joint.shape).astype(np.float32)
    ramp = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns))
    ramp = np.sqrt(ramp) * np.exp(-((ramp / 0.45) ** 2))
    noise = np.fft.irfft2(np.fft.rfft2(noise) * ramp, s=(rows, columns)).astype(np.float32)
    level = rng.uniform(0.01, 0.08)
    noise *= level / noise.std()
    smooth = float(gaussian_filter(noise[: min(40, slices)], BELL).std())
    grey += noise
    y, x = np.mgrid[:rows, :columns]
    table = np.hypot(x - columns / 2, y - rows / 2)
    ring = np.interp(table, np.arange(columns), rng.normal(0, rng.uniform(0, 0.01), columns))
    z = np.linspace(-1, 1, slices)
    drift = 1 + rng.normal(0, 0.01) * z + rng.normal(0, 0.005) * z**2
    bow = 1 + rng.normal(0, 0.01) * (y / rows - 0.5)
    return (grey + ring) * bow * drift[:, None, None], smooth


def stored(grey: np.ndarray, smooth: float, rng: np.random.Generator) -> tuple[np.ndarray, float, str]:
    form = str(rng.choice(["uint8", "uint16", "int16", "float32", "float32 below zero"]))
    dark = rng.random() < 0.12
    air, plastic = {
        "uint8": (rng.uniform(20, 60), rng.uniform(140, 220)),
        "uint16": (rng.uniform(500, 20e3), rng.uniform(3e4, 6e4)),
        "int16": (-1000.0, rng.uniform(-120, 60)),
        "float32": (0.0, rng.uniform(0.01, 0.03)),
        "float32 below zero": (-rng.uniform(5, 9), -rng.uniform(0.5, 2)),
    }[form]
    if dark:
        air, plastic = plastic, air
    values = air + (plastic - air) * grey
    kind = np.dtype(form.split()[0])
    if kind.kind in "iu":
        values = np.clip(np.round(values), np.iinfo(kind).min, np.iinfo(kind).max)
        smooth = math.hypot(smooth, 0.1 / abs(plastic - air))
    return values.astype(kind), smooth, form + (", plastic dark" if dark else "")
