"""Golden vectors: every message as bytes, and frames to be refused.

The COBS and CRC here are a third opinion beside the C and the Python codecs.
"""

import hashlib
import struct
from typing import Any

from generator.schema import Field, Message, Protocol


def crc16(data: bytes) -> int:
    """CRC-16, polynomial 0x1021, initial and final xor 0xFFFF, most significant bit first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc ^ 0xFFFF


def cobs(data: bytes) -> bytes:
    """Consistent-overhead byte stuffing of fewer than 254 bytes, delimiter appended."""
    out = bytearray()
    for run in data.split(b"\0"):
        out += bytes([len(run) + 1]) + run
    return bytes(out) + b"\0"


def header(message: Message, sequence: int, boot: int) -> bytes:
    if message.kind == "event":
        return struct.pack("<BHB", message.id, sequence, boot)
    return bytes([message.id]) if message.kind == "notice" else bytes([message.id, sequence])


def frame(body: bytes, schema: int) -> bytes:
    return cobs(body + struct.pack("<H", crc16(body + bytes([schema]))))


def example(protocol: Protocol, message: Message, field: Field, style: str) -> int | bytes:
    """A legal value of a field: 'zero', 'ones' (the largest) or 'mixed' (any, but always the same)."""
    seed = hashlib.sha256(f"{message.kind} {message.name} {field.name}".encode()).digest()
    if field.type.startswith("bytes"):
        return {"zero": bytes(field.size), "ones": b"\xff" * field.size, "mixed": seed[: field.size]}[style]
    if field.enum:
        values = sorted(protocol.enums[field.enum].values())
        return {"zero": values[0], "ones": values[-1], "mixed": values[seed[0] % len(values)]}[style]
    signed = field.type == "i32"
    top = field.top
    if field.flags:
        top = sum(protocol.flags[field.flags].values())
        return {"zero": 0, "ones": top, "mixed": seed[0] & top}[style]
    low, high = field.min or 0, top if field.max is None else field.max
    if style == "mixed":
        value = low + int.from_bytes(seed[:4], "big") % (high - low + 1)
        return -value if signed else value
    return {"zero": low, "ones": -1 if signed else high}[style]


def vectors(protocol: Protocol) -> dict[str, Any]:
    good = []
    for number, message in enumerate(protocol.messages):
        for turn, style in enumerate(("zero", "ones", "mixed")):
            values = [example(protocol, message, field, style) for field in message.fields]
            sequence = {"event": (0, 0xFFFF, 0x1200 + number), "notice": (0, 0, 0)}.get(
                message.kind, (0, 0xFF, 0x20 + number)
            )[turn]
            boot = (0, 0xFF, 0x5A)[turn] if message.kind == "event" else 0
            body = header(message, sequence, boot) + pack(message, values)
            good.append(
                {
                    "name": message.name,
                    "kind": message.kind,
                    "id": message.id,
                    "sequence": sequence,
                    "boot": boot,
                    "fields": {
                        field.name: value.hex() if isinstance(value, bytes) else value
                        for field, value in zip(message.fields, values, strict=True)
                    },
                    "body": body.hex(),
                    "wire": frame(body, message.schema).hex(),
                }
            )
    return {
        "schema_hash": protocol.schema_hash,
        "crc_check": {"text": "123456789", "crc": crc16(b"123456789")},
        "messages": good,
        "bad": bad_frames(protocol),
    }


def bad_frames(protocol: Protocol) -> list[dict[str, str]]:
    """Frames a receiver must refuse, with the reason. `to` says who receives them."""
    by_name = {(message.kind, message.name): message for message in protocol.messages}
    bad: list[dict[str, str]] = []

    def add(to: str, reason: str, doc: str, wire: bytes) -> None:
        bad.append({"to": to, "reason": reason, "doc": doc, "wire": wire.hex()})

    for to, kind, name in (("controller", "command", "stage"), ("host", "event", "edge"), ("host", "reply", "ping")):
        message = by_name[kind, name]
        values = [example(protocol, message, field, "mixed") for field in message.fields]
        body = header(message, 7, 3) + pack(message, values)
        wire = frame(body, message.schema)
        flipped = bytearray(wire)
        flipped[-3] ^= 0x10 if flipped[-3] != 0x10 else 0x20
        add(to, "crc", f"{name}: one bit flipped in the CRC", bytes(flipped))
        add(to, "crc", f"{name}: right layout, another version's schema byte", frame(body, message.schema ^ 1))
        add(to, "length", f"{name}: last payload byte missing, CRC right", frame(body[:-1], message.schema))
        add(to, "length", f"{name}: one payload byte too many, CRC right", frame(body + b"\1", message.schema))
        add(to, "cobs", f"{name}: code byte points past the end", bytes([0xF0]) + wire[1:])
        add(to, "cobs", f"{name}: cut short, as after a lost delimiter's neighbour", wire[: wire[0]][:1] + b"\0")
        add(to, "too_long", f"{name}: longer than any frame may be", cobs(body + bytes([1]) * 80))
    for to, kind, name in (("controller", "command", "ping"), ("host", "event", "turntable_done")):
        message = by_name[kind, name]
        body = header(message, 9, 1) + bytes(message.length)
        add(to, "id", f"{name}'s layout under an id nobody has", frame(b"\x3f" + body[1:], message.schema))
        add(to, "length", "a lone byte", cobs(b"\x02"))
    add("controller", "id", "a reply is no command", frame(bytes([0x42, 1, 0, 0, 1, 2, 3, 4]), 0))
    add("host", "id", "a command is no reply", frame(bytes([0x02, 1]), by_name["command", "ping"].schema))
    return bad


def pack(message: Message, values: list[int | bytes]) -> bytes:
    return struct.pack("<" + "".join(field.code for field in message.fields), *values)
