"""Two views of one wall, a forward and a backward one: what each hides the other shows, and nothing else is made up.

The scans are drawn by rays that march to the wall here, so that shadows are those of geometry and of no renderer.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from annulus_pipe.archive.there_and_back import Mount, placed
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.facing import DISAGREE, facing
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey, survey

RADIUS, STEP_MM, FRAMES, APART = 76.2, 2.0, 66, 180.0
TUBE = 56.0
FINE_MM = 0.2  # of the rays
ANGLES = (37.9, 42.4, 47.5, 52.8, 57.7)
LENGTH = 380.0  # the backward head stands at LENGTH - z of the wall
Wall = Callable[[FloatArray, FloatArray], FloatArray]
HEAD = Calibration(
    Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5),
    "RRGBGR",
    tuple(Cone(math.radians(one / 2), (0.0, 0.0, 1.0), (0.0, 0.0, -TUBE)) for one in ANGLES),
    RADIUS,
)


def dented(seed: int) -> Wall:
    """Two pockets and two domes, from a seed; none at the ends of the scan."""
    rng = np.random.default_rng(seed)
    base = rng.uniform(0.0, 360.0)
    things = [
        (
            kind,
            rng.uniform(160.0, 215.0),
            base + 90.0 * i + rng.uniform(-15.0, 15.0),
            rng.uniform(14.0, 30.0),
            rng.uniform(3.0, 5.0),
        )
        for i, kind in enumerate(("pocket", "dome", "pocket", "dome"))
    ]

    def wall(clock: FloatArray, z: FloatArray) -> FloatArray:
        out = np.full(np.broadcast_shapes(clock.shape, z.shape), RADIUS)
        for kind, at, towards, long, deep in things:
            round_mm = np.radians((clock - towards + 180.0) % 360.0 - 180.0) * RADIUS
            if kind == "pocket":
                out = out + deep * ((np.abs(z - at) < long / 2) & (np.abs(round_mm) < 18.0))
            else:
                out = out - deep * np.sqrt(np.maximum(1.0 - ((z - at) ** 2 + round_mm**2) / (long / 2) ** 2, 0.0))
        return out

    return wall


def bare(clock: FloatArray, z: FloatArray) -> FloatArray:
    return np.full(np.broadcast_shapes(clock.shape, z.shape), RADIUS)


def turned(wall: Wall, roll_deg: float = 0.0) -> Wall:
    """As the backward head has it, which is turned by roll_deg to the other."""
    return lambda clock, z: wall(roll_deg - clock, LENGTH - z)


def scan(wall: Wall, seed: int) -> list[Profile]:
    rng = np.random.default_rng(seed)
    clock = np.arange(0.0, 360.0, 2.0)
    ahead = np.arange(0.0, 170.0, FINE_MM)
    table = wall(clock[:, None], np.arange(0.0, FRAMES * STEP_MM + 170.0, FINE_MM)[None])
    out = []
    for number in range(FRAMES):
        z0 = number * STEP_MM
        points, rings = [], []
        before = table[:, round(z0 / FINE_MM) :][:, : len(ahead)]
        for ring, angle in enumerate(ANGLES):
            reach = (ahead + TUBE) * math.tan(math.radians(angle / 2))
            hit = (reach[None, :] >= before) & (reach > RADIUS - 8.0)
            at = hit.argmax(axis=1)
            lit, radius = z0 + ahead[at], before[np.arange(len(clock)), at]
            steep = np.abs(reach[at] - radius) > 0.3  # the riser of a step: light runs along it
            ok = hit.any(axis=1) & ~steep
            radius = radius + rng.normal(0.0, 0.03, len(radius))
            at = np.radians(clock)
            points.append(np.stack([radius * np.sin(at), -radius * np.cos(at), lit], axis=1)[ok])
            rings.append(np.full(np.count_nonzero(ok), ring, np.uint8))
        xyz, ring_of = np.concatenate(points).astype(np.float32), np.concatenate(rings)
        out.append(
            Profile(
                number,
                z0,
                Pose(),
                xyz,
                np.zeros((len(xyz), 3), np.uint8),
                ring_of,
                np.zeros(len(xyz), np.uint16),
                0.03,
                sigma_mm=np.full(len(xyz), 0.03, np.float32),
                lean_sigma_deg=0.01,
                ring_sigma_mm=np.full((len(ANGLES), 2), 0.005, np.float32),
            )
        )
    return out


def _along(one: Profile, by_mm: float) -> Profile:
    return replace(one, z_mm=one.z_mm + by_mm, points_mm=one.points_mm + np.array([0, 0, by_mm], np.float32))


@cache
def forward(seed: int) -> Survey:
    return survey(scan(dented(seed) if seed else bare, 1), HEAD, z_step_mm=1.0)


@cache
def views(seed: int, roll_deg: float = 0.0) -> tuple[Survey, Survey]:
    """Forward and backward, z of both on the carrier's odometer, the backward one's negated."""
    wall = dented(seed) if seed else bare
    back = scan(turned(wall, roll_deg), 2)
    moved = LENGTH + APART
    back = [_along(one, -moved) for one in back]
    return forward(seed), survey(back, HEAD, z_step_mm=1.0)


@cache
def joined(seed: int, roll_deg: float = 0.0) -> Survey:
    fore, aft = views(seed, roll_deg)
    return facing(fore, aft, placed(fore, aft, Mount(APART), ("fore", "aft")), (HEAD, HEAD))


def of_truth(both: Survey, seed: int) -> FloatArray:
    return dented(seed)(both.wall.clock_deg[None], both.wall.z_mm[:, None])


def test_what_a_step_hides_from_one_view_the_other_shows() -> None:
    fore, both = views(7)[0], joined(7)
    here = np.isin(both.wall.z_mm.round(2), fore.wall.z_mm.round(2))
    hidden = fore.shadowed[np.isin(fore.wall.z_mm.round(2), both.wall.z_mm.round(2))]
    left = hidden & ~both.wall.seen[here]
    assert hidden.sum() > 150
    assert left.sum() <= 0.2 * hidden.sum()
    assert both.views is not None and both.views.not_seen < both.views.not_seen_alone


def test_no_cell_has_a_value_that_no_view_saw() -> None:
    """Each seen cell is one that either view has, by its own place."""
    (fore, aft), both = views(7), joined(7)
    where = placed(fore, aft, Mount(APART), ("fore", "aft"))
    rows = np.rint(where.rows_at(both.wall.z_mm)).clip(-1, len(aft.wall.z_mm))
    for i, z in enumerate(both.wall.z_mm):
        mine = np.flatnonzero(np.abs(fore.wall.z_mm - z) < 0.01)
        of_fore = fore.wall.seen[mine[0]] if len(mine) else np.zeros(360, bool)
        of_aft = np.zeros(360, bool)
        if np.isfinite(rows[i]):
            near = aft.wall.seen[max(int(rows[i]) - 1, 0) : int(rows[i]) + 2].any(axis=0)
            columns = np.rint(where.roll_deg[0] - both.wall.clock_deg - aft.wall.clock_deg[0]).astype(int) % 360
            of_aft = (near | np.roll(near, 1) | np.roll(near, -1))[columns]
        assert not (both.wall.seen[i] & ~of_fore & ~of_aft).any()


def test_k2_holds_for_what_both_make_together() -> None:
    both = joined(7)
    away = np.abs(both.wall.radius_mm - of_truth(both, 7))
    k2 = 2 * np.hypot(both.wall.sigma_mm, both.wall.cell_noise_mm)
    seen = both.wall.seen
    assert (away[seen] <= k2[seen]).mean() > 0.93


def test_sizes_of_pockets_are_whole() -> None:
    """Of the length that the forward view hides nothing stays hidden."""
    hidden = [one.shadowed_mm for one in views(7)[0].defects if one.kind == "loss"]
    assert max(hidden) >= 3.0
    assert max(one.shadowed_mm for one in joined(7).defects if one.kind == "loss") <= 1.0


@pytest.mark.parametrize("roll_deg", [0.0, pytest.param(37.0, marks=pytest.mark.deep)])
def test_the_turn_between_the_heads_is_found(roll_deg: float) -> None:
    both = joined(7, roll_deg)
    assert both.views is not None and both.views.matched
    off = (both.views.turned_deg - roll_deg + 180.0) % 360.0 - 180.0
    assert abs(off) <= 3.0 * both.views.turned_sigma_deg
    assert abs(both.views.moved_mm + APART) <= 3.0 * both.views.moved_sigma_mm


@pytest.mark.deep(gate="tests/unit/archive/test_there_and_back.py::test_a_view_that_looks_the_same_way_is_refused")
def test_another_pipe_is_refused() -> None:
    with pytest.raises(AnnulusError, match=r"not found on that of|not that of"):
        placed(views(7)[0], views(8)[1], Mount(APART), ("fore", "aft"))


@pytest.mark.deep(gate="tests/unit/archive/test_there_and_back.py::test_a_view_that_looks_the_same_way_is_refused")
def test_views_that_were_swapped_are_refused() -> None:
    """The backward scan given as the forward one: its places run against the way it looks."""
    moved = LENGTH + APART
    wrong = [_along(one, moved - 2 * one.z_mm) for one in scan(turned(dented(7)), 2)]
    other = [_along(one, -2 * one.z_mm) for one in scan(dented(7), 1)]
    with pytest.raises(AnnulusError, match=r"^fore: .* of aft"):
        placed(survey(wrong, HEAD, z_step_mm=1.0), survey(other, HEAD, z_step_mm=1.0), Mount(APART), ("aft", "fore"))


def test_a_view_that_looks_the_same_way_is_refused() -> None:
    with pytest.raises(AnnulusError, match=r"^again: "):
        placed(views(7)[0], views(7)[0], Mount(APART), ("fore", "again"))


def test_a_bare_pipe_needs_the_mounting() -> None:
    """Of a bare pipe, which is its own mirror image."""
    one = forward(0)
    apart = -float(one.wall.z_mm[0] + one.wall.z_mm[-1])
    with pytest.raises(AnnulusError, match="how the heads are turned"):
        placed(one, one, Mount(apart), ("fore", "aft"))
    both = facing(one, one, placed(one, one, Mount(apart, 0.0), ("fore", "aft")), (HEAD, HEAD))
    assert both.views is not None and not both.views.matched
    assert not both.defects


def test_a_head_that_is_calibrated_wrongly_is_reported_and_not_averaged() -> None:
    fore, aft = views(7)
    wall = aft.wall
    large = replace(wall, radius_mm=np.float32(1.06) * wall.radius_mm, shape_mm=1.06 * wall.shape_mm)
    where = placed(fore, aft, Mount(APART), ("fore", "aft"))
    wrong = facing(fore, replace(aft, wall=large), where, (HEAD, HEAD))
    assert any(one.kind == DISAGREE for one in wrong.findings)
    assert abs(wrong.diameter_mean_mm - fore.diameter_mean_mm) < 0.1
    assert wrong.wall.scale_part > fore.wall.scale_part
    assert not any(one.kind == DISAGREE for one in joined(7).findings)


def test_sizes_that_both_scales_explain_blame_no_head() -> None:
    fore, aft = views(7)
    wall = aft.wall
    large = replace(wall, radius_mm=np.float32(1.008) * wall.radius_mm, shape_mm=1.008 * wall.shape_mm)
    both = facing(fore, replace(aft, wall=large), placed(fore, aft, Mount(APART), ("fore", "aft")), (HEAD, HEAD))
    assert both.views is not None and abs(both.views.size_mm) < both.views.size_k2_mm
    assert not any(one.kind == DISAGREE for one in both.findings)


def test_what_is_common_to_both_is_not_counted_twice() -> None:
    """Of one calibration its share of a sigma stays; of two it shrinks as of two that are independent."""
    fore, aft = views(7)
    where = placed(fore, aft, Mount(APART), ("fore", "aft"))
    two, one = (facing(fore, aft, where, (HEAD, HEAD), one_head=same) for same in (False, True))
    mine = np.isin(two.wall.z_mm.round(2), fore.wall.z_mm.round(2))
    alone = float(np.nanmedian(fore.wall.sigma_mm))
    assert np.nanmedian(two.wall.sigma_mm[mine]) < 0.85 * alone
    assert np.nanmedian(one.wall.sigma_mm[mine]) > 0.9 * alone
