"""What the reader takes out of a picture's message is what protobuf's own library takes out of it."""

import struct

import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.record import protobuf
from annulus_pipe.record.protobuf import FIXED32


def message(width: int, height: int, encoding: str, data: bytes) -> bytes:
    raw = RawImage(width=width, height=height, encoding=encoding, data=data, frame_id="camera", step=7)
    raw.timestamp.FromNanoseconds(1_700_000_000_123_456_789)
    return bytes(raw.SerializeToString())


def read(packed: bytes) -> tuple[int, int, str, bytes]:
    found = protobuf.fields(memoryview(packed))
    width, height = (protobuf.number(found, of, FIXED32) for of in (2, 3))
    return width, height, protobuf.text(found, 4), bytes(protobuf.content(found, 6))


@given(side=st.integers(0, 2**32 - 1), encoding=st.text(max_size=20), data=st.binary(max_size=400))
def test_fields_are_those_that_were_written(side: int, encoding: str, data: bytes) -> None:
    assert read(message(side, 3, encoding, data)) == (side, 3, encoding, data)


@given(data=st.binary(max_size=200), at=st.integers(0, 300), cut=st.integers(0, 300), put=st.binary(max_size=12))
def test_any_bytes_are_read_as_protobuf_reads_them_or_refused(data: bytes, at: int, cut: int, put: bytes) -> None:
    """Where both read something it is the same; what is refused here alone is a group, or a field of no known kind."""
    packed = message(64, 48, "mono8", data)
    packed = packed[:at] + put + packed[at + len(put) :][: max(0, len(packed) - cut)]
    try:
        ours = read(packed)
    except ValueError:
        return
    try:
        theirs = RawImage.FromString(packed)
    except DecodeError:
        return  # of a field that is not looked at here
    assert ours == (theirs.width, theirs.height, theirs.encoding, theirs.data)


@pytest.mark.parametrize(
    "packed, why",
    [
        (b"\x32\xff\xff\xff\xff\x0f" + b"x" * 9, "longer than its message"),
        (b"\x32" + b"\xff" * 10, "without an end"),
        (b"\x15\x00\x00", "longer than its message"),
        (b"\x33", "of kind 3"),
        (b"\x00\x00", "of number 0"),
        (b"\x10\x01" * 65, "more than 64"),
        (b"\x80", "without an end"),
    ],
)
def test_what_is_no_message_is_refused(packed: bytes, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        protobuf.fields(memoryview(packed))


def test_bytes_are_not_copied() -> None:
    packed = bytearray(message(2, 2, "mono8", b"abcd"))
    content = protobuf.content(protobuf.fields(memoryview(packed)), 6)
    packed[packed.index(b"abcd")] = ord("z")
    assert bytes(content) == b"zbcd"


def test_of_a_field_that_is_there_twice_the_last_counts() -> None:
    twice = b"\x15" + struct.pack("<I", 5) + b"\x15" + struct.pack("<I", 6)
    assert protobuf.number(protobuf.fields(memoryview(twice)), 2, FIXED32) == RawImage.FromString(twice).width == 6
