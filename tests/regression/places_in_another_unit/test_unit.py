"""Places in another unit, 10 000 times too large, kept a reconstruction of twelve frames busy for minutes."""

from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.reprocess.job import Job, look_at
from annulus_pipe.reprocess.places import APART_MAX_MM, require_near
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.vocabulary import AnnulusError


@pytest.mark.parametrize("times", [100, 1000, 10_000, -10_000])
def test_a_unit_is_asked_for_before_anything_is_measured(times: int, tmp_path: Path) -> None:
    z = 30.0 * np.arange(12)
    with pytest.raises(AnnulusError, match=r"z_mm of its 12 flashes .* are these mm\?"):
        require_near(tmp_path, list(z * times))


def test_one_place_far_away_counts_too(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="are these mm"):
        require_near(tmp_path, [0.0, 30.0, 60.0, 3e6])


def test_a_scan_with_holes_is_one(tmp_path: Path) -> None:
    require_near(tmp_path, [])
    require_near(tmp_path, [5e6])
    require_near(tmp_path, [0.0, APART_MAX_MM, float("nan")])
    require_near(tmp_path, [*np.arange(0.0, 500.0, 5.0), *np.arange(100e3, 100.5e3, 5.0)])


def test_a_scan_is_looked_at_for_it(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((8, 8, 3), np.uint8))
    rows = "".join(f"{i},0.png,projector,{300e3 * i}\n" for i in range(12))
    (tmp_path / "frames.csv").write_text(f"index,file,light,z_mm\n{rows}")
    with pytest.raises(AnnulusError, match="300000 mm from one to the next, expected at most 2000"):
        look_at(Job(open_scan(tmp_path), cast(Calibration, None)))
