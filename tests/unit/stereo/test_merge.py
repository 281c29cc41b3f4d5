"""What is made of slits that two cameras see, where one says too little, or an edge of the wall runs through it."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_head import RADIUS_MM, head
from numpy.typing import NDArray

from annulus_pipe.stereo.merge import EDGE, KNOWN, Merged, Sight, merge
from annulus_pipe.stereo.points import to_pipe
from annulus_pipe.stereo.reconstructor import generators, usual_pose
from annulus_pipe.stereo.view import view_of

NOISE_PX, MOST_MM = 0.03, 1.5
HEAD = head()
POSE = usual_pose(HEAD)
VIEWS = [view_of(HEAD, one, POSE, 720) for one in HEAD.cameras]
CONES, WAYS = generators(HEAD, 720)
VERTICES = CONES[:, :3]
START = to_pipe(VERTICES, POSE, WAYS, RADIUS_MM)
EXPECTED = [view.expect(CONES, WAYS, START, POSE) for view in VIEWS]
Lines = NDArray[np.float64]


def seen(beyond_mm: Lines, seed: int = 1) -> list[Sight]:
    """Slits of a wall that lies (K, P) mm beyond a clean pipe's, along its generators; to first order."""
    random = np.random.default_rng(seed)
    out = []
    for e in EXPECTED:
        place = np.array(e.course)
        for k, row in enumerate(place):
            slope = np.gradient(row)
            line = e.line[k]
            gain = e.place_by_mm[k] - np.interp(line, np.arange(720), slope, period=720) * e.line_by_mm[k]
            order = np.argsort(line)
            row += np.interp(np.arange(720), line[order], (gain * beyond_mm[k])[order], period=720)
        place += random.normal(0.0, NOISE_PX, place.shape)
        sigma, none = np.full(place.shape, NOISE_PX), np.zeros(place.shape)
        out.append(Sight(place, sigma, none, 0.01))
    return out


def solved(sights: list[Sight], cameras: slice = slice(None)) -> Merged:
    return merge(
        VIEWS[cameras], EXPECTED[cameras], sights[cameras], VERTICES, WAYS, START, np.full(len(CONES), MOST_MM)
    )


@pytest.mark.parametrize("camera", [0, 1])
def test_beside_its_tangents_one_camera_knows_the_wall_by_its_neighbours(camera: int) -> None:
    slope = 2.0 * np.sin(np.arange(720) * (2 * np.pi / 180))  # 2 mm out and in, four times round
    beyond = np.tile(slope, (len(CONES), 1))
    found = solved(seen(beyond), slice(camera, camera + 1))
    known = found.state == KNOWN
    off = (found.distance_mm - START - beyond)[known]
    assert known.mean() > 0.94  # 0.96 measured; single directions alone 0.93
    assert 0.9 < np.mean(np.abs(off) < 2 * found.sigma_mm[known]) <= 0.995
    assert np.mean(np.abs(off) > 5 * found.sigma_mm[known]) < 0.001


def across(sights: list[Sight], k: int, directions: NDArray[np.int64], by_px: float) -> list[Sight]:
    """The same slits, but of one ring and some directions with one edge off, and so its middle by half of that."""
    out = []
    for e, sight in zip(EXPECTED, sights, strict=True):
        place, edge, sigma = np.array(sight.place), np.array(sight.edge_px), np.array(sight.sigma_px)
        lines = np.rint(e.line[k, directions]).astype(int) % 720
        place[k, lines] += by_px / 2
        edge[k, lines] = by_px / 2 / np.sqrt(3)
        sigma[k, lines] = np.hypot(sigma[k, lines], edge[k, lines])
        out.append(replace(sight, place=place, edge_px=edge, sigma_px=sigma))
    return out


def test_a_mark_on_the_wall_is_bridged_and_a_step_is_not() -> None:
    """Ink beside a few slits moves their edges; where all around are moved, none says where the wall is."""
    clean = seen(np.zeros(START.shape))
    mark, step = np.arange(100, 104), np.arange(300, 330)
    found = solved(across(across(clean, 3, mark, 1.5), 3, step, 1.5))
    assert (found.state[3, mark] == KNOWN).all()
    assert np.abs((found.distance_mm - START)[3, mark]).max() < 0.5
    assert (found.state[3, step[8:-8]] == EDGE).all()
    assert np.isnan(found.distance_mm[3, step[8:-8]]).all()
    assert (found.state[:3] == KNOWN).all()
