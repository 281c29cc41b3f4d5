"""Points of a head that has drifted lie where its cones and its camera are now."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone, cone_distance
from annulus_pipe.geometry.drift import Drift, drifted, seen_with

PART, MM = st.floats(-0.004, 0.004), st.floats(-0.4, 0.4)
DRIFTS = st.builds(Drift, PART, PART, MM, PART, MM, MM, MM)
LENSES = st.sampled_from(
    [
        Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5, (-0.05, 0.01, 0.0, 0.0)),
        Camera("fisheye", 1664, 1232, 470.0, 470.0, 831.5, 615.5, (0.02, -0.004, 0.0, 0.0)),
    ]
)


def head(camera: Camera) -> Calibration:
    rings = tuple(Cone(np.radians(angle), (0.0, 0.0, 1.0), (1.0, -1.0, -56.0)) for angle in (19.0, 24.0, 29.0))
    return Calibration(camera, "RGBR", rings, 76.2)


def on_cones(calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    points = [
        np.array(cone.vertex_mm)
        + 150.0
        * np.stack(
            [np.tan(cone.half_angle) * np.cos(turn), np.tan(cone.half_angle) * np.sin(turn), np.ones(40)], axis=1
        )
        for cone in calibration.rings
    ]
    return np.concatenate(points), np.repeat(np.arange(3), 40)


@given(DRIFTS, LENSES)
@settings(max_examples=30, deadline=None)
def test_what_a_drift_does_is_undone_by_the_head_it_came_from(drift: Drift, camera: Camera) -> None:
    before, now = head(camera), drifted(head(camera), drift)
    points, ring = on_cones(before)
    there = seen_with(points, ring, before, now)
    assert np.abs(seen_with(there, ring, now, before) - points).max() < 1e-6
    for k, cone in enumerate(now.rings):
        assert np.abs(cone_distance(there[ring == k], cone)).max() < 1e-6
    assert np.abs(now.camera.project(there) - before.camera.project(points)).max() < 1e-6


def test_none_is_none() -> None:
    calibration = head(Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5))
    points, ring = on_cones(calibration)
    assert np.abs(seen_with(points, ring, calibration, drifted(calibration, Drift())) - points).max() < 1e-9
    assert Drift.of(Drift(focal=0.1, blue_mm=2.0).values) == Drift(focal=0.1, blue_mm=2.0)
