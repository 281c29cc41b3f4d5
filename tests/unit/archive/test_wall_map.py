"""A wall map from outside is a value or one line."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from annulus_pipe.archive.wall_map import read_map
from annulus_pipe.vocabulary import AnnulusError

PLAIN: dict[str, Any] = {"deviation_um": np.zeros((40, 36), np.int16), "z_step_mm": 4.0, "radius_mm": 76.2}


def written(path: Path, **more: Any) -> Path:
    np.savez(path, **{name: value for name, value in {**PLAIN, **more}.items() if value is not None})
    return path


def test_a_map_and_the_folder_it_lies_in_read_the_same(tmp_path: Path) -> None:
    file = written(
        tmp_path / "wall.npz",
        format="annulus-wall/1",
        z_mm=100 + 4.0 * np.arange(40),
        clock_deg=5 + 10.0 * np.arange(36),
    )
    for path in (file, tmp_path):
        wall = read_map(path)
        assert (wall.first_mm, wall.step_mm, wall.first_deg, wall.radius_mm) == (100.0, 4.0, 5.0, 76.2)
        assert np.isnan(wall.imu_roll_deg).all() and not wall.deviation_mm.any()


def test_what_was_not_seen_or_is_beyond_the_form_is_nan(tmp_path: Path) -> None:
    away = np.array([-32768, -32767, -32766, 32767, 32766, 0] * 6, np.int16)[None].repeat(40, axis=0)
    wall = read_map(written(tmp_path / "a.npz", deviation_um=away))
    assert np.isnan(wall.deviation_mm[0, :6]).tolist() == [True, True, False, True, False, False]
    assert wall.deviation_mm[0, 4] == pytest.approx(32.766)


def test_turned_about_twice_is_the_same(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    wall = read_map(written(tmp_path / "a.npz", deviation_um=rng.integers(-100, 100, (40, 36)).astype(np.int16)))
    again = wall.turned_about().turned_about()
    assert np.array_equal(again.deviation_mm, wall.deviation_mm) and again.first_mm == wall.first_mm
    assert again.first_deg == pytest.approx(wall.first_deg)


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"deviation_um": np.zeros((40, 36))}, "float64"),
        ({"deviation_um": np.zeros(40, np.int16)}, "int16"),
        ({"deviation_um": np.zeros((4, 36), np.int16)}, "4 x 36"),
        ({"deviation_um": np.full((40, 36), -32768, np.int16)}, "nothing of the wall was seen"),
        ({"deviation_um": None}, "has no deviation_um"),
        ({"z_step_mm": None}, "has no z_step_mm"),
        ({"z_step_mm": np.nan}, "z_step_mm"),
        ({"z_step_mm": -4.0}, "z_step_mm"),
        ({"radius_mm": 1e9}, "radius_mm"),
        ({"radius_mm": [76.2, 76.2]}, "radius_mm"),
        ({"imu_roll_deg": np.zeros(7)}, "imu_roll_deg"),
        ({"z_mm": np.zeros(40)}, "z_mm"),
        ({"clock_deg": np.full(36, np.inf)}, "clock_deg"),
        ({"format": "annulus-wall/9"}, "annulus-wall/9"),
        ({"shadowed": np.zeros(3, bool)}, "shadowed"),
    ],
)
def test_anything_else_is_one_line_that_names_the_file(tmp_path: Path, more: dict[str, Any], told: str) -> None:
    path = written(tmp_path / "a.npz", **more)
    with pytest.raises(AnnulusError, match=told) as caught:
        read_map(path)
    assert "a.npz" in str(caught.value) and "\n" not in str(caught.value)


def test_no_map_at_all_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("no zip")
    (tmp_path / "empty").mkdir()
    cut = written(tmp_path / "cut.npz").read_bytes()[:-200]
    (tmp_path / "cut.npz").write_bytes(cut)
    np.savez(tmp_path / "pickled.npz", deviation_um=np.array([{"a": 1}], dtype=object), z_step_mm=4.0, radius_mm=76.2)
    for name in ("text.npz", "empty", "cut.npz", "pickled.npz", "missing.npz"):
        with pytest.raises(AnnulusError, match=name.split(".")[0]):
            read_map(tmp_path / name)
