"""Where most of a weld or of a gap was not seen, what was seen of it was listed as bumps and losses. So were the rim of
a tee whose inside was dark, and light of one ring taken for another's (a bump 14 mm high and 7 wide). Fails without
`_nameless`."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, NOISE_MM, RADIUS_MM, bump, pocket, round_pipe, scan

from annulus_pipe.wall.defects import Defect, Kind, _nameless
from annulus_pipe.wall.standing import HOLLOW_WHY, ROUND_WHY, TALL_WHY, THROUGH_WHY
from annulus_pipe.wall.survey import Survey, survey

STATIONS = [4.8 * i for i in range(25) if i % 5 != 4]
AT_MM = 180.0
WINDOWS_DEG = 20.0, 150.0, 290.0  # of a joint, where it was seen
Z_MM, CLOCK_DEG = np.arange(1.0, 200.0, 2.0), np.arange(0.5, 360.0)


def surveyed(height_mm: float) -> Survey:
    """height_mm : how far two rolls stand inwards all round, less than 0 for a gap; seen through the windows only."""

    def stands(z: np.ndarray) -> np.ndarray:
        arm = np.abs(z - AT_MM) * 0.4 - 1.0
        return np.where(arm < 1.0, height_mm * np.sqrt(np.maximum(1.0 - arm * arm, 0.0)), 0.0)

    seen = []
    for one in scan(lambda c, z: round_pipe(c, z) - stands(z), z_mm=STATIONS, directions=360, seed=3):
        x, y, z = one.points_mm.T
        clock = np.degrees(np.arctan2(x, -y))
        hidden = np.all([np.abs((clock - middle + 180.0) % 360.0 - 180.0) > 10.0 for middle in WINDOWS_DEG], axis=0)
        seen.append(one.without(hidden & (np.abs(z - AT_MM) < 7.0), "swallowed"))
    sigma = np.array(NOISE_MM, np.float32)
    return survey([replace(one, sigma_mm=sigma[one.ring]) for one in seen], CALIBRATION)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("height_mm", [2.5, 1.2, -2.5])
def test_what_was_seen_of_a_joint_is_no_bump_and_no_loss(height_mm: float) -> None:
    pipe = surveyed(height_mm)
    near = [one for one in pipe.defects if one.z_range_mm[0] < AT_MM + 12 and one.z_range_mm[1] > AT_MM - 12]
    assert near == []
    named = [one.z_range_mm for one in (*pipe.detection.undecided, *pipe.features)]
    named += [(one.z_from_mm, one.z_to_mm) for one in pipe.unjudged if one.is_hole and not one.usual]
    assert any(first < AT_MM < last for first, last in named), "but something is there"


def test_what_stands_alone_keeps_its_name() -> None:
    profiles = scan(bump(pocket(round_pipe, 60, 9, 140, 152, 2.5), 200, 180, 14, 2.5), z_mm=STATIONS, directions=360)
    sigma = np.array(NOISE_MM, np.float32)
    pipe = survey([replace(one, sigma_mm=sigma[one.ring]) for one in profiles], CALIBRATION)
    assert [one.kind for one in pipe.defects] == [Kind.LOSS, Kind.BUMP]


def wall(seen: np.ndarray) -> Any:
    """A wall all of which is sound but what is named."""
    count = np.ones(seen.shape, np.int32)
    return cast(
        Any,
        SimpleNamespace(
            z_mm=Z_MM,
            clock_deg=CLOCK_DEG,
            clock_step_deg=1.0,
            z_step_mm=2.0,
            mean_radius_mm=RADIUS_MM,
            seen=seen,
            count=count,
        ),
    )


def defect(
    kind: Kind, depth_mm: float, *, length_mm: float = 20.0, arc_deg: float = 20.0, floor: bool = False
) -> Defect:
    return Defect(kind, 100.0, 90.0, length_mm, arc_deg, depth_mm, 0.0, floor)


@pytest.mark.parametrize(
    ("one", "part_sound", "part_seen", "why"),
    [
        (defect(Kind.BUMP, 2.0), 0.45, 1.0, ROUND_WHY),
        (defect(Kind.LOSS, 2.0), 0.45, 1.0, ROUND_WHY),
        (defect(Kind.LOSS, 2.0), 0.55, 1.0, ""),
        (defect(Kind.BUMP, 2.0, length_mm=40.0), 0.45, 1.0, ""),  # longer than any joint
        (defect(Kind.LOSS, 2.0, arc_deg=360.0), 0.0, 1.0, ""),  # a groove
        (defect(Kind.BUMP, 2.0), 1.0, 0.4, HOLLOW_WHY),
        (defect(Kind.BUMP, 2.0), 1.0, 0.6, ""),
        (defect(Kind.LOSS, 2.0), 1.0, 0.4, ""),  # its rim hides most of a pocket
        (defect(Kind.LOSS, 8.0), 1.0, 1.0, ""),  # half of a thick wall
        (defect(Kind.LOSS, 8.0), 1.0, 0.6, THROUGH_WHY),
        (defect(Kind.LOSS, 8.0, floor=True), 1.0, 0.6, ""),
        (defect(Kind.LOSS, 5.0), 1.0, 0.6, ""),
        (defect(Kind.BUMP, 14.0, arc_deg=5.0), 1.0, 1.0, TALL_WHY),
        (defect(Kind.BUMP, 7.5, arc_deg=5.0), 1.0, 1.0, ""),
    ],
)
def test_a_name_needs_its_form(one: Defect, part_sound: float, part_seen: float, why: str) -> None:
    seen = np.ones((len(Z_MM), len(CLOCK_DEG)), bool)
    inside = np.abs(CLOCK_DEG - one.clock_deg) <= one.arc_deg / 2
    rows = np.abs(Z_MM - one.z_mm) <= one.length_mm / 2
    seen[np.ix_(rows, inside)] = np.linspace(0.0, 1.0, np.count_nonzero(inside)) <= part_seen
    sound = np.zeros_like(seen)
    sound[:, ~inside] = np.linspace(0.0, 1.0, np.count_nonzero(~inside)) <= part_sound
    place = np.zeros_like(seen)
    place[rows] = inside
    assert _nameless(one, place, wall(seen), sound, np.zeros_like(seen), ~seen) == why


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("depth_mm", [2.5, -2.5])
def test_places_side_by_side_leave_each_other_their_names(depth_mm: float) -> None:
    radius = round_pipe
    for clock in (20, 80, 140, 200, 260, 320):
        radius = pocket(radius, clock, 18, 170, 185, depth_mm)
    sigma = np.array(NOISE_MM, np.float32)
    profiles = scan(radius, z_mm=[2.4 * i for i in range(80) if i % 5 != 4], directions=360)
    pipe = survey([replace(one, sigma_mm=sigma[one.ring]) for one in profiles], CALIBRATION)
    kind = Kind.LOSS if depth_mm > 0 else Kind.BUMP
    assert [one.kind for one in pipe.defects] == [kind] * 6


def test_a_bump_that_a_rod_crosses_is_one() -> None:
    profiles = scan(bump(round_pipe, 107, 180, 14, 4.0), z_mm=[2.4 * i for i in range(80) if i % 5 != 4])
    sigma = np.array(NOISE_MM, np.float32)
    pipe = survey([replace(one, sigma_mm=sigma[one.ring]) for one in profiles], CALIBRATION)
    assert {one.kind for one in pipe.defects} == {Kind.BUMP}
