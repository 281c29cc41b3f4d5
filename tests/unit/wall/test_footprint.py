"""The middle of a slit's light on a wall that bends."""

import math

import numpy as np
import pytest
from chained_pipe import frames
from synthetic_pipe import CALIBRATION

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.adjustment import PIECE, RADIUS, START, AdjustmentState, sightings
from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.footprint import centred

R = CALIBRATION.pipe_radius_mm
SLIT = math.radians(0.5)
HEAD = Pose(0.01, -0.006, 1.0, -0.5)
AT = 120.0
SLOPES = np.linspace(0.15, 1.6, 3000)


def slopes_of(line: Centreline, head: Pose, angles: np.ndarray, vertex_z: float, clock: float) -> np.ndarray:
    """Slopes of the camera's rays, towards one clock, that meet the wall where the light has these angles."""
    way = np.column_stack([SLOPES * math.cos(clock), SLOPES * math.sin(clock), np.ones_like(SLOPES)])
    low, high = np.zeros_like(SLOPES), np.minimum(1.8 * R / SLOPES, 350.0)
    for _ in range(40):
        middle = (low + high) / 2
        at = line.from_head(head.to_pipe(way * middle[:, None]), AT)
        out = np.hypot(at[:, 0], at[:, 1]) > R
        low, high = np.where(out, low, middle), np.where(out, middle, high)
    angle = np.arctan2(SLOPES * low, low - vertex_z)
    falls = np.flatnonzero(np.diff(angle) <= 0)  # beyond the bend's inner horizon
    seen = slice(falls[-1] + 1 if len(falls) else 0, None)
    return np.interp(angles, angle[seen], SLOPES[seen], left=np.nan, right=np.nan)


@pytest.mark.deep(but=2)
@pytest.mark.parametrize("clock", [1.2, 2.2, math.pi, 4.0])
def test_a_slit_on_a_bent_wall_is_where_its_middle_is(clock: float) -> None:
    """Midway between the images of two edges, mended for a straight pipe, is off by hundredths of a millimetre."""
    bent = Centreline([Piece(0.0, R), Piece(60.0, R, curvature=(1 / 400.0, 0.0))])
    straight = Centreline([Piece(0.0, R)])
    seen = sightings(frames(straight, [0.0, AT]), CALIBRATION.rings, 24)
    assert seen is not None
    pieces = np.zeros((2, PIECE))
    pieces[:, START], pieces[0, RADIUS], pieces[1, 4] = (0.0, 60.0), R, 1 / 400.0
    heads = np.array([[0.0] * 5, [HEAD.rx, HEAD.ry, HEAD.tx, HEAD.ty, 0.0]])
    state = AdjustmentState(pieces, np.zeros((seen.rings, 3)), heads)
    before, after = [], []
    for k, cone in enumerate(CALIBRATION.rings):
        vertex, edges = cone.vertex_mm[2], cone.half_angle + SLIT * np.array([-1.0, 0.0, 1.0])
        usual = slopes_of(straight, Pose(), edges, vertex, clock)
        a, true, b = slopes_of(bent, HEAD, edges, vertex, clock)
        if not np.isfinite(a + b):
            continue
        mended = (usual[1] - (usual[0] + usual[2]) / 2) * ((b - a) / (usual[2] - usual[0])) ** 2
        rise = math.tan(cone.half_angle)

        def on_cone(slope: float, rise: float = rise, vertex: float = vertex) -> np.ndarray:
            z = -vertex * rise / (slope - rise)
            return np.array([[slope * z * math.cos(clock), slope * z * math.sin(clock), z]])

        said = on_cone((a + b) / 2 + mended)
        one = np.array([1]), np.array([k]), np.array([SLIT])
        moved = centred(seen, state, CALIBRATION.rings, said, *one)
        before.append(np.linalg.norm(said - on_cone(true)))
        after.append(np.linalg.norm(moved - on_cone(true)))
        assert (centred(seen, state, CALIBRATION.rings, said, one[0], one[1], np.zeros(1)) == said).all()
    assert len(after) >= 3
    assert max(before) > 0.01
    assert max(after) < 0.05 * max(before) + 0.0005
