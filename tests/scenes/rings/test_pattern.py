import dataclasses
import math

import numpy as np
import pytest
from drawn import draw

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.pattern import PatternHead, de_bruijn, design, preview, stripe_colours
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.vocabulary import AnnulusError

CAMERA = Camera("pinhole", 832, 616, 235.0, 235.0, 415.5, 307.5)
HEAD = PatternHead(CAMERA, 152.4, 152.4, 152.4, 56.0, 9.0, 45.0)


@pytest.mark.parametrize(("letters", "word"), [("RGB", 2), ("RGB", 3), ("RG", 2), ("GB", 5)])
def test_every_word_occurs_once(letters: str, word: int) -> None:
    ring = de_bruijn(letters, word)
    words = {(ring + ring)[i : i + word] for i in range(len(ring))}
    assert len(ring) == len(words) == len(letters) ** word


def test_the_sources_designs_come_out() -> None:
    nine = stripe_colours("RGB", 2)
    assert len(nine) == 9
    assert len({nine[i : i + 2] for i in range(8)}) == 8
    eleven = stripe_colours("RGB", 3, 12)  # eleven slits
    assert len({eleven[i : i + 3] for i in range(10)}) == 10
    pairs = [eleven[i : i + 2] for i in range(11)]
    assert len(set(pairs)) == 9  # all there are: no stretch needs its third stripe less
    for colours, word in ((nine, 2), (eleven, 3), (stripe_colours("RGB", 3, 11), 3)):
        pattern = design(HEAD, colours, word, slit_px=4.0)
        assert np.ptp(pattern.widths_px(HEAD.nominal_mm)) < 1e-11
        assert Calibration.from_dict(pattern.calibration().to_dict()).colours == colours


def test_a_head_built_as_designed_reads_every_ring() -> None:
    pattern = design(HEAD, stripe_colours("RGB", 2), 2, slit_px=4.0)
    cal = pattern.calibration()
    image = draw(cal, Pose(0.01, -0.02, 2.0, -1.0), slit_px=4.0)
    profile = Reconstructor(cal, 360).profile(image, frame=0, z_mm=0.0)
    assert np.bincount(profile.ring, minlength=8).min() > 300
    off = np.hypot(profile.points_mm[:, 0], profile.points_mm[:, 1]) - 76.2
    assert np.sqrt(np.mean(off**2)) < 0.1


def test_stripes_are_refused_where_their_slits_blur_takes_their_colour() -> None:
    nine = stripe_colours("RGB", 2)
    room = design(HEAD, nine, 2, slit_px=4.0).stripe_px * 9 + 4.0 * 8
    assert design(HEAD, nine, 2, slit_px=(room - 9 * 5.1) / 8).stripe_px == pytest.approx(5.1)
    with pytest.raises(AnnulusError, match="expected at least 5"):
        design(HEAD, nine, 2, slit_px=(room - 9 * 4.9) / 8)


def test_limits_are_checked_and_the_remedy_is_said() -> None:
    nine = stripe_colours("RGB", 2)
    pattern = design(HEAD, nine, 2, slit_px=4.0)
    limits = pattern.to_dict()["limits"]
    assert limits["distance_mm_below"] > HEAD.distance_mm
    assert pattern.inner[0] > math.atan(9.0 / 45.0)
    with pytest.raises(AnnulusError, match=r"blocked by the sensor's body.*Eq. 3.3"):
        design(HEAD, nine, 2, inner_full_deg=20.0)
    with pytest.raises(AnnulusError, match=r"leaves the image.*Eq. 3.2"):
        design(HEAD, nine, 2, outer_full_deg=80.0)
    with pytest.raises(AnnulusError, match="stripes fit"):
        design(HEAD, stripe_colours("RGB", 3), 3)
    with pytest.raises(AnnulusError, match="does not go into"):
        design(dataclasses.replace(HEAD, sensor_radius_mm=80.0), nine, 2)
    with pytest.raises(AnnulusError, match="make 9 at most"):
        stripe_colours("RGB", 2, 12)
    with pytest.raises(AnnulusError, match="letters R, G, B"):
        stripe_colours("RGY", 2)


def test_a_fisheye_may_look_wider_than_its_rings_fall() -> None:
    wide = Camera("fisheye", 832, 616, 180.0, 180.0, 415.5, 307.5, (0.02, -0.005, 0.0, 0.0))
    pattern = design(dataclasses.replace(HEAD, camera=wide, least_mm=100.0, nominal_mm=125.0), "RGBRR", 2, slit_px=4.0)
    assert np.ptp(pattern.widths_px(125.0)) < 1e-11
    assert pattern.to_dict()["outer_full_deg"] < 180


def test_the_preview_shows_what_the_design_says() -> None:
    pattern = design(HEAD, stripe_colours("RGB", 2), 2, slit_px=4.0)
    shown = preview(pattern, 152.4, every=1)
    line = shown[308, 416:].max(axis=1) > 30
    runs = np.diff(np.flatnonzero(np.diff(line.astype(int))))[::2]
    assert len(runs) == 9
    assert np.all(np.abs(runs - pattern.stripe_px) < 1.0)
