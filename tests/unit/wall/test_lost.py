"""A ring that a scan shows nothing of is named; one that the image's edge, a rod or a groove takes a part of is not."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn import calibration, draw
from synthetic_pipe import pocket, round_pipe, scan

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.polar import ring_pixels
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.wall.lost import RING_LOST, lost_rings
from annulus_pipe.wall.profile import Profile

POSES = [Pose(), Pose(0.012, -0.01, 1.0, -1.5), Pose(-0.01, 0.0, -1.0, 0.5)]


def without_contrast(image: np.ndarray, cal: Calibration, pose: Pose, ring: int) -> np.ndarray:
    """The same frame with a ring's darkness filled with the light of its two stripes."""
    band = np.zeros(image.shape[:2], np.uint8)
    curve = ring_pixels(cal.camera, cal.rings[ring], pose, cal.pipe_radius_mm)
    cv2.polylines(band, [np.rint(curve).astype(np.int32)], True, 255, 9)
    return np.asarray(cv2.inpaint(image, band, 3.0, cv2.INPAINT_TELEA), np.uint8)


def thinned(profiles: Sequence[Profile], ring: int, kept: float) -> list[Profile]:
    """All frames with a part of a ring's directions."""
    return [p.without((p.ring == ring) & (p.direction >= kept * 720), "rod") for p in profiles]


@pytest.mark.deep(gate="tests/unit/wall/test_lost.py::test_a_part_of_a_ring_is_no_ring_lost")
def test_a_ring_whose_contrast_is_gone_is_named_with_its_frames() -> None:
    cal = calibration()
    reconstructor = Reconstructor(cal, 360)
    frames = [draw(cal, pose) for pose in POSES]
    sound = [reconstructor.profile(image, frame=i, z_mm=4.0 * i) for i, image in enumerate(frames)]
    assert lost_rings(sound) == ()
    dim = [without_contrast(image, cal, pose, 1) for image, pose in zip(frames, POSES, strict=True)]
    profiles = [reconstructor.profile(image, frame=i, z_mm=4.0 * i) for i, image in enumerate(dim)]
    (finding,) = lost_rings(profiles)
    assert finding.kind == RING_LOST and finding.frames == (0, 1, 2)
    assert "ring 2 of 5" in finding.text and "3 of 3 frames" in finding.text


@pytest.mark.parametrize(("kept", "named"), [(0.66, False), (0.4, True)], ids=["cut by the edge", "mostly lost"])
def test_a_part_of_a_ring_is_no_ring_lost(kept: float, named: bool) -> None:
    assert bool(lost_rings(thinned(scan(round_pipe), 4, kept))) == named


@pytest.mark.parametrize(("every", "named"), [(8, False), (3, True)])
def test_some_frames_without_a_ring_are_no_ring_lost(every: int, named: bool) -> None:
    profiles = scan(round_pipe)
    profiles[::every] = thinned(profiles[::every], 2, 0.1)
    found = lost_rings(profiles)
    assert bool(found) == named
    assert not named or found[0].frames == tuple(p.frame for p in profiles[::every])


def test_pockets_rods_and_heads_of_one_ring_lose_none() -> None:
    assert lost_rings(scan(pocket(round_pipe, 90, 60, 120, 160, 5.0))) == ()
    alone = [replace(p, ring=np.zeros_like(p.ring)) for p in thinned(scan(round_pipe), 0, 0.0)]
    assert lost_rings(alone) == () and lost_rings([]) == ()
