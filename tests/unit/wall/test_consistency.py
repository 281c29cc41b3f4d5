from dataclasses import replace

import numpy as np
import pytest
from synthetic_pipe import RADIUS_MM, bump, pocket, round_pipe, scan

from annulus_pipe.wall.consistency import without_inconsistent
from annulus_pipe.wall.profile import Profile


def with_false_arc(profile: Profile, ring: int, error_mm: float) -> Profile:
    """A tenth of one ring read off a shadow: points that agree with each other and with nobody else."""
    points = profile.points_mm.copy()
    arc = (profile.ring == ring) & (profile.direction < 72)
    points[arc, :2] *= 1 + error_mm / RADIUS_MM
    return replace(profile, points_mm=points)


@pytest.mark.parametrize("error_mm", [-14.0, -2.0, 2.0])
def test_an_arc_that_other_frames_contradict_is_dropped_and_counted(error_mm: float) -> None:
    profiles = scan(round_pipe)
    profiles[20] = with_false_arc(profiles[20], 2, error_mm)
    after = without_inconsistent(profiles)
    error = np.hypot(*after[20].points_mm[:, :2].T) - RADIUS_MM
    assert np.abs(error).max() < 1.0
    dropped = after[20].rejected["contradicted"]
    assert dropped == len(profiles[20].points_mm) - len(after[20].points_mm) >= 60


def test_who_is_contradicted_along_most_of_an_arc_is_not_believed_where_nobody_else_looked() -> None:
    profiles = scan(round_pipe, rods_deg=())
    false = with_false_arc(profiles[20], 2, -2.0)
    gone = false.points_mm[(false.ring == 2) & (false.direction < 12), :3].mean(axis=0)
    profiles = [p.without(np.linalg.norm(p.points_mm - gone, axis=1) < 12.0, "stain") for p in profiles]
    profiles[20] = false
    error = np.hypot(*without_inconsistent(profiles)[20].points_mm[:, :2].T) - RADIUS_MM
    assert np.abs(error).max() < 1.0


def test_many_noisy_points_do_not_vouch_for_one_against_few_that_are_sure() -> None:
    profiles = [
        replace(p, sigma_mm=np.array([1.0, 0.06, 0.04, 0.03, 0.02], np.float32)[p.ring]) for p in scan(round_pipe)
    ]
    for i in range(15, 26):  # ring 0 is wrong alike in a fourth of the frames
        profiles[i] = with_false_arc(profiles[i], 0, 2.0)
    after = without_inconsistent(profiles)
    left = sum(np.count_nonzero(np.hypot(*p.points_mm[:, :2].T) - RADIUS_MM > 1.5) for p in after)
    assert left < 0.1 * 11 * 72


def test_a_real_defect_is_no_contradiction() -> None:
    profiles = scan(bump(pocket(round_pipe, 90, 12, 130, 165, 5.0), 270, 150, 12.0, 4.0))
    after = without_inconsistent(profiles)
    before_points, after_points = (np.concatenate([p.points_mm for p in some]) for some in (profiles, after))
    for low, high in ((RADIUS_MM + 4.5, np.inf), (0.0, RADIUS_MM - 3.0)):
        count = [
            np.count_nonzero((np.hypot(*p[:, :2].T) > low) & (np.hypot(*p[:, :2].T) < high))
            for p in (before_points, after_points)
        ]
        assert count[0] > 100 and count[1] >= 0.97 * count[0]


def test_where_one_frame_looks_alone_nothing_is_dropped() -> None:
    profiles = scan(round_pipe)[20:21]
    alone = [with_false_arc(profiles[0], 2, -5.0)]
    assert without_inconsistent(alone)[0] is alone[0]
    assert without_inconsistent([]) == ()
