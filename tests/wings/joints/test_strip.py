"""A dogbone scanned alone: W and T of a strip drawn voxel by voxel, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from joint_scene import VOXEL, Scene, volume
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure import ArrayVolume, StripImage, strip

STRIP = Scene(
    radius=30.0,
    wall=5.6,
    centre=(-9.0, 19.0),
    plane=18.0,
    bead=(8.0, 2.2),
    hilo=0.0,
    void=None,
    grain=None,
    sawn=8.0,
    shape=(110, 128, 128),
)


def seen(scene: Scene, seed: int) -> StripImage:
    return strip(ArrayVolume(volume(scene, seed), VOXEL))


def both(scene: Scene) -> tuple[float, float]:
    """True W and T at the strip's middle; beads inside are 0.8 as high."""
    return float(scene.width_at(np.zeros(1))[0]), scene.wall + 1.8 * (1 - scene.notch) * scene.bead[1]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("sawn", [5.6, 8.0, 12.0])
@pytest.mark.parametrize("hilo", [0.0, 0.3])
def test_w_and_t_of_a_strip_lie_within_three_sigma_of_what_was_drawn(sawn: float, hilo: float) -> None:
    scene = Scene(**{**STRIP.__dict__, "sawn": sawn, "hilo": hilo})
    w, t = both(scene)
    found = seen(scene, seed=round(sawn))
    assert abs(found.w_mm - w) < 3 * found.w_sigma_mm and found.w_sigma_mm < 0.15
    # Floors finer than a voxel may lie deeper than any plane shows: 0.04 to 0.105 mm of sigma in these six.
    assert abs(found.t_mm - t) < 3 * found.t_sigma_mm and found.t_sigma_mm < 0.12
    assert found.wall_mm == pytest.approx(scene.wall, abs=0.08)
    assert found.haz == pytest.approx(1 - scene.drop, abs=0.004)
    assert found.lean_deg == pytest.approx(2.06, abs=0.3)
    assert found.width_mm == pytest.approx(sawn, abs=0.6)


def test_a_strip_without_zone_has_a_thickness_and_no_width() -> None:
    found = seen(Scene(**{**STRIP.__dict__, "drop": 0.0}), 1)
    assert np.isnan(found.w_mm) and np.isfinite(found.t_mm)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("grey", "word"),
    [
        (volume(Scene()), "its section is hollow"),
        (volume(Scene(**{**STRIP.__dict__, "bead": (8.0, 0.0)})), "no bead stands over"),
        (np.random.default_rng(0).normal(size=(40, 60, 60)), "no plastic in the volume"),
        (np.full((40, 60, 60), 7.0), "one grey"),
        (np.zeros((8, 60, 60)), "expected at least"),
        (np.full((40, 60, 60), np.nan), "finite"),
    ],
)
def test_what_is_no_strip_with_a_joint_is_refused_in_one_line(grey: np.ndarray, word: str) -> None:
    with pytest.raises(AnnulusError, match=word) as error:
        strip(ArrayVolume(grey, VOXEL))
    assert "\n" not in str(error.value)


def test_the_command_writes_numbers_with_units_and_a_picture(tmp_path: Path) -> None:
    np.save(tmp_path / "45.npy", volume(STRIP).astype(np.float32))
    size = ["--voxel-mm", *(str(v) for v in VOXEL)]
    ran = CliRunner().invoke(app, ["joint", "strip", str(tmp_path / "45.npy"), "-o", str(tmp_path / "out"), *size])
    assert ran.exit_code == 0, ran.output
    assert "W          4." in ran.output and "T          7." in ran.output and "sigma" in ran.output
    said = json.loads((tmp_path / "out" / "strip.json").read_text())
    assert said["W_mm"] == pytest.approx(both(STRIP)[0], abs=0.3)
    assert (tmp_path / "out" / "strip.png").stat().st_size > 10_000
