"""A probe's raster finds its place on the joint it is of, within its sigma; where nothing tells, it says so."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from raster_scene import JOINT, joint, scan

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.raster import Raster, at_joint, place
from annulus_pipe.wings.joints.raster_file import read_raster


@pytest.mark.parametrize("seed", [0, 3])
def test_a_raster_lies_where_it_was_taken_whichever_way_round(seed: int) -> None:
    rng = np.random.default_rng(seed)
    surface = joint(rng)
    raster, truth = scan(surface, rng, angles=48)
    placed = place(raster, surface)
    off = (math.degrees(placed.shift) - truth.shift_deg + 180) % 360 - 180
    assert placed.accepted, placed.why
    assert (placed.sense, placed.best_along) == (truth.sense, truth.along)
    assert abs(off) < min(2 * math.degrees(placed.shift_sigma), 3)
    assert abs(placed.raster_joint_mm - truth.joint_mm) < 0.15
    beside = np.abs(surface.z_mm - JOINT) > 14
    far = placed.joint_mv[0][beside]
    assert np.nanstd(far) < 1.5 * 0.3  # plain wall is level, to the noise
    bead = at_joint(placed.joint_mv[0], surface.z_mm, np.full(placed.joint_mv.shape[2], JOINT))
    left = at_joint(placed.material_mv[0], surface.z_mm, np.full(placed.joint_mv.shape[2], JOINT))
    assert np.std(left) < 0.7 * np.std(bead)  # the bead's share is gone


def test_a_raster_of_another_joint_is_not_accepted() -> None:
    rng = np.random.default_rng(1)
    raster, _ = scan(joint(rng), rng, angles=48)
    assert not place(raster, joint(np.random.default_rng(1001))).accepted


def test_a_joint_alike_all_round_decides_no_angle_and_no_sense() -> None:
    rng = np.random.default_rng(2)
    even = joint(rng, waviness=0.0)
    raster, _ = scan(even, rng, angles=48)
    placed = place(raster, even)
    assert not placed.accepted
    assert placed.sense == 0


def test_a_raster_that_does_not_show_the_joint_with_plain_wall_is_refused() -> None:
    rng = np.random.default_rng(4)
    surface = joint(rng)
    raster, _ = scan(surface, rng, angles=48)
    short = replace(raster, z_mm=raster.z_mm[:20], values=raster.values[:, :20])
    with pytest.raises(AnnulusError, match="plain wall on both sides"):
        place(short, surface)


def _file(path: Path, **changed: np.ndarray | None) -> Path:
    angle, z = np.arange(0, 360, 10.0), np.arange(20, 60, 1.0)
    held = {"angle_deg": angle, "z_mm": z, "amplitude_mv": np.zeros((36, 40)), **changed}
    np.savez(path, **{k: v for k, v in held.items() if v is not None})  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"amplitude_mv": np.zeros((40, 36))}, "40 x 36, expected 36 x 40"),
        ({"amplitude_mv": np.full((36, 40), np.nan)}, "1440 of 1440 values of amplitude_mv are not finite"),
        ({"amplitude_mv": None}, "no array amplitude_mv or phase_mv"),
        ({"angle_deg": None}, "no array angle_deg"),
        ({"z_mm": np.array(["a"] * 40)}, "expected numbers"),
        ({"angle_deg": np.radians(np.arange(0, 360, 10.0))}, "36 angles over 6.1 degrees"),
        ({"z_mm": np.arange(60, 20, -1.0)}, "rising"),
    ],
)
def test_a_raster_file_that_is_not_one_is_one_clear_line(
    tmp_path: Path, changed: dict[str, np.ndarray | None], word: str
) -> None:
    with pytest.raises(AnnulusError, match=word):
        angle, z, channels = read_raster(_file(tmp_path / "m.npz", **changed))
        Raster(np.radians(angle), z, np.stack(list(channels.values())))


def test_a_raster_file_holds_one_channel_or_two(tmp_path: Path) -> None:
    _, _, channels = read_raster(_file(tmp_path / "m.npz", phase_mv=np.ones((36, 40))))
    assert {name: one.shape for name, one in channels.items()} == {"amplitude_mv": (40, 36), "phase_mv": (40, 36)}
    (tmp_path / "no.npz").write_bytes(b"not a file of arrays")
    with pytest.raises(AnnulusError, match=r"no.npz: not a file of arrays"):
        read_raster(tmp_path / "no.npz")
