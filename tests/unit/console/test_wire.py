"""The layouts that the page reads with a DataView: as the README says them, byte by byte."""

import json
import math
import re
import struct
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from annulus_pipe.console import wire

README = (Path(wire.__file__).parent / "README.md").read_text(encoding="utf-8")
U32 = st.integers(0, 2**32 - 1)


def test_the_kinds_are_the_readmes() -> None:
    listed = dict(re.findall(r"^\| (\d) (\w+) \|", README, re.M))
    assert listed == {
        str(number): name.lower()
        for name, number in vars(wire).items()
        if name in ("STATUS", "PICTURE", "POINTS", "WALL", "ROWS", "SLITS")
    }


def test_headers_are_as_long_as_the_readme_says() -> None:
    told = re.search(
        r"2 has its header in (\d+) bytes.*?3 in (\d+), 4 in (\d+) .*?5 in (\d+),\s*6 in (\d+)", README, re.S
    )
    assert told is not None
    empty = np.zeros((0, 3), np.float32)
    assert [int(one) for one in told.groups()] == [
        len(wire.picture(0, 0, 0, None, 0.0, b"")),
        len(wire.points(0, 0, empty, empty.astype(np.uint8))),
        len(wire.wall("recent", 0, 5.0, 75.0, 1, 360, [])),
        len(wire.rows(0, 0, 0, b"")),
        len(wire.slits(0, 0, b"")),
    ]


def test_a_points_message_is_these_bytes() -> None:
    """A right example, for whoever writes another reader."""
    message = wire.points(3, 7, np.array([[1.0, -2.0, 0.5]], np.float32), np.array([[255, 0, 16]], np.uint8))
    assert message == bytes.fromhex("03 03 0000 07000000 01000000 0000803f 000000c0 0000003f ff0010")


@given(st.integers(0, 7), st.integers(0, 2), U32, st.none() | st.floats(-1e6, 1e6, width=32), st.binary(max_size=40))
def test_a_picture_is_read_back(camera: int, label: int, index: int, z_mm: float | None, jpeg: bytes) -> None:
    message = wire.picture(camera, label, index, z_mm, 1.7e9 + 0.25, jpeg)
    kind, *head, z, published = struct.unpack_from("<BBBBIfd", message)
    assert (kind, head, published, message[20:]) == (2, [camera, label, 0, index], 1.7e9 + 0.25, jpeg)
    assert math.isnan(z) if z_mm is None else z == z_mm


@given(
    st.integers(0, 3),
    U32,
    hnp.arrays(np.float32, st.tuples(st.integers(0, 20), st.just(3)), elements={"allow_nan": False}),
)
def test_points_are_read_back(flags: int, frame: int, xyz: "np.ndarray[tuple[int, int], np.dtype[np.float32]]") -> None:
    rgb = (np.arange(xyz.size) % 256).astype(np.uint8).reshape(-1, 3)
    message = wire.points(flags, frame, xyz, rgb)
    n = len(xyz)
    assert struct.unpack_from("<BBHII", message) == (3, flags, 0, frame, n)
    assert np.array_equal(np.frombuffer(message, "<f4", 3 * n, 12).reshape(-1, 3), xyz)
    assert message[12 + 12 * n :] == rgb.tobytes()


@given(st.sampled_from(["recent", "whole"]), st.integers(-(2**31), 2**31 - 1), U32, st.integers(0, 5))
def test_a_wall_is_read_back(of: str, first: int, scan: int, count: int) -> None:
    rows = [struct.pack("<4h", row, -1, -32768, 32767) for row in range(count)]
    message = wire.wall(of, first, 5.0, 75.0, scan, 4, rows)
    head = struct.unpack_from("<BBHIiffI", message)
    assert head == (4, ["recent", "whole"].index(of), 4, count, first, 5.0, 75.0, scan)
    assert message[24:] == b"".join(rows)


@given(U32, st.lists(st.floats(0, 255, width=32), max_size=64))
def test_rows_are_read_back(index: int, light: list[float]) -> None:
    message = wire.rows(1, 2, index, struct.pack(f"<{len(light)}f", *light))
    assert struct.unpack_from("<BBBBIHH", message) == (5, 1, 2, 0, index, len(light), 0)
    assert list(struct.unpack_from(f"<{len(light)}f", message, 12)) == light


@given(U32, st.binary(max_size=20))
def test_slits_are_read_back(index: int, rings: bytes) -> None:
    n = len(rings)
    message = wire.slits(3, index, struct.pack(f"<{2 * n}h", *range(2 * n)) + rings)
    assert struct.unpack_from("<BBHI", message) == (6, 3, n, index)
    assert list(struct.unpack_from(f"<{2 * n}h", message, 8)) == list(range(2 * n))
    assert message[8 + 4 * n :] == rings


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary(max_size=9),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text() | st.integers(), inner, max_size=4),
    max_leaves=12,
)


@given(VALUES)
def test_whatever_the_daemon_says_is_json_that_a_browser_reads(body: object) -> None:
    message = wire.status("telemetry", body)

    def no_constant(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    read = json.loads(message[1:].decode("utf-8"), parse_constant=no_constant)
    assert message[0] == 1 and read["topic"] == "telemetry" and set(read) == {"topic", "body"}
