"""Heads back to back (§3.5.1.2): what steps hide from a forward view, by how much less both views leave unseen."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from annulus_pipe.archive.there_and_back import Mount, placed
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.reprocess.engine import reprocess
from annulus_pipe.reprocess.job import looking_back, open_job
from annulus_pipe.twin.back_to_back import looking_back as backward_head
from annulus_pipe.twin.scan import write_scan
from annulus_pipe.twin.worlds import World, WorldFeature, clean_world
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.facing import DISAGREE, facing
from annulus_pipe.wall.survey import Survey
from tools.bench.table import Row

SEEDS = (621, 622, 623)  # held out: constants were set with 1, 2 and 7 of other drawings in view
TRAVEL_MM, FRAMES, WIDTH = 150.0, 76, 1024
APART_MM, MEASURED_MM = 180.0, 181.0  # of the mounting, and what the user says of it
FLOOR = 3.7  # of its depth: a shorter pocket has a floor that neither view sees whole (2 L_S of §3.5.1.2, widest ring)
WRONG = 1.06  # by which a badly calibrated head has its slide's distance
NEAR_MM, NEAR_DEG = 8.0, 10.0  # a defect that lies so near is the one that was drawn
NOTE = """
Pipes of pipe-a's kind drawn from held-out seeds: three pockets of 1.5 to 5 mm, longer than both shadows, one of them
behind a bump, two bumps and three rods, rendered for two heads with their own lenses, 180 mm apart, stated as 181.
"Hidden": cells of the forward view that a step keeps the light from. Coverage is of every cell that was seen, edges of
pockets included.
"""


@dataclass(frozen=True)
class Pair:
    world: World
    fore: Survey
    aft: Survey
    both: Survey


def drawn(seed: int) -> World:
    """Three pockets and two bumps; the first pocket begins in the lee of the first bump."""
    rng = np.random.default_rng(seed)
    base = rng.uniform(0.0, 360.0)
    things = []
    for i, kind in enumerate(("bump", "pocket", "bump", "pocket")):
        z, clock = rng.uniform(130.0, 225.0), (base + 90.0 * i + rng.uniform(-15.0, 15.0)) % 360.0
        if kind == "bump":
            things.append(WorldFeature("bump", z, rng.uniform(18.0, 30.0), rng.uniform(2.5, 5.0), clock, 20.0))
        else:
            arc, deep = rng.uniform(15.0, 40.0), rng.uniform(2.0, 5.0)
            long = FLOOR * deep + rng.uniform(4.0, 20.0)
            things.append(WorldFeature("pocket", z, long, deep, clock, arc))
    bump = things[0]
    behind = bump.z_mm + bump.length_mm / 2 + 5.0
    things.append(WorldFeature("pocket", behind, FLOOR * 1.5 + 4.0, 1.5, bump.clock_deg, 10.0))
    return replace(clean_world(seed, travel_mm=TRAVEL_MM), features=tuple(things)).scaled(WIDTH)


@cache
def pair(seed: int) -> Pair:
    world = drawn(seed)
    back, counted = backward_head(world, APART_MM)
    with TemporaryDirectory() as folder:
        one, other = Path(folder, "fore"), Path(folder, "aft")
        write_scan(world, one, FRAMES)
        write_scan(back, other, FRAMES, counted=counted)
        fore = reprocess(open_job(one, one / "calibration.json")).survey()
        aft = reprocess(looking_back(open_job(other, other / "calibration.json"))).survey()
    where = placed(fore, aft, Mount(MEASURED_MM), ("fore", "aft"))
    return Pair(world, fore, aft, facing(fore, aft, where, (world.calibration(), back.calibration())))


def rows() -> list[Row]:
    pairs = [pair(seed) for seed in SEEDS]
    picture(pairs[0])
    hidden = left = 0
    away, listed, alone, invented = [], 0, 0, 0
    places = []
    for one in pairs:
        here, there = common(one)
        dark = one.fore.shadowed[here]
        hidden += int(dark.sum())
        left += int((dark & ~one.both.wall.seen[there]).sum())
        away.append(of_k2(one))
        invented += int(unfounded(one))
        found, forward = (named(one.world, survey) for survey in (one.both, one.fore))
        listed, alone = listed + found, alone + forward
        assert one.both.views is not None
        views = one.both.views
        places.append(abs(views.moved_mm + APART_MM) / (2 * views.moved_sigma_mm))
        places.append(abs((views.turned_deg + 180.0) % 360.0 - 180.0) / (2 * views.turned_sigma_deg))
    less = 100.0 * (1.0 - left / hidden)
    covered = 100.0 * float((np.concatenate(away) <= 1.0).mean())
    drawn_things = sum(len(one.world.features) for one in pairs)
    unseen = [100.0 * np.mean([1.0 - survey_seen(one, which) for one in pairs]) for which in (False, True)]
    return [
        Row(
            "hidden cells, fewer with both views",
            "covered by the other",
            ">= 80 %",
            f"{less:.0f} % of {hidden}",
            less >= 80.0,
        ),
        Row("not seen, where both heads passed", "-", "-", f"{unseen[0]:.1f} % forward, {unseen[1]:.1f} % both"),
        Row("k = 2 of cells", "-", "93 .. 97 %", f"{covered:.1f} %", 93.0 <= covered <= 97.0, "95 %"),
        Row("cells with a value that no view saw", "-", "0", f"{invented}", invented == 0),
        Row(
            "defects listed",
            "-",
            "more than the forward view's",
            f"{listed} of {drawn_things}, forward {alone}",
            listed > alone,
        ),
        Row("distance and turn, off over k = 2", "-", "<= 1.5", f"{max(places):.2f}", max(places) <= 1.5),
        *refusals(pairs),
    ]


def common(one: Pair) -> tuple[BoolArray, BoolArray]:
    """Rows of the forward wall and of the common one that both heads passed."""
    return tuple(
        np.isin(a.z_mm.round(3), b.z_mm.round(3))
        for a, b in ((one.fore.wall, one.both.wall), (one.both.wall, one.fore.wall))
    )


def of_k2(one: Pair) -> FloatArray:
    """Of every seen cell, how far it is off over its k = 2."""
    wall = one.both.wall
    truth = one.world.radius_mm + one.world.deviation(wall.clock_deg[None], wall.z_mm[:, None])
    k2 = 2.0 * np.hypot(wall.sigma_mm, wall.cell_noise_mm)
    return np.asarray((np.abs(wall.radius_mm - truth) / k2)[wall.seen & np.isfinite(k2)], np.float64)


def unfounded(one: Pair) -> int:
    """Seen cells beside which, within a cell, neither view has one."""
    wall, views = one.both.wall, one.both.views
    assert views is not None
    fore = np.zeros(wall.seen.shape, bool)
    here, there = common(one)
    fore[there] = one.fore.wall.seen[here]
    back = one.aft.wall
    rows = np.rint((views.moved_mm - wall.z_mm - back.z_mm[0]) / back.z_step_mm).astype(int)
    columns = np.rint(views.turned_deg - wall.clock_deg - back.clock_deg[0]).astype(int) % 360
    near = np.zeros_like(fore)
    for i in (-1, 0, 1):
        inside = (rows + i >= 0) & (rows + i < len(back.z_mm))
        for j in (-1, 0, 1):
            near[inside] |= back.seen[(rows + i)[inside]][:, (columns + j) % 360]
    return int((wall.seen & ~fore & ~near).sum())


def named(world: World, survey: Survey) -> int:
    """How many of the world's defects a survey lists, of their kind and at their place."""
    count = 0
    for truth in (one.as_defect(world.radius_mm) for one in world.features):
        count += any(
            one.kind.value == truth["kind"]
            and abs(one.z_mm - truth["z_mm"]) < NEAR_MM
            and abs((one.clock_deg - truth["clock_deg"] + 180.0) % 360.0 - 180.0) < NEAR_DEG
            for one in survey.defects
        )
    return count


def survey_seen(one: Pair, both: bool) -> float:
    here, there = common(one)
    return float((one.both.wall.seen[there] if both else one.fore.wall.seen[here]).mean())


def refusals(pairs: list[Pair]) -> list[Row]:
    """What must not become one wall, and a head that is calibrated wrongly."""
    first, second = pairs[:2]
    tried = {
        "another pipe": (first.fore, second.aft),
        "views swapped": (first.aft, first.fore),
        "both look the same way": (first.fore, first.fore),
    }
    through = []
    for name, (fore, aft) in tried.items():
        try:
            placed(fore, aft, Mount(MEASURED_MM if name != "views swapped" else -MEASURED_MM - 30.0), ("fore", "aft"))
            through.append(name)
        except AnnulusError as error:
            print(f"  {name}: {error}")
    wall = first.aft.wall
    large = replace(
        first.aft, wall=replace(wall, radius_mm=np.float32(WRONG) * wall.radius_mm, shape_mm=WRONG * wall.shape_mm)
    )
    where = placed(first.fore, first.aft, Mount(MEASURED_MM), ("fore", "aft"))
    calibration = first.world.calibration()
    wrong = facing(first.fore, large, where, (calibration, calibration))
    warned = any(one.kind == DISAGREE for one in wrong.findings)
    kept = abs(wrong.diameter_mean_mm - first.both.diameter_mean_mm)
    false = sum(any(one.kind == DISAGREE for one in each.both.findings) for each in pairs)
    return [
        Row("refused: another pipe, swapped, same way", "-", "3 of 3", f"{3 - len(through)} of 3", not through),
        Row(
            "a head 6 % off: warned, diameter moved",
            "-",
            "yes, < 0.2 mm",
            f"{'yes' if warned else 'no'}, {kept:.2f} mm",
            warned and kept < 0.2,
        ),
        Row("warned of two heads that are right", "-", "0", f"{false} of {len(pairs)}", false == 0),
    ]


def picture(one: Pair) -> None:
    """Deviation of the forward, the backward and the common wall, not seen in grey."""
    import matplotlib.pyplot as plt

    from tools.bench.metrology import TABLE

    figure, axes = plt.subplots(2, 1, figsize=(9, 7), sharex=True, layout="constrained")
    for axis, survey, name in zip(axes, (one.fore, one.both), ("forward view alone", "both views"), strict=True):
        axis.set_facecolor("0.4")
        shown = axis.imshow(
            survey.wall.deviation_mm().T,
            extent=survey.wall.extent,
            aspect="auto",
            cmap="RdBu_r",
            vmin=-4,
            vmax=4,
            interpolation="nearest",
        )
        axis.set(
            title=f"{name}: not seen {100 * (1 - survey_seen(one, name == 'both views')):.1f} % of what both passed",
            ylabel="clock, degrees",
        )
    axes[-1].set_xlabel("z, mm")
    figure.colorbar(shown, ax=axes, label="deviation, mm; grey: not seen")
    figure.savefig(TABLE.pictures / "back.png", dpi=100)
    plt.close(figure)
