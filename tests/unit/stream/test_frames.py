"""Promises about what is said of a frame: it comes back as it was sent, and nothing else comes in."""

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import Label

HEADERS = st.builds(
    FrameHeader,
    index=st.integers(0, 2**32 - 1),
    sequence=st.none() | st.integers(0, 2**63),
    timestamp_ns=st.integers(0, 2**63),
    label=st.sampled_from(Label),
    reason=st.text(max_size=200),
    edge=st.none() | st.integers(0, 2**32 - 1),
    slot=st.none() | st.integers(0, 62),
    odometer=st.none() | st.integers(-(2**31), 2**31 - 1),
    z_mm=st.none() | st.floats(-1e9, 1e9),
    encoding=st.sampled_from(["bgr8", "bayer_rggb8", "mono8"]),
    width=st.integers(1, 16384),
    height=st.integers(1, 16384),
    roll_deg=st.none() | st.floats(-1e9, 1e9),
    camera=st.integers(0, 7),
    arrived_ns=st.none() | st.integers(0, 2**63),
    z_assumed=st.booleans(),
    z_bound_mm=st.floats(0, 1e9),
    segment=st.integers(0, 2**31 - 1),
)


@given(HEADERS)
def test_a_header_comes_back_as_it_was_sent(header: FrameHeader) -> None:
    assert FrameHeader.unpack(header.pack()) == header


@given(HEADERS, st.integers(0, 200), st.integers(0, 255))
def test_a_damaged_header_is_a_value_error_or_a_valid_header(header: FrameHeader, at: int, value: int) -> None:
    packed = bytearray(header.pack())
    packed[at % len(packed)] = value
    try:
        again = FrameHeader.unpack(bytes(packed))
    except ValueError:
        return
    assert FrameHeader.unpack(again.pack()) == again


@given(st.binary(max_size=400))
def test_noise_is_a_value_error(noise: bytes) -> None:
    with pytest.raises(ValueError):
        FrameHeader.unpack(noise)


@pytest.mark.parametrize(
    "field, value",
    [
        ("width", 0),
        ("height", 1 << 20),
        ("label", "both"),
        ("encoding", "jpeg"),
        ("index", -1),
        ("index", True),
        ("reason", "x" * 201),
        ("z_mm", float("nan")),
        ("z_mm", "3"),
        ("slot", 63),
        ("timestamp_ns", 1.5),
        ("arrived_ns", -1),
        ("z_assumed", 1),
        ("segment", -1),
        ("segment", 2**31),
    ],
)
def test_a_value_out_of_range_is_named(field: str, value: object) -> None:
    good = {
        "index": 1,
        "sequence": 2,
        "timestamp_ns": 3,
        "label": "led",
        "reason": "",
        "edge": 4,
        "slot": 4,
        "odometer": 5,
        "z_mm": 1.0,
        "encoding": "mono8",
        "width": 10,
        "height": 10,
    }
    old = FrameHeader.from_dict(good)  # as recordings of before there was more to say
    assert old.size == 100 and (old.arrived_ns, old.z_assumed, old.segment) == (None, False, 0)
    with pytest.raises(ValueError, match=field):
        FrameHeader.unpack(msgpack.packb({**good, field: value}))
