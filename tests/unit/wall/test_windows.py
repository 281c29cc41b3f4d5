"""A long pipe in windows says what it says at once: the same wall, without a seam, and each defect once."""

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, RADIUS_MM, bump, oval, pocket, round_pipe, scan

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.joined import Abstract, Joined, abstract, joined
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey, survey
from annulus_pipe.wall.windows import Reach, WindowPlan, plan
from annulus_pipe.wall.within import between

pytestmark = pytest.mark.deep(gate="tests/unit/wall/test_survey.py::test_every_figure_is_an_attribute")

MOST = 230_000  # points of a window
FRAMES = [3.5 * i for i in range(440) if i % 5 != 4]


def dented() -> list[Profile]:
    """1.5 m: a dent at a cut, one across it, a groove and an out-of-round stretch longer than a window sees."""
    wall = bump(round_pipe, 100, 300, 14, 3.0)
    wall = pocket(wall, 90, 20, 670, 760, 2.0)
    wall = pocket(wall, 200, 12, 880, 1330, 1.0)
    return scan(oval(wall, 30, 0.03, 500, 1500), z_mm=FRAMES, directions=360)


@pytest.fixture(scope="module")
def profiles() -> list[Profile]:
    return dented()


@pytest.fixture(scope="module")
def cut(profiles: list[Profile]) -> WindowPlan:
    return plan([Reach.of(one) for one in profiles], RADIUS_MM, MOST)


@pytest.fixture(scope="module")
def parts(profiles: list[Profile], cut: WindowPlan) -> list[Survey]:
    return [
        between(survey([profiles[i] for i in one.frames], CALIBRATION, z_step_mm=cut.z_step_mm), one)
        for one in cut.windows
    ]


@pytest.fixture(scope="module")
def pipe(parts: list[Survey], cut: WindowPlan) -> Joined:
    return joined([abstract(one, window, cut.whole_step_mm) for one, window in zip(parts, cut.windows, strict=True)])


@pytest.fixture(scope="module")
def at_once(profiles: list[Profile], cut: WindowPlan) -> Survey:
    return survey(profiles, CALIBRATION, z_step_mm=cut.z_step_mm)


def test_the_wall_has_no_seam(parts: list[Survey], at_once: Survey, cut: WindowPlan) -> None:
    z = np.concatenate([one.wall.z_mm for one in parts])
    radius = np.concatenate([one.wall.radius_mm for one in parts])
    assert len(cut.windows) >= 4 and (np.diff(z) == cut.z_step_mm).all(), "rows of one grid, each once"
    same = np.searchsorted(z, at_once.wall.z_mm)
    off = np.abs(radius[same] - at_once.wall.radius_mm)
    assert np.nanpercentile(off, 99.5) < 0.005
    for window in cut.windows[:-1]:
        row = int(np.searchsorted(at_once.wall.z_mm, window.last_mm))
        assert np.nanmean(off[row - 10 : row + 10]) < 0.002
    assert (np.isfinite(radius[same]) == np.isfinite(at_once.wall.radius_mm)).mean() > 0.999


def test_every_defect_is_told_once_with_its_whole_extent(pipe: Joined, at_once: Survey) -> None:
    def key(one):  # type: ignore[no-untyped-def]
        return one.kind, round(one.clock_deg / 20), one.z_mm

    assert len(pipe.defects) == len(at_once.defects) and {d.kind for d in pipe.defects} == set(Kind)
    for one, other in zip(sorted(pipe.defects, key=key), sorted(at_once.defects, key=key), strict=True):
        assert one.kind is other.kind
        assert one.z_range_mm == pytest.approx(other.z_range_mm, abs=6.0)
        assert one.depth_mm == pytest.approx(other.depth_mm, abs=0.02)
        assert one.area_mm2 == pytest.approx(other.area_mm2, rel=0.1)
    # .. and the map of the whole says which cells are whose
    for number, one in enumerate(pipe.defects, start=1):
        rows = pipe.wall.z_mm[(pipe.detection.label == number).any(axis=1)]
        assert one.kind is Kind.OVALITY or one.z_range_mm[0] - 2 < rows[0] < rows[-1] < one.z_range_mm[1] + 2


def test_what_is_counted_is_counted_once(pipe: Joined, parts: list[Survey], at_once: Survey) -> None:
    assert pipe.points == sum(one.points for one in parts) == pytest.approx(at_once.points, rel=1e-3)
    assert dict(pipe.rejected) == pytest.approx(dict(at_once.rejected), rel=0.02)
    assert pipe.seen_fraction == pytest.approx(at_once.seen_fraction, abs=0.002)
    assert pipe.diameter_mean_mm == pytest.approx(at_once.diameter_mean_mm, abs=0.01)
    assert pipe.ovality_max_percent == pytest.approx(at_once.ovality_max_percent, abs=0.02)
    assert np.diff(pipe.stations.z_mm).min() > 0 and pipe.findings == at_once.findings


def test_a_coarser_map_of_the_whole_still_shows_where_things_are(parts: list[Survey], cut: WindowPlan) -> None:
    pipe = joined([abstract(one, window, 20.0) for one, window in zip(parts, cut.windows, strict=True)])
    assert pipe.wall.z_step_mm == 20.0 and (np.diff(pipe.wall.z_mm) == 20.0).all()
    loss = next(one for one in pipe.defects if one.kind is Kind.LOSS and one.depth_mm > 1.5)
    row = int(np.argmin(np.abs(pipe.wall.z_mm - loss.z_mm)))
    assert pipe.wall.residual_mm()[row, round(loss.clock_deg)] == pytest.approx(2.0, abs=0.1)


def test_a_stretch_that_nobody_saw_stays_unseen(profiles: list[Profile]) -> None:
    gone = [p for p in profiles if not 500 < p.z_mm < 1150]
    cut = plan([Reach.of(one) for one in gone], RADIUS_MM, 200_000)
    parts: list[Abstract] = []
    for window in cut.windows:
        try:
            one = survey([gone[i] for i in window.frames], CALIBRATION, z_step_mm=cut.z_step_mm)
        except AnnulusError:
            continue
        kept = between(one, window)
        if len(kept.wall.z_mm):
            parts.append(abstract(kept, window, cut.whole_step_mm))
    pipe = joined(parts)
    assert (np.diff(pipe.wall.z_mm) == cut.whole_step_mm).all()
    dark = (pipe.wall.z_mm > 740) & (pipe.wall.z_mm < 1150)
    assert not pipe.wall.seen[dark].any() and np.isnan(pipe.wall.deviation_mm()[dark]).all()
