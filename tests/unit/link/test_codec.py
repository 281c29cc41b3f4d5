"""What crosses the wire arrives as it was sent, or not at all."""

import json
import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.link.codec import TO_CONTROLLER, TO_HOST, Corrupt, CorruptReason, Decoder, Frame, crc16, encode
from annulus_pipe.link.fields import Message
from annulus_pipe.link.messages import EVENTS, MAX_WIRE, MESSAGES, Notice

VECTORS = Path(__file__).parents[3] / "protocol" / "vectors.json"


def any_frame(random_: random.Random, identities: list[int]) -> Frame:
    identity = random_.choice(identities)
    kind: type[Message] = MESSAGES[identity]
    while True:
        payload = bytes(random_.choice((0, 0, 1, 2, 255, random_.randrange(256))) for _ in range(kind.LENGTH))
        try:
            message = kind.unpack(payload)
        except ValueError:
            continue
        is_event = identity in EVENTS
        sequence = 0 if issubclass(kind, Notice) else random_.randrange(65536 if is_event else 256)
        return Frame(message, sequence, random_.randrange(256) if is_event else 0)


def cut(data: bytes, random_: random.Random) -> list[bytes]:
    at = sorted(random_.randrange(len(data) + 1) for _ in range(random_.randrange(12)))
    return [data[a:b] for a, b in zip([0, *at], [*at, len(data)], strict=True)]


@given(st.randoms(use_true_random=False))
@settings(max_examples=60, derandomize=True, deadline=None)
def test_every_message_arrives_whole_however_the_bytes_are_cut(random_: random.Random) -> None:
    for accepted in (TO_HOST, TO_CONTROLLER):
        sent = [any_frame(random_, list(accepted)) for _ in range(8)]
        decoder = Decoder(accepted)
        wire = b"".join(encode(frame) for frame in sent)
        assert [frame for chunk in cut(wire, random_) for frame in decoder.feed(chunk)] == sent
        assert all(len(encode(frame)) <= MAX_WIRE for frame in sent)


@given(st.randoms(use_true_random=False))
@settings(max_examples=100, derandomize=True, deadline=None)
def test_damage_never_delivers_a_message_that_was_not_sent(random_: random.Random) -> None:
    sent = [any_frame(random_, list(TO_HOST)) for _ in range(8)]
    wire = bytearray(b"".join(encode(frame) for frame in sent))
    faults = random_.randrange(1, 6)
    for _ in range(faults):
        at = random_.randrange(len(wire))
        match random_.randrange(4):
            case 0:
                del wire[at]
            case 1:
                wire[at] ^= 1 << random_.randrange(8)
            case 2:
                wire.insert(at, random_.randrange(256))
            case _:
                wire.insert(at, wire[at])
    decoder = Decoder()
    got = [frame for chunk in cut(bytes(wire), random_) for frame in decoder.feed(chunk)]
    frames = [frame for frame in got if isinstance(frame, Frame)]
    remaining = iter(sent)
    assert all(any(frame == other for other in remaining) for frame in frames)  # a subsequence: nothing new, no swap
    assert len(frames) >= len(sent) - 2 * faults  # a fault costs its frame, at most its neighbour


def test_one_dropped_zero_never_goes_unseen() -> None:
    random_ = random.Random(5)
    passed = 0
    for _ in range(4000):
        frame = any_frame(random_, list(TO_HOST))
        stuffed = bytearray(encode(frame)[:-1])
        del stuffed[random_.randrange(len(stuffed))]
        passed += any(isinstance(found, Frame) for found in Decoder().feed(bytes(stuffed) + b"\0"))
    assert passed == 0


def test_noise_without_end_is_held_to_one_frame() -> None:
    decoder = Decoder()
    for _ in range(100):
        assert decoder.feed(b"\x55" * 1000) == []
    (corrupt,) = decoder.feed(b"\0")
    assert isinstance(corrupt, Corrupt) and corrupt.why == "too_long" and corrupt.size == 100_000
    assert len(decoder._held) <= MAX_WIRE


@pytest.mark.parametrize("vector", json.loads(VECTORS.read_text())["messages"], ids=lambda v: f"{v['name']}")
def test_golden_vector_is_read_and_written(vector: dict) -> None:
    wire = bytes.fromhex(vector["wire"])
    (frame,) = Decoder(MESSAGES).feed(wire)
    assert isinstance(frame, Frame) and encode(frame) == wire
    assert (frame.message.ID, frame.sequence, frame.boot) == (vector["id"], vector["sequence"], vector["boot"])
    for name, value in vector["fields"].items():
        found = getattr(frame.message, name)
        assert (found.hex() if isinstance(found, bytes) else int(found)) == value, name


@pytest.mark.parametrize("bad", json.loads(VECTORS.read_text())["bad"], ids=lambda b: f"{b['to']}: {b['doc']}")
def test_bad_frame_is_refused_for_the_reason_given(bad: dict) -> None:
    found = Decoder(TO_HOST if bad["to"] == "host" else TO_CONTROLLER).feed(bytes.fromhex(bad["wire"]))
    assert len(found) == 1 and isinstance(found[0], Corrupt), found
    if found[0].why != CorruptReason.ID:  # an id not for this direction is refused before its CRC is looked at
        assert found[0].why == bad["reason"]


def test_crc_is_the_one_the_protocol_names() -> None:
    check = json.loads(VECTORS.read_text())["crc_check"]
    text = check["text"].encode()
    assert crc16(text[:-1], text[-1]) == check["crc"] == 0xD64E  # CCITT-FALSE's 0x29B1 with the xorout
