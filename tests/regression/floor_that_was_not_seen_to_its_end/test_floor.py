"""A pocket of 3.0 mm beside a joint was listed as 0.63 +- 0.36 mm without ">=": what of its floor was seen was its
shallow part, or the joint's light. Fails without `_is_cut_off`; the deep claim of one look without
`_agreed`, the last rows' without `_only_at_an_end`."""

from dataclasses import replace

import numpy as np
import pytest
from over_limit import scanned
from synthetic_pipe import CALIBRATION, SHADOW_RATIO, RadiusMap, pocket, round_pipe

from annulus_pipe.wall.defects import _agreed, find_defects
from annulus_pipe.wall.grid import build_wall
from annulus_pipe.wall.indications import Indication, Kind
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.standing import END_WHY
from annulus_pipe.wall.survey import survey

HERE = "tests/regression/floor_that_was_not_seen_to_its_end/test_floor.py"


def bead(inner: RadiusMap, at_mm: float) -> RadiusMap:
    return lambda c, z: inner(c, z) - 1.5 * np.sqrt(np.maximum(1.0 - ((z - at_mm) / 5.0) ** 2, 0.0))


def without(one: Profile, clock: tuple[float, float], z_mm: tuple[float, float]) -> Profile:
    x, y, z = one.points_mm.T
    away = np.abs((np.degrees(np.arctan2(x, -y)) - clock[0] + 180.0) % 360.0 - 180.0)
    return one.without((away < clock[1]) & (z > z_mm[0]) & (z < z_mm[1]), "swallowed")


def terrace(inner: RadiusMap, clock: float) -> RadiusMap:
    """3 mm deep in one half, 0.8 in the other."""
    return pocket(pocket(inner, clock, 9, 165, 190, 0.8), clock + 6, 3.5, 165, 190, 2.2)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("way", ["hole", "rod", "deeper behind", "end"])
def test_a_floor_that_goes_on_unseen_is_a_lower_limit(way: str) -> None:
    if way == "rod":
        profiles = scanned(terrace(round_pipe, 221.0))
    elif way == "hole":
        profiles = [without(one, (68.0, 6.5), (163.0, 192.0)) for one in scanned(terrace(round_pipe, 60.0))]
    elif way == "deeper behind":
        wall = pocket(pocket(round_pipe, 60, 8, 165, 195, 0.8), 60, 8, 178, 195, 2.2)
        profiles = [without(one, (60.0, 10.0), (176.0, 197.0)) for one in scanned(wall)]
    else:
        profiles = [
            without(one, (0.0, 200.0), (0.0, 168.0)) for one in scanned(pocket(round_pipe, 60, 8, 150, 174, 2.0))
        ]
    pipe = survey(profiles, CALIBRATION)
    (one, *_) = (*pipe.defects, *pipe.detection.undecided)
    assert not one.floor_seen and one.depth_mm - one.depth_k2_mm < 3.0


@pytest.mark.deep(gate=f"{HERE}::test_a_floor_that_goes_on_unseen_is_a_lower_limit")
@pytest.mark.parametrize("after_mm", [4.0, 2.0, 6.0, 9.0])
def test_a_pocket_beside_a_joint_has_its_depth_or_a_lower_limit(after_mm: float) -> None:
    pipe = survey(scanned(bead(pocket(round_pipe, 60, 9, 181 + after_mm, 193 + after_mm, 3.0), 176.0)), CALIBRATION)
    for one in pipe.defects:
        off = one.depth_mm - 3.0
        assert off < one.depth_k2_mm and (not one.floor_seen or -off < one.depth_k2_mm), one


def test_a_floor_that_was_seen_is_no_lower_limit() -> None:
    pipe = survey(scanned(pocket(round_pipe, 60, 9, 165, 190, 2.0)), CALIBRATION)
    (one,) = pipe.defects
    assert one.floor_seen and abs(one.depth_mm - 2.0) < 0.1


def moved(one: Profile, which: np.ndarray, by_mm: float) -> Profile:
    x, y, z = one.points_mm.astype(np.float64).T
    scale = np.where(which, 1.0 + by_mm / np.hypot(x, y), 1.0)
    return replace(one, points_mm=np.stack([x * scale, y * scale, z], axis=1).astype(np.float32))


def test_what_one_look_alone_says_is_deeper_is_no_depth(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a pocket of 2 mm one ring of one frame read 3 mm more: 7.7 mm were listed of 4.1."""
    wall = build_wall(scanned(pocket(round_pipe, 60, 6, 172, 182, 2.0)))
    mask = (wall.z_mm > 172)[:, None] & (wall.z_mm < 182)[:, None] & (np.abs(wall.clock_deg - 60.0) < 6)[None, :]
    seen = wall.observations
    here = (mask & (wall.residual_mm() > 1.5)).ravel()[seen.cell]
    wild = seen.number == np.bincount(seen.number[here]).argmax()
    wrong = replace(seen, radius_mm=seen.radius_mm + np.float32(3.0) * (here & wild))
    place = Indication(Kind.LOSS, mask & wall.seen, wall.residual_mm(), wall.cell_noise_mm, wall.cell_noise_mm)
    sigma = np.full(len(seen.number), 0.02, np.float32)  # the wrong one is as sure of itself as the surest
    others, which = np.unique(seen.number[here & ~wild], return_inverse=True)
    sigma[here & ~wild] = 0.1 + 0.01 * which[: np.count_nonzero(here & ~wild)]
    pipe = replace(wall, observations=replace(wrong, sigma_mm=sigma))
    (alone, its), (depth, own) = _agreed(place, pipe, 1), _agreed(place, pipe, 2)
    assert alone > 4.5 and its == pytest.approx(0.02) and len(others) > 2
    assert abs(depth - 2.0) < 0.3 and own >= 0.1, "no surer than the look that reaches it"
    for known in (0.12, 0.9):  # of the look that reaches it
        monkeypatch.setattr("annulus_pipe.wall.defects._agreed", lambda *_, mm=known: (2.0, mm))
        (one,) = find_defects(pipe, shadow_ratio=SHADOW_RATIO).undecided
        assert one.depth_mm == 2.0 and 2 * known <= one.depth_k2_mm < 2.0


def test_what_the_last_rows_alone_show_is_no_loss() -> None:
    profiles = scanned(round_pipe)
    last = max(float(one.points_mm[:, 2].max()) for one in profiles)
    out = []
    for one in profiles:
        x, y, z = one.points_mm.T
        out.append(moved(one, (np.abs(np.degrees(np.arctan2(x, -y)) - 60.0) < 15) & (z > last - 5.0), 2.0))
    found = find_defects(build_wall(out), shadow_ratio=SHADOW_RATIO)
    assert found.defects == () and [one.why for one in found.undecided] == [END_WHY]
