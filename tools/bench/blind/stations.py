"""The true diameters, circumferences and ovality of a pipe, station by station as stations.csv has them."""

from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from tools.bench.blind.pipe import Scene
from tools.bench.blind.places import place_of
from tools.bench.blind.results import Results
from tools.bench.blind.surface import NO_WALL, Array, Surface

CLOCK = np.arange(360.0)
EVEN_DEG = 5  # circumference and area are those of a line evened out over so much; a tape is stiffer
HALF_SEEN = 0.5 - 1e-9  # as stations.csv has it
COLUMNS = {
    "diameter_mean_mm": ("diameter, mean", "diameter_k2_mm"),
    "diameter_min_mm": ("diameter, least", "diameter_min_k2_mm"),
    "diameter_max_mm": ("diameter, greatest", "diameter_max_k2_mm"),
    "diameter_x_mm": ("diameter, x and y", "diameter_k2_mm"),
    "diameter_y_mm": ("diameter, x and y", "diameter_k2_mm"),
    "circumference_mm": ("circumference", "circumference_k2_mm"),
    "area_mm2": ("area", "area_k2_mm2"),
}


def station_numbers(scene: Scene, results: Results, surface: Surface) -> Iterator[tuple[str, str, float, float, float]]:
    """(what, where, said, k2, true) of every number of every station where the wall is whole."""
    table, seen = results.stations, (results.from_mm, results.to_mm)
    if not table or len(table["z_mm"]) < 2:
        return
    half = float(np.median(np.diff(table["z_mm"]))) / 2
    for i, z in enumerate(table["z_mm"]):
        if any(one.kind in NO_WALL and abs(one.z_mm - z) < one.length_mm / 2 + 2 * half for one in scene.pipe.things):
            continue
        true = station(surface, z - half, z + half, seen_columns(results, z - half, z + half))
        where = place_of(scene, (z - half, z + half), 0.0, 360.0, seen)
        for name, (what, k2_name) in COLUMNS.items():
            reported, k2 = float(table[name][i]), float(table[k2_name][i])
            if np.isfinite(reported) and np.isfinite(k2):
                yield what, where, reported, k2, true[name]


def seen_columns(results: Results, first: float, last: float) -> Array:
    """(360,) 0..1, of CLOCK: of a station's map about each clock, a column either side, which part has a wall."""
    rows = (results.seen_z_mm >= first) & (results.seen_z_mm <= last)
    if not rows.any():
        return np.ones(len(CLOCK))
    seen = ndimage.uniform_filter1d(results.seen[rows].mean(axis=0), 3, mode="wrap")
    return np.asarray(seen[(CLOCK * len(seen) / len(CLOCK)).astype(int)])


def station(surface: Surface, first: float, last: float, seen: Array | None = None) -> dict[str, float]:
    """The true numbers of one station, by the names of stations.csv: the least and greatest diameter of those whose
    ends were half `seen`, (360,) 0..1, or seen at all where none was, and the line with radii evened out over EVEN_DEG,
    as both are said to be."""
    z = np.linspace(first, last, 7)[1:-1]
    rows = surface.radius(CLOCK[None, :], z[:, None])
    radius = np.median(rows, axis=0)
    hands = np.median(np.stack([np.roll(radius, k) for k in (-1, 0, 1)]), axis=0)  # as it is measured: no needle
    diameter = hands[:180] + hands[180:]
    both = np.ones(180) if seen is None else np.minimum(seen[:180], seen[180:])
    ends = next((diameter[one] for one in (both >= HALF_SEEN, both > 0.0) if one.any()), diameter)
    turn = np.radians(1.0)
    even = ndimage.uniform_filter1d(radius, EVEN_DEG, mode="wrap")
    ahead = np.roll(even, -1)
    arc = (turn / 2) / np.sin(turn / 2)
    line = arc * np.sqrt(even**2 + ahead**2 - 2 * even * ahead * np.cos(turn)).sum()
    return {
        "diameter_mean_mm": float(diameter.mean()),
        "diameter_min_mm": float(ends.min()),
        "diameter_max_mm": float(ends.max()),
        "diameter_x_mm": float(radius[90] + radius[270]),
        "diameter_y_mm": float(radius[0] + radius[180]),
        "circumference_mm": float(line),
        "area_mm2": float(0.5 * turn * (radius**2).sum()),
    }


def _diameters(surface: Surface, first: float, last: float) -> Array:
    """(Z, 180) mm, of the pipe's shape without what is on it."""
    rows = surface.shape(CLOCK[None, :], np.linspace(first, last, 41)[:, None])
    return np.asarray(rows[:, :180] + rows[:, 180:])


def worst_ovality(surface: Surface, first: float, last: float) -> float:
    """Percent, ASTM F1216, of the shape; the worst there is between two stations."""
    diameter = _diameters(surface, first, last)
    mean = diameter.mean(axis=1)
    return float((100.0 * np.maximum(diameter.max(axis=1) - mean, mean - diameter.min(axis=1)) / mean).max())


def departure_mm(surface: Surface, first: float, last: float) -> float:
    """mm by which a diameter departs most from the mean one of its station, anywhere between two."""
    diameter = _diameters(surface, first, last)
    mean = diameter.mean(axis=1)
    return float(np.maximum(diameter.max(axis=1) - mean, mean - diameter.min(axis=1)).max())
