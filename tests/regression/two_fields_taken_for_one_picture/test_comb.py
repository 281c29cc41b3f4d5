"""Pictures of two fields, pixels that are not square, a chainage without a unit: each made a wrong pipe in silence."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.scans.fields import combed
from annulus_pipe.scans.video import _square, import_video, read_chainage
from annulus_pipe.vocabulary import AnnulusError


def ring(off: float, thick: float = 1.1) -> np.ndarray:
    v, u = np.mgrid[0:144, 0:176]
    line = 200 * np.exp(-0.5 * ((np.hypot(u - 88 - off, v - 72) - 42) / thick) ** 2)
    return np.stack([0.35 * line, 0.15 * line, line], axis=2)


def picture(i: int, fields: bool, thick: float = 1.1) -> np.ndarray:
    """A ring that rocks by 4 px from field to field."""
    side = 2.0 if i % 2 else -2.0
    image = ring(side, thick)
    if fields:
        image[1::2] = ring(-side, thick)[1::2]
    noise = np.random.default_rng(i).normal(4, 2, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("thick", [1.1, 0.6, 3.0])
def test_a_comb_is_told_by_the_picture_and_a_line_along_the_rows_is_none(thick: float) -> None:
    assert all(combed(picture(i, True, thick)) for i in range(4))
    assert not any(combed(picture(i, False, thick)) for i in range(4))
    assert not combed(np.random.default_rng(1).normal(60, 4, (144, 176)).astype(np.uint8))


def test_pictures_of_two_fields_are_refused_and_nothing_is_left(tmp_path: Path) -> None:
    for name, fields in (("dvd", True), ("camera", False)):
        (tmp_path / name).mkdir()
        for i in range(6):
            cv2.imwrite(str(tmp_path / name / f"{i}.png"), picture(i, fields))
    with pytest.raises(AnnulusError, match=r"dvd: 6 of 6 pictures are of two fields \(interlaced\)"):
        import_video(tmp_path / "dvd", tmp_path / "scan", speed_mm_s=50.0, fps=25.0)
    assert not (tmp_path / "scan").exists()
    assert import_video(tmp_path / "camera", tmp_path / "scan", speed_mm_s=50.0, fps=25.0).frames == 6


def test_pixels_become_square_and_none_is_lost() -> None:
    flat = np.zeros((288, 360, 3), np.uint8)
    assert _square(flat, 16 / 15).shape == (288, 384, 3) and _square(flat, 8 / 9).shape == (324, 360, 3)
    assert _square(flat, 1.0) is flat


def test_a_chainage_whose_unit_nobody_says_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "counter.csv").write_text("frame,chainage\n0,0\n100,1.5\n")
    with pytest.raises(AnnulusError, match="line 1: chainage has no unit, expected one of mm, cm, m, in, ft"):
        read_chainage(tmp_path / "counter.csv")
    assert read_chainage(tmp_path / "counter.csv", "m").z_mm == (0.0, 1500.0)
