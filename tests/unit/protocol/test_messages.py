"""messages.toml and everything made from it: fresh, consistent, reversible."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe import vocabulary
from annulus_pipe.link import messages
from annulus_pipe.link.fields import Message
from annulus_pipe.vocabulary import AnnulusError

PROTOCOL = Path(__file__).resolve().parents[3] / "protocol"
VECTORS: dict[str, Any] = json.loads((PROTOCOL / "vectors.json").read_text())
HEADER = {"command": 2, "reply": 2, "event": 4, "notice": 1}


def crc16(data: bytes) -> int:
    """Bit by bit, written from the README's prose alone."""
    crc = 0xFFFF
    for bit in (byte >> shift & 1 for byte in data for shift in range(7, -1, -1)):
        crc = (crc << 1 & 0xFFFF) ^ (0x1021 if (crc >> 15) ^ bit else 0)
    return crc ^ 0xFFFF


def unstuff(wire: bytes) -> bytes:
    assert wire[-1] == 0 and 0 not in wire[:-1]
    out, rest = b"", wire[:-1]
    while rest:
        out += rest[1 : rest[0]] + b"\0"
        rest = rest[rest[0] :]
    return out[:-1]


def fields_of(message: Message) -> dict[str, Any]:
    values = {name: getattr(message, name) for name in message.FIELDS}
    return {name: value.hex() if isinstance(value, bytes) else int(value) for name, value in values.items()}


def test_generated_files_are_fresh() -> None:
    run = subprocess.run([sys.executable, PROTOCOL / "generate.py", "--check"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("vector", VECTORS["messages"], ids=lambda v: f"{v['kind']}-{v['name']}-{v['sequence']}")
def test_every_golden_vector_is_reproduced(vector: dict[str, Any]) -> None:
    body, wire = bytes.fromhex(vector["body"]), bytes.fromhex(vector["wire"])
    cls = messages.MESSAGES[vector["id"]]
    payload = body[HEADER[vector["kind"]] :]
    message = cls.unpack(payload)
    assert fields_of(message) == vector["fields"]
    assert message.pack() == payload
    assert unstuff(wire) == body + crc16(body + bytes([cls.SCHEMA_BYTE])).to_bytes(2, "little")
    assert len(wire) <= messages.MAX_WIRE


def test_the_crc_is_the_one_named_in_the_readme() -> None:
    check = VECTORS["crc_check"]
    assert crc16(check["text"].encode()) == check["crc"] == 0xD64E  # CRC-16/GENIBUS


def test_the_schema_is_one_for_both_sides() -> None:
    assert VECTORS["schema_hash"] == messages.SCHEMA_HASH
    header = (PROTOCOL.parent / "firmware/core/messages.h").read_text()
    assert f"#define SCHEMA_HASH 0x{messages.SCHEMA_HASH:08X}U" in header


def test_what_is_frozen_has_not_moved() -> None:
    """Ids 0 and 1 are readable by every host there will ever be. Never mend this test; a new layout is a new id."""
    assert (messages.Identify.ID, messages.Identify.LAYOUT.format) == (0, "<BI")
    assert (messages.Reset.ID, messages.Reset.LAYOUT.format) == (1, "<I")
    assert messages.IdentifyReply.LAYOUT.format == "<BBBIBBI8s8sIHHH"
    assert messages.ResetReply.LAYOUT.format == "<BB"
    frozen = (messages.Identify, messages.IdentifyReply, messages.Reset, messages.ResetReply, messages.Garbled)
    assert {cls.SCHEMA_BYTE for cls in frozen} == {0xA5}
    assert messages.RESET_MAGIC == 0x7E5E7B00


def test_vocabulary_and_wire_name_lamps_and_edge_flags_alike() -> None:
    import tomllib

    def values(members: dict[str, Any]) -> dict[str, int]:
        return {name: value["value"] if isinstance(value, dict) else value for name, value in members.items()}

    raw = tomllib.loads((PROTOCOL / "messages.toml").read_text())
    assert {member.name.lower(): member.value for member in vocabulary.Lamp} == values(raw["enums"]["lamp"])
    assert {str(member.name).lower(): member.value for member in vocabulary.EdgeFlag} == values(raw["flags"]["edge"])


@given(st.sampled_from(sorted(messages.MESSAGES)), st.data())
def test_any_payload_of_the_right_length_unpacks_to_itself_or_not_at_all(number: int, data: st.DataObject) -> None:
    cls = messages.MESSAGES[number]
    payload = data.draw(st.binary(min_size=cls.LENGTH, max_size=cls.LENGTH))
    try:
        message = cls.unpack(payload)
    except ValueError:
        return  # an enumeration value nobody defined
    assert message.pack() == payload


@given(st.sampled_from(sorted(messages.MESSAGES)), st.binary(max_size=64))
def test_a_payload_of_another_length_is_refused(number: int, payload: bytes) -> None:
    cls = messages.MESSAGES[number]
    if len(payload) != cls.LENGTH:
        with pytest.raises(ValueError):
            cls.unpack(payload)


def test_a_value_too_large_for_its_field_is_one_clear_line() -> None:
    with pytest.raises(AnnulusError, match="commit"):
        messages.Commit(generation=256).pack()
    with pytest.raises(AnnulusError, match="33 bytes where 32 fit"):
        messages.Pattern(length=256, chips=bytes(33)).pack()


def test_the_bytes_shown_in_the_readme_are_right() -> None:
    prose = (PROTOCOL / "README.md").read_text()
    right = next(line for line in prose.splitlines() if line.strip().startswith("right"))
    wire = bytes.fromhex(right.split("body")[0].split("right")[1])
    body = bytes([messages.Commit.ID, 16]) + messages.Commit(generation=1).pack()
    assert unstuff(wire) == body + crc16(body + bytes([messages.Commit.SCHEMA_BYTE])).to_bytes(2, "little")
    assert f"schema byte {messages.Commit.SCHEMA_BYTE:#04x}" in prose


def test_what_was_added_is_no_part_of_the_hash() -> None:
    """Hosts and controllers of level 1 go on working together: this hash never changes again."""
    assert messages.SCHEMA_HASH == 0xD49BD1EB
