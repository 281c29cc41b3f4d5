"""The slide of rings: its phase is linear along the wall it was drawn for."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure import FringeProjector, ring_slide

GIVEN = (101.6, 8.0, 60.0, (22.0, 38.0), 12.0)


def test_phase_is_linear_along_the_wall() -> None:
    slide = ring_slide(*GIVEN)
    ahead = np.linspace(*slide.wall_mm, 50)
    on_slide = slide.focal_mm * 101.6 / (ahead + 60.0)  # a straight ray through the lens
    phase = slide.phase(on_slide)
    np.testing.assert_allclose(np.diff(phase), 2 * np.pi / 8.0 * np.diff(ahead), rtol=1e-9)
    wall = np.stack([np.full(50, 101.6), np.zeros(50), ahead], axis=1)
    np.testing.assert_allclose(phase, slide.projector.phase(wall), rtol=1e-9)
    assert slide.rings == int(np.ptp(slide.wall_mm) / 8.0)


def test_defocus_takes_the_finest_rings_first() -> None:
    slide = ring_slide(*GIVEN, defocus_mm=0.1)
    inner, outer = slide.modulation(np.array([slide.inner_mm, slide.outer_mm]))
    assert 0.2 < inner < outer < 1
    with pytest.raises(AnnulusError, match="leaves"):
        ring_slide(*GIVEN, defocus_mm=0.4)


def test_the_command_draws_it_to_scale(tmp_path: Path) -> None:
    run = CliRunner().invoke(
        app,
        [
            "pattern",
            "design",
            "--fringe",
            "--pipe-mm",
            "203.2",
            "--period-mm",
            "8",
            "--distance-mm",
            "60",
            "--inner-deg",
            "44",
            "--outer-deg",
            "76",
            "--projector-f-mm",
            "6",
            "--json",
            "-o",
            str(tmp_path),
        ],
    )
    assert run.exit_code == 0, run.output
    told, said = json.loads(run.stdout), json.loads((tmp_path / "slide.json").read_text())
    picture = cv2.imread(str(tmp_path / "slide.png"), cv2.IMREAD_GRAYSCALE)
    reach = np.flatnonzero(picture[len(picture) // 2] > 0)
    assert np.ptp(reach) / said["dpi"] * 25.4 / 2 == pytest.approx(told["radii_mm"][1], abs=0.03)
    slide = FringeProjector.from_dict(json.loads((tmp_path / "calibration.json").read_text())["pattern"]["projector"])
    assert slide.period == 8.0 and slide.centre_mm == (0.0, 0.0, -60.0)


def test_a_design_that_cannot_be_is_said_in_a_line() -> None:
    with pytest.raises(AnnulusError, match="rising"):
        ring_slide(101.6, 8.0, 60.0, (38.0, 22.0), 12.0)
    with pytest.raises(AnnulusError, match="2 or more"):
        ring_slide(101.6, 200.0, 60.0, (22.0, 38.0), 12.0)
    said = CliRunner().invoke(app, ["pattern", "design", "--fringe", "--pipe-mm", "200", "-o", "x"])
    assert isinstance(said.exception, AnnulusError) and "--period-mm" in str(said.exception)
