"""The source's three pipes a thousand times, and pipes drawn by the twin; beside a threshold on any one sector."""

import math

import numpy as np
from scipy.ndimage import median_filter

from annulus_pipe.wings.crossbore.ground import Bore, Ground, log, some_ground
from annulus_pipe.wings.crossbore.measure import BoreKind, detect, on_grid
from annulus_pipe.wings.crossbore.measure.grid import STEP_MM, PipeGrid
from tools.bench.crossbore.odds import fate, others, promised
from tools.bench.table import Row

RUNS = 1000
PIPES, SEED = 60, 3000
OTHER_HELD_OUT = range(9000, 9010)  # an odd seed of the other drawer, never looked at
THRESHOLD_FF = 60.0  # what a user would set who sees sewers of 100 to 250 fF
NOTE = """
Drawn by the twin: a pipe of 3 inch in loam, an 8-inch sewer in random directions; A passes through its middle, B half
into it, C 50 mm beside. `threshold`: any sector 60 fF below its running median over 1.2 m, on the same even grid.
The odds are the mean of two drawers' counts (crossbore/odds.py); they are held against pipes of both that nobody
counted, and say nothing of a street.
"""


def rows() -> list[Row]:
    table = []
    for fill in ("air", "water"):
        for pipe, offset in (("A", 0.0), ("B", 101.0), ("C", 195.5)):
            table.append(_thousand(pipe, offset, fill))
    for pose in (False, True):
        table += _drawn(pose)
    return [*table, _other()]


def _thousand(pipe: str, offset: float, fill: str) -> Row:
    rng = np.random.default_rng(7)
    found = air = plain = 0
    off = []
    for seed in range(RUNS):
        phi = float(rng.uniform(-20, 200))  # not from straight above: that is a sewer half full
        bore = Bore(2000.0, 101.0, offset, phi, float(rng.uniform(60, 90)), fill)
        grid = on_grid(log(Ground(4000.0, bores=(bore,), uneven=0.06), seed).rows())
        bores = detect(grid).bores
        found += bool(bores)
        air += any(one.kind is BoreKind.AIR for one in bores)
        off += [(one.phi_deg - phi + 180) % 360 - 180 for one in bores if one.kind is BoreKind.AIR]
        plain += bool(_threshold(grid))
    told = np.array(off)[np.isfinite(off)]
    turned = f"; direction {np.sqrt(np.mean(told**2)):.0f} deg rms" if pipe == "B" and len(told) else ""
    asked, met = "-", None
    if pipe == "C":
        asked, met = "never", found == 0
    elif fill == "air":
        asked = "all" if pipe == "A" else "all; direction right"
        met = air == RUNS and (pipe == "A" or bool(np.percentile(np.abs(told), 99) < 45))
    return Row(
        f"pipe {pipe}, {fill}: found of {RUNS}; as air", f"threshold {plain}", asked, f"{found}; {air}{turned}", met
    )


def _drawn(pose: bool) -> list[Row]:
    hit = count = false = near = beside = right = named = plain_false = plain_hit = 0
    metres = 0.0
    off: list[float] = []
    said: list[tuple[float, bool]] = []
    for seed in range(SEED, SEED + PIPES):
        drawn = log(some_ground(30_000.0, seed, pose=pose, loss=pose), seed)
        truth = drawn.truth()
        grid = on_grid(drawn.rows())
        account = detect(grid)
        metres += 30.0
        said += [promised(one, fate(drawn, one)) for one in account.indications if one.odds]
        places = [(bore, 0.5 * (bore["odo0_mm"] + bore["odo1_mm"])) for bore in truth["bores"]]
        plain = _threshold(grid)
        for bore, place in places:
            mine = [one for one in account.bores if abs(one.odometer_mm - place) < 150]
            named += bool(mine)
            right += bool(mine) and str(mine[0].kind) == bore["kind"]
            if bore["kind"] != "water":
                count += 1
                hit += bool(mine)
                plain_hit += any(abs(one - place) < 150 for one in plain)
                off += [one.odometer_mm - place for one in mine]
        far = [one.odometer_mm for one in account.bores if all(abs(one.odometer_mm - p) > 250 for _, p in places)]
        misses = [one["odometer_mm"] for one in truth["near"]]
        near += len(misses)
        beside += sum(any(abs(one - miss) < 120 for miss in misses) for one in far)
        false += sum(all(abs(one - miss) >= 120 for miss in misses) for one in far)
        plain_false += sum(all(abs(one - p) > 250 for _, p in places) for one in plain)
    what = "twin, pose and loss" if pose else "twin, neither pose nor loss"
    return [
        Row(
            f"{what}: air and half full, found; false in 100 m",
            f"threshold {100 * plain_hit / count:.0f} %; {100 * plain_false / metres:.1f}",
            ">= 90 %; <= 0.25",
            f"{hit} of {count}; {100 * false / metres:.2f}",
            hit >= 0.9 * count and 100 * false / metres <= 0.25,
        ),
        _kept(f"{what}: probability of what is said, mean; right", said),
        Row(f"{what}: near misses reported", "-", "0", f"{beside} of {near}", beside == 0),
        Row(
            f"{what}: kind right; position, rms",
            "-",
            "-",
            f"{right} of {named}; {np.sqrt(np.mean(np.square(off))):.1f} mm",
        ),
    ]


def _other() -> Row:
    """The odds in the other drawer's pipes that nobody counted."""
    said = [promised(one, real) for one, real in others(OTHER_HELD_OUT) if one.odds]
    return _kept("another drawer's pipes: probability of what is said, mean; right", said)


def _kept(what: str, said: list[tuple[float, bool]]) -> Row:
    """Odds are kept where as many are right as was said; what so many trials leave to chance (k = 2) stands beside."""
    mean, right = np.mean(said, axis=0)
    chance = 2 * math.sqrt(mean * (1 - mean) / len(said))
    return Row(
        what,
        "-",
        "within 3 %",
        f"{100 * mean:.1f} %; {100 * right:.1f} % of {len(said)} (chance {100 * chance:.1f} %)",
        bool(abs(right - mean) < 0.03),
    )


def _threshold(grid: PipeGrid) -> list[float]:
    """Places, mm, where any sector falls so far below its running median; one each 150 mm."""
    below = grid.c_ff - median_filter(grid.c_ff, (round(1200 / STEP_MM) | 1, 1), mode="nearest")
    places: list[float] = []
    for z in grid.z_mm[(below < -THRESHOLD_FF).any(axis=1)]:
        if not places or z - places[-1] > 150:
            places.append(float(z))
    return places
