"""Promises of a defect from close by: pictures say the listed depth, the photograph shows it and no other place."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, RADIUS_MM, bump, oval, pocket, round_pipe, scan, turn

from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.photograph import SIDE_MAX_PX, DefectView, Shot, best_views, crop
from annulus_pipe.wall.sections import MOST, cut, worth_showing
from annulus_pipe.wall.survey import Survey, survey

KINDS = [Kind.LOSS, Kind.BUMP, Kind.LOSS]
PLACES = [Shot(n, n, 2.4 * n, 0) for n in range(50) if n % 5 == 4]


@pytest.fixture(scope="module")
def pipe() -> Survey:
    shape = pocket(bump(round_pipe, 200, 135, 14, 3.0), 90, 12, 120, 150, 4.0)
    seen = scan(pocket(shape, 3, 11, 140, 160, 2.0))
    sigma = [np.full(len(one.ring), 0.03, np.float32) for one in seen]
    return survey([replace(one, sigma_mm=s) for one, s in zip(seen, sigma, strict=True)], CALIBRATION)


def led(z_head: float) -> np.ndarray:
    """The pocket at 3 o'clock painted black, the one over 12 o'clock grey."""
    camera = CALIBRATION.camera
    x, y = np.meshgrid(np.arange(camera.width) - camera.cx, np.arange(camera.height) - camera.cy)
    clock, z = np.degrees(np.arctan2(x, -y)) % 360, z_head + RADIUS_MM * camera.fx / np.maximum(np.hypot(x, y), 1e-3)
    grey = np.where((np.abs(turn(clock, 90)) < 12) & (z > 120) & (z < 150), 30, 200)
    grey = np.where((np.abs(turn(clock, 3)) < 11) & (z > 140) & (z < 160), 90, grey)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


def test_the_lines_cross_at_the_listed_depth(pipe: Survey) -> None:
    assert [one.kind for one in pipe.defects] == KINDS
    for one in cut(pipe, range(3)):
        defect = pipe.defects[one.index]
        sign = 1 if defect.kind is Kind.LOSS else -1
        assert abs(sign * one.departs - defect.depth_mm) <= defect.depth_k2_mm
        here = int(np.argmin(np.abs(pipe.wall.clock_deg - one.clock_deg)))
        there = int(np.argmin(np.abs(one.along_z - one.z_mm)))
        for line, datum, k2, at in (
            (one.across, one.datum, one.across_k2, here),
            (one.along, one.along_datum, one.along_k2, there),
        ):
            assert line[at] - datum[at] == pytest.approx(one.departs, abs=1e-6)
            assert 0 < k2[at] < 0.5
        assert abs(one.z_mm - defect.z_mm) < defect.length_mm / 2
        assert abs(turn(np.array(one.clock_deg), defect.clock_deg)) < defect.arc_deg / 2
        assert one.along_z[0] < defect.z_range_mm[0] and one.along_z[-1] >= min(
            defect.z_range_mm[1], pipe.wall.z_mm[-1]
        )


def test_what_was_not_seen_is_a_gap_in_the_line(pipe: Survey) -> None:
    (one,) = cut(pipe, [0])
    rod = np.abs(pipe.wall.clock_deg - 227.0) < 3.0
    assert np.isnan(one.across[rod]).all() and np.isfinite(one.datum).all()


def test_an_oval_is_cut_along_its_long_axis() -> None:
    flat = survey(scan(oval(round_pipe, 30, 0.03), z_mm=[4.0 * i for i in range(8)]), CALIBRATION)
    (one,) = cut(flat, [0])
    assert flat.defects[0].kind is Kind.OVALITY
    assert abs((one.clock_deg - 30 + 90) % 180 - 90) < 3
    assert one.datum.max() == pytest.approx(flat.defects[0].depth_mm / 2, abs=0.02)
    assert best_views(flat, CALIBRATION, PLACES, [0]) == {}


def test_the_photograph_is_of_the_defect(pipe: Survey) -> None:
    views = best_views(pipe, CALIBRATION, PLACES, range(3))
    assert sorted(views) == [0, 1, 2]
    for index, inner in ((0, 30), (2, 90)):
        view = views[index]
        shown = crop(view, led(view.shot.z_mm))
        assert max(shown.image_bgr.shape[:2]) <= SIDE_MAX_PX and view.inside >= 0.98
        mask = np.zeros(shown.image_bgr.shape[:2], np.uint8)
        cv2.fillPoly(mask, [np.rint(line).astype(np.int32) for line in shown.view.outline], 1)
        grey = shown.image_bgr[..., 0].astype(float)
        least = float(led(view.shot.z_mm)[mask_of(view)].min())
        assert least == inner
        dark = grey < np.median(grey[mask == 0]) - 60
        both = np.count_nonzero(dark & (mask > 0)) / np.count_nonzero(dark | (mask > 0))
        assert both > 0.75, "the outline is not where the picture has the pocket"


def test_of_two_frames_that_show_all_the_nearer_one_is_taken(pipe: Survey) -> None:
    views = best_views(pipe, CALIBRATION, PLACES, [0])
    ahead = views[0].ahead_mm
    nearer = [one for one in PLACES if one.z_mm > views[0].shot.z_mm]
    assert not best_views(pipe, CALIBRATION, nearer, [0]) or best_views(pipe, CALIBRATION, nearer, [0])[0].inside < 0.98
    farther = [one for one in PLACES if one.z_mm < views[0].shot.z_mm]
    assert best_views(pipe, CALIBRATION, farther, [0])[0].ahead_mm > ahead


def test_ticks_stand_at_half_hours_of_the_dial(pipe: Survey) -> None:
    view = best_views(pipe, CALIBRATION, PLACES, [2])[2]
    camera = CALIBRATION.camera
    assert 345.0 in [clock for clock, _ in view.ticks] and 0.0 in [clock for clock, _ in view.ticks]
    for clock, ends in view.ticks:
        seen = np.degrees(np.arctan2(ends[:, 0] - camera.cx, -(ends[:, 1] - camera.cy)))
        assert np.abs(turn(seen, clock)).max() < 0.5


def test_no_frame_no_photograph(pipe: Survey) -> None:
    assert best_views(pipe, CALIBRATION, [], range(3)) == {}
    assert best_views(pipe, CALIBRATION, [Shot(0, 0, 1000.0, 0), Shot(1, 1, 0.0, 7)], range(3)) == {}


def test_a_page_shows_the_deepest_and_what_was_asked_for() -> None:
    many = [Defect(Kind.LOSS, i, 0, 5, 5, 0.1 * (1 + i % 7), 25) for i in range(50)]
    chosen = worth_showing(many)
    assert len(chosen) == MOST and list(chosen) == sorted(chosen)
    assert min(many[i].depth_mm for i in chosen) >= 0.5
    assert 0 in worth_showing(many, 3, first=(0,)) and len(worth_showing(many, 3, first=(0,))) == 3


def mask_of(view: DefectView) -> np.ndarray:
    mask = np.zeros((CALIBRATION.camera.height, CALIBRATION.camera.width), np.uint8)
    cv2.fillPoly(mask, [np.rint(line).astype(np.int32) for line in view.outline], 1)
    return mask > 0
