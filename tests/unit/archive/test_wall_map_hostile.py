"""Whatever a file that should be a wall map holds: a map, or one line, in memory that its size bounds."""

import io
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.archive.wall_map import CELLS_MAX, read_map
from annulus_pipe.vocabulary import AnnulusError

ROWS, COLUMNS = 20, 24
WHOLE: dict[str, Any] = {
    "format": "annulus-wall/1",
    "deviation_um": np.arange(ROWS * COLUMNS, dtype=np.int16).reshape(ROWS, COLUMNS),
    "shadowed": np.zeros((ROWS, COLUMNS), bool),
    "z_step_mm": 4.0,
    "radius_mm": 76.2,
    "z_mm": 4.0 * np.arange(ROWS),
    "clock_deg": 15.0 * np.arange(COLUMNS),
    "imu_roll_deg": np.zeros(ROWS, np.float32),
}
TYPES = ("i1", "i2", ">i2", "u2", "i8", "f2", "f4", ">f8", "g", "c16", "?", "S3", "U3", "O", "M8[s]", "V4", "i4,f8")
SHAPES = ((), (0,), (ROWS,), (COLUMNS,), (ROWS, COLUMNS), (COLUMNS, ROWS), (1, ROWS, COLUMNS), (ROWS, 0), (1,) * 32)
NUMBERS = (0, 1, -1, 4.0, 76.2, 1e8, -1e300, 1e300, np.nan, np.inf, -np.inf)
SIDES = (0, 1, ROWS, 2**20, 2**31, 2**40, 2**62, -1)


def packed(arrays: dict[str, Any], how: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", how) as archive:
        for name, value in arrays.items():
            part = io.BytesIO()
            np.save(part, np.asanyarray(value), allow_pickle=True)
            archive.writestr(f"{name}.npy", part.getvalue())
    return out.getvalue()


def head(kind: str, shape: tuple[int, ...]) -> bytes:
    about = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(about)) + about


@st.composite
def hostile(draw: st.DrawFn) -> bytes:
    """A map of which one array is another, or one's head lies, or with bytes changed, cut, or put in."""
    arrays = dict(WHOLE)
    name = draw(st.sampled_from(sorted(WHOLE)))
    way = draw(st.integers(0, 3))
    if way == 0:
        kind, shape = np.dtype(draw(st.sampled_from(TYPES))), draw(st.sampled_from(SHAPES))
        with np.errstate(all="ignore"):
            if kind.kind in "iufcg":
                number = draw(st.sampled_from(NUMBERS))
                plain = number if kind.kind in "fcg" or abs(number) < 100 else 1
                arrays[name] = np.full(shape, plain).astype(kind)
            else:
                arrays[name] = np.zeros(shape, kind)
        return packed(arrays)
    if way == 1:
        del arrays[name]
        out = io.BytesIO(packed(arrays))
        shape = tuple(draw(st.lists(st.sampled_from(SIDES), max_size=3)))
        with zipfile.ZipFile(out, "a", zipfile.ZIP_DEFLATED) as archive:
            content = head(draw(st.sampled_from(("<i2", "<f8", "|O", "<U99999999", "|b1"))), shape)
            archive.writestr(f"{name}.npy", content + draw(st.binary(max_size=100)))
        return out.getvalue()
    data = bytearray(packed(arrays, draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))))
    at = draw(st.integers(0, len(data) - 1))
    if way == 2:
        return bytes(data[:at])
    data[at : at + draw(st.integers(0, 8))] = draw(st.binary(max_size=8))
    return bytes(data)


def read(path: Path, data: bytes) -> int:
    """Bytes of memory that it took at most."""
    path.write_bytes(data)
    tracemalloc.start()
    try:
        wall = read_map(path)
        assert wall.deviation_mm.ndim == 2 and np.isfinite(wall.deviation_mm).any()
        assert wall.imu_roll_deg.shape == (len(wall.deviation_mm),)
        assert np.isfinite([wall.step_mm, wall.radius_mm]).all()
    except AnnulusError as error:
        assert str(path) in str(error) and "\n" not in str(error) and str(error).isprintable()
    finally:
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return most


@settings(deadline=None, max_examples=200)
@given(data=hostile())
def test_a_damaged_map_is_a_map_or_one_line(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    assert read(tmp_path_factory.getbasetemp() / "wall.npz", data) < 4 << 20  # bytes; 0.3 measured


def test_a_bomb_takes_no_more_memory_than_a_map_may(tmp_path: Path) -> None:
    path = tmp_path / "wall.npz"
    for name, kind in (("z_mm", "<f8"), ("format", "<U1"), ("sigma_um", "<u2"), ("deviation_um", "<i2")):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for other, value in WHOLE.items():
                if other != name:
                    part = io.BytesIO()
                    np.save(part, np.asanyarray(value))
                    archive.writestr(f"{other}.npy", part.getvalue())
            size = (1 << 26) // 2 - 200  # of two bytes: what may be packed however tightly
            shape = (size * 2 // np.dtype(kind).itemsize,)
            with archive.open(f"{name}.npy", "w") as file:
                file.write(head(kind, shape))
                for _ in range(64):
                    file.write(bytes(size * 2 // 64))
        assert path.stat().st_size < 1 << 18
        assert read(path, path.read_bytes()) < 1 << 27  # bytes


def test_no_object_is_ever_unpickled(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return (pytest.fail, ("unpickled",))

    read(tmp_path / "wall.npz", packed(WHOLE | {"deviation_um": np.array([Trap()], dtype=object)}))
    assert CELLS_MAX * 4 < 1 << 30  # bytes of the largest map
