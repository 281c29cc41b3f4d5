"""The true diameters, circumferences and ovality of a pipe, station by station as stations.csv has them."""

from collections.abc import Iterator

import numpy as np

from tools.bench.blind.pipe import Scene
from tools.bench.blind.places import place_of
from tools.bench.blind.results import Results
from tools.bench.blind.surface import NO_WALL, Array, Surface

CLOCK = np.arange(360.0)
COLUMNS = {
    "diameter_mean_mm": ("diameter, mean", "diameter_k2_mm"),
    "diameter_min_mm": ("diameter, least", "diameter_k2_mm"),
    "diameter_max_mm": ("diameter, greatest", "diameter_k2_mm"),
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
        true = station(surface, z - half, z + half)
        where = place_of(scene, (z - half, z + half), 0.0, 360.0, seen)
        for name, (what, k2_name) in COLUMNS.items():
            said, k2 = float(table[name][i]), float(table[k2_name][i])
            if np.isfinite(said) and np.isfinite(k2):
                yield what, where, said, k2, true[name]


def station(surface: Surface, first: float, last: float) -> dict[str, float]:
    """The true numbers of one station, by the names of stations.csv."""
    z = np.linspace(first, last, 7)[1:-1]
    rows = surface.radius(CLOCK[None, :], z[:, None])
    radius = np.median(rows, axis=0)
    hands = np.median(np.stack([np.roll(radius, k) for k in (-1, 0, 1)]), axis=0)  # as it is measured: no needle
    diameter = hands[:180] + hands[180:]
    turn = np.radians(1.0)
    ahead = np.roll(radius, -1)
    arc = (turn / 2) / np.sin(turn / 2)
    line = arc * np.sqrt(radius**2 + ahead**2 - 2 * radius * ahead * np.cos(turn)).sum()
    return {
        "diameter_mean_mm": float(diameter.mean()), "diameter_min_mm": float(diameter.min()),
        "diameter_max_mm": float(diameter.max()), "diameter_x_mm": float(radius[90] + radius[270]),
        "diameter_y_mm": float(radius[0] + radius[180]), "circumference_mm": float(line),
        "area_mm2": float(0.5 * turn * (radius**2).sum()),
    }  # fmt: skip


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
