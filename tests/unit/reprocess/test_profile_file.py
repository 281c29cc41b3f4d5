"""Promises of a range's file: every bit of a profile comes out, or nothing does."""

from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.reprocess.profile_file import packed, unpacked
from annulus_pipe.reprocess.versions import address
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile

RNG = np.random.default_rng(5)


def drawn(frame: int, points: int, roll: float | None = 0.25) -> Profile:
    nan = np.frombuffer(b"\x01\x00\xc0\x7f", "<f4")[0]  # not the usual one
    sigma = RNG.random(points).astype(np.float32)
    sigma[::7] = nan
    xyz = RNG.normal(size=(points, 3)).astype(np.float32)
    xyz[:1] = -0.0
    return Profile(
        frame,
        0.1 + frame / 3,
        Pose(1e-17, -0.0, 1 / 3, 5e-324, roll),
        xyz,
        RNG.integers(0, 256, (points, 3), np.uint8),
        RNG.integers(0, 9, points, np.uint8),
        RNG.integers(0, 4096, points, np.uint16),
        0.07,
        {"crowded": 3, "alone": 0},
        {"polar": 1.25},
        sigma,
        0.012,
        camera=1,
        ring_sigma_mm=RNG.random((9, 2)).astype(np.float32),
        slit_rad=RNG.random(9).astype(np.float32),
    )


def none(frame: int) -> Profile:
    empty = np.zeros(0, np.uint8)
    return Profile(
        frame,
        3.0,
        None,
        np.zeros((0, 3), np.float32),
        np.zeros((0, 3), np.uint8),
        empty,
        empty.astype(np.uint16),
        rejected={"no pipe": 12},
    )


PROFILES = (drawn(3, 500), none(4), drawn(5, 1, None), drawn(6, 777))
ABOUT = {"lights": [[200.0, 0.1, 0.0]] * 4, "processor": "drawn"}


def test_every_bit_comes_out() -> None:
    out, about = unpacked(packed(PROFILES, ABOUT), "a file")
    assert [address(one) for one in out] == [address(one) for one in PROFILES]
    assert {name: about[name] for name in ABOUT} == ABOUT
    for one in out:  # as who measured them had them
        arrays = [getattr(one, name) for name in ("points_mm", "colour", "ring", "direction", "sigma_mm", "seen_by")]
        assert all(array.flags.c_contiguous and array.flags.writeable for array in arrays)
    assert unpacked(packed((), {}), "a file")[0] == ()


def test_columns_say_their_unit() -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    schema = parquet.read_schema(pyarrow.BufferReader(packed(PROFILES, ABOUT)))
    units = {field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in schema}
    assert units["x_mm"] == units["sigma_mm"] == units["tx_mm"] == "mm" and units["rx_rad"] == "rad"
    assert all(units.values())


def test_half_a_file_or_one_with_a_bit_turned_is_one_line() -> None:
    data = packed(PROFILES, ABOUT)
    for place in RNG.integers(0, len(data), 60):
        turned = bytearray(data)
        turned[place] ^= 1 << int(RNG.integers(8))
        try:
            out, about = unpacked(bytes(turned), "a file")
        except AnnulusError as error:
            assert str(error).startswith("a file: ") and "\n" not in str(error)
        else:  # a bit that nothing follows from
            assert [address(one) for one in out] == [address(one) for one in PROFILES]
            assert {name: about[name] for name in ABOUT} == ABOUT
    for size in (0, 3, 100, len(data) // 2, len(data) - 1):
        with pytest.raises(AnnulusError, match="not the profiles of a range"):
            unpacked(data[:size], "a file")


def test_an_address_is_of_every_bit_and_of_no_path() -> None:
    first = PROFILES[0]
    assert address(first) == address(replace(first))
    nudged = first.points_mm.copy()
    nudged[5, 1] = np.nextafter(nudged[5, 1], np.float32(9))
    others = [
        replace(first, points_mm=nudged),
        replace(first, z_mm=np.nextafter(first.z_mm, 9.0)),
        replace(first, rejected={"crowded": 3}),
        replace(first, pose=None, points_mm=first.points_mm),
    ]
    assert len({address(one) for one in [first, *others]}) == 5
    assert address((1, "2")) != address((12, "")) != address(("1", 2)) and address(1) != address(True) != address(1.0)
    with pytest.raises(TypeError):
        address(object())
