"""A long pipe comes in sheets of one scale, bounded however long it is; every picture along it has the same axis."""

import math
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from synthetic_pipe import CALIBRATION, bump, pocket, round_pipe, scan
from tiled_survey import tiled

from annulus_pipe.numeric.thinning import farthest
from annulus_pipe.report import figures
from annulus_pipe.report.long_pipe import SHEETS_MAX, sheets_of
from annulus_pipe.report.maps import ROWS_MAX, calm, draw_shape, mean_colour
from annulus_pipe.report.marks import marks_of, outline
from annulus_pipe.report.paper import AXES_MM, Stretch, scale_of, stack
from annulus_pipe.wall.survey import Survey, survey
from annulus_pipe.wall.texture import LedFrame

AXIS_BGR = (0x85, 0x78, 0x6B)


@pytest.fixture(scope="module")
def short() -> Survey:
    camera = CALIBRATION.camera
    grey = np.full((camera.height, camera.width, 3), 120, np.uint8)
    shape = bump(pocket(round_pipe, 10, 20, 130, 150, 3.0), 200, 160, 14, 3.0)
    return survey(scan(shape, z_mm=[3.0 * i for i in range(40)]), CALIBRATION, [LedFrame(4, 20.0, grey)])


@given(st.floats(-1e5, 1e5), st.floats(0.1, 2e6))
@example(-5e-324, 1.0)  # over the length of a sheet it is -0.0
def test_sheets_cover_the_pipe_without_a_gap_and_are_never_too_many(first: float, length: float) -> None:
    sheets = sheets_of(first, first + length)
    assert 1 <= len(sheets) <= SHEETS_MAX
    assert sheets[0][0] <= first and sheets[-1][1] >= first + length - 1e-6
    assert all(math.isclose(a[1], b[0], abs_tol=1e-6) for a, b in pairwise(sheets))
    assert len({round(b - a, 3) for a, b in sheets}) == 1


def test_thirty_metres_are_sheets_of_three_at_one_to_twenty() -> None:
    sheets = sheets_of(84.0, 29_900.0)
    assert len(sheets) == 10 and sheets[3] == (9000.0, 12000.0)
    assert len(sheets_of(0.0, 60_000.0)) == 20 and len(sheets_of(0.0, 60_001.0)) == 11
    assert scale_of(3000.0, AXES_MM) == "1 : 20"


@pytest.mark.parametrize("names", [True, False])
def test_a_map_names_each_thing_once_beside_it_or_along_its_edge(short: Survey, names: bool) -> None:
    marks = marks_of(short)
    whole = Stretch.of(short, *short.wall.extent[:2])
    figure, (axes,) = stack([(9.0, 60.0)], whole)
    draw_shape(figure, axes, short, whole, short.wall.deviation_mm(), 3.0, marks, 60.0, names=names)
    said = [name.strip() for text in axes.texts for name in text.get_text().split(",")]
    assert len(marks) >= 2
    assert [said.count(mark.name) for mark in marks] == [1] * len(marks)


def frame_of(png: bytes) -> tuple[int, int, int]:
    """Width of the picture, and columns at which its axes begin and end: the longest line in the axes' grey."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).astype(int)
    grey = (np.abs(picture - AXIS_BGR) < 40).all(axis=2)
    best = (0, 0)
    for row in grey:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row, [0]])))
        begin, end = max(zip(edges[::2], edges[1::2], strict=True), key=lambda run: run[1] - run[0], default=(0, 0))
        best = max(best, (int(begin), int(end) - 1), key=lambda run: run[1] - run[0])
    return picture.shape[1], *best


@pytest.mark.deep(
    gate="tests/scenes/report/test_sheets.py::test_sheets_cover_the_pipe_without_a_gap_and_are_never_too_many"
)
def test_every_picture_along_the_pipe_has_the_same_axis_and_a_page_has_its_overview_and_sheets(short: Survey) -> None:
    assert len(short.defects) == 2
    pipe = tiled(short, math.ceil(7000 / (len(short.wall.z_mm) * short.wall.z_step_mm)))
    pictures = figures.draw(pipe)
    captions = [caption for caption, _ in pictures.sheets]
    assert captions == [f"Sheet {k} of 3: {3 * k - 3}.000 to {3 * k}.000 m" for k in (1, 2, 3)]
    assert pictures.sheet_scale.startswith("1 : 20 along") and pictures.stretch_mm is not None
    frames = [frame_of(one) for one in (pictures.unwrapped, pictures.texture, *(png for _, png in pictures.sheets))]
    width, left, right = frames[0]
    assert width == 1350 and (right - left) / width == pytest.approx(150 / 186, abs=0.004)
    assert all(abs(one[1] - left) <= 2 and abs(one[2] - right) <= 2 for one in frames), frames
    assert all(len(png) < 1_500_000 for _, png in pictures.sheets)
    whole = figures.draw(short)
    assert whole.sheets == () and frame_of(whole.unwrapped)[1:] == frame_of(whole.texture)[1:]


def test_a_short_defect_of_a_long_pipe_is_not_lost_between_two_dots() -> None:
    field = np.full((50_001, 3), np.nan, np.float32)
    field[:, 0] = 0.01
    field[12_345, 0], field[30_000, 1] = -3.0, 2.0
    seen = farthest(field, ROWS_MAX)
    assert len(seen) <= ROWS_MAX and np.nanmin(seen) == -3.0 and np.nanmax(seen) == 2.0
    assert np.isnan(seen[:, 2]).all() and (np.isfinite(seen[:, 1])).sum() == 1


def test_colours_are_means_of_what_was_seen_and_hues_are_calm() -> None:
    rng = np.random.default_rng(4)
    rgba = np.zeros((10_000, 40, 4), np.uint8)
    rgba[:, :30, :3] = np.clip(rng.normal(120, 30, (10_000, 30, 3)), 0, 255)
    rgba[:, :30, 3] = 255
    small = mean_colour(rgba)
    assert len(small) == ROWS_MAX and (small[:, 35, 3] == 0).all()
    assert small[:, 5, :3].mean() == pytest.approx(120, abs=2)
    after = calm(rgba[:500], (0.5, 1.3))[:, :30, :3].astype(float)
    before = rgba[:500, :30, :3].astype(float)
    assert np.ptp(after, axis=2).mean() < 0.25 * np.ptp(before, axis=2).mean()  # measured: 0.15
    assert after.mean() == pytest.approx(before.mean(), abs=6)


def test_an_outline_is_closed_and_has_no_teeth_where_shadows_cross_the_defect(short: Survey) -> None:
    """Also over 12 o'clock: the pocket lies from 11:40 to 1:00."""
    (loss,) = (one for one in short.defects if one.kind == "loss")
    number = short.defects.index(loss) + 1
    label = short.detection.label.copy()
    label[:, 14:17] = np.where(label[:, 14:17] == number, 0, label[:, 14:17])  # a rod's shadow across it
    label[::3, 5] = 0
    (line,) = outline(short.wall, label, number, loss)
    assert np.allclose(line[0], line[-1])
    length, width = np.ptp(line[:, 0]) * 1000, np.ptp(np.radians(line[:, 1])) * short.wall.mean_radius_mm
    assert length == pytest.approx(loss.length_mm, abs=5.0)
    step = np.diff(np.column_stack([line[:, 0] * 1000, np.radians(line[:, 1]) * short.wall.mean_radius_mm]), axis=0)
    assert np.hypot(*step.T).sum() < 1.15 * 2 * (length + width)  # teeth would make it long
    assert {mark.name for mark in marks_of(short)} == {"1", "2"}
