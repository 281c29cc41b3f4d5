#!/usr/bin/env python3
"""Makes every file that depends on messages.toml. `--check` writes nothing and fails when a committed file is stale.

Standard library only: the firmware build and CI run it before any environment exists. It carries its own small COBS
and CRC, so the golden vectors are a third opinion beside the C and the Python codecs.
"""

import hashlib
import json
import struct
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
FROZEN_SCHEMA_BYTE = 0xA5  # of messages that any host must be able to exchange with any controller
REPLY_BIT = 0x40

SCALARS = {  # type: (struct code, C type, bytes)
    "u8": ("B", "uint8_t", 1),
    "u16": ("H", "uint16_t", 2),
    "u32": ("I", "uint32_t", 4),
    "i32": ("i", "int32_t", 4),
}
# Python names of enumerations: the message classes own the short ones, vocabulary.py owns two of these outright.
ENUM_NAMES = {
    "status": "StatusCode",
    "lamp": "Lamp",
    "fault": "FaultCode",
    "boot_cause": "BootCause",
    "burst_code": "BurstCode",
}
FLAG_NAMES = {"edge": "EdgeFlag", "state": "StateFlag", "arm": "ArmFlag"}
FROM_VOCABULARY = ("EdgeFlag", "Lamp")


@dataclass(frozen=True)
class Field:
    name: str
    type: str
    unit: str = ""
    doc: str = ""
    enum: str = ""
    flags: str = ""
    min: int | None = None
    max: int | None = None

    @property
    def size(self) -> int:
        return int(self.type[5:]) if self.type.startswith("bytes") else SCALARS[self.type][2]

    @property
    def code(self) -> str:
        return f"{self.size}s" if self.type.startswith("bytes") else SCALARS[self.type][0]

    @property
    def python(self) -> str:
        if self.enum:
            return ENUM_NAMES[self.enum]
        if self.flags:
            return FLAG_NAMES[self.flags]
        return "bytes" if self.type.startswith("bytes") else "int"


@dataclass(frozen=True)
class Message:
    kind: str  # command, reply, event, notice
    name: str
    id: int
    doc: str
    fields: tuple[Field, ...]
    frozen: bool = False
    query: bool = False

    @property
    def length(self) -> int:
        return sum(field.size for field in self.fields)

    @property
    def camel(self) -> str:
        return camel(self.name) + ("Reply" if self.kind == "reply" else "")

    @property
    def layout(self) -> str:
        """Canonical text of what both sides must agree on; documentation is not part of it."""
        return f"{self.kind} {self.name} {self.id:#04x} " + " ".join(
            f"{f.name}:{f.type}:{f.unit}:{f.enum or f.flags}:{f.min}:{f.max}" for f in self.fields
        )

    @property
    def schema(self) -> int:
        return FROZEN_SCHEMA_BYTE if self.frozen else hashlib.sha256(self.layout.encode()).digest()[0]


def camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


@dataclass(frozen=True)
class Protocol:
    constants: dict[str, int]
    limits: dict[str, int]
    enums: dict[str, dict[str, int]]
    flags: dict[str, dict[str, int]]
    messages: tuple[Message, ...]

    @property
    def schema_hash(self) -> int:
        text = json.dumps([self.constants, self.limits, self.enums, self.flags], sort_keys=True)
        text += "\n".join(message.layout for message in self.messages)
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")

    def of(self, kind: str) -> list[Message]:
        return [message for message in self.messages if message.kind == kind]


def load(path: Path) -> Protocol:
    """Read and check the message file; whatever is wrong there is an assertion here."""
    raw = tomllib.loads(path.read_text())
    status = Field("status", "u8", enum="status", doc="ok, or why not")
    detail = Field("detail", "u8", doc="which field or lamp, see status")
    messages: list[Message] = []
    for kind in ("command", "event", "notice"):
        for entry in raw[kind]:
            fields = tuple(Field(**field) for field in entry["fields"])
            frozen, query = entry.get("frozen", False), entry.get("query", False)
            messages.append(Message(kind, entry["name"], entry["id"], entry["doc"], fields, frozen, query))
            if kind == "command":
                reply = (status, detail, *(Field(**field) for field in entry["reply"]))
                doc = f"Answer to {entry['name']}."
                messages.append(Message("reply", entry["name"], entry["id"] + REPLY_BIT, doc, reply, frozen))
    ids = [message.id for message in messages]
    assert len(set(ids)) == len(ids), "an id is used twice"
    for message in messages:
        worst = HEADER_SIZE[message.kind] + message.length + 2 + 2  # crc; COBS code byte and delimiter
        assert worst <= raw["protocol"]["max_wire"], f"{message.name}: {worst} bytes on the wire"
        names = [field.name for field in message.fields]
        assert len(set(names)) == len(names), f"{message.name}: a field name is used twice"
    return Protocol(raw["protocol"], raw["limits"], raw["enums"], raw["flags"], tuple(messages))


HEADER_SIZE = {"command": 2, "reply": 2, "event": 4, "notice": 1}


# ---- the reference codec ---------------------------------------------------------------------------------------------


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


# ---- golden vectors --------------------------------------------------------------------------------------------------


def example(protocol: Protocol, message: Message, field: Field, style: str) -> int | bytes:
    """A legal value of a field: 'zero', 'ones' (the largest) or 'mixed' (any, but always the same)."""
    seed = hashlib.sha256(f"{message.kind} {message.name} {field.name}".encode()).digest()
    if field.type.startswith("bytes"):
        return {"zero": bytes(field.size), "ones": b"\xff" * field.size, "mixed": seed[: field.size]}[style]
    if field.enum:
        values = sorted(protocol.enums[field.enum].values())
        return {"zero": values[0], "ones": values[-1], "mixed": values[seed[0] % len(values)]}[style]
    signed = field.type == "i32"
    top = (1 << (8 * field.size - signed)) - 1
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
    for to, kind, name in (("controller", "command", "ping"), ("host", "event", "stage_done")):
        message = by_name[kind, name]
        body = header(message, 9, 1) + bytes(message.length)
        add(to, "id", f"{name}'s layout under an id nobody has", frame(b"\x3f" + body[1:], message.schema))
        add(to, "length", "a lone byte", cobs(b"\x02"))
    add("controller", "id", "a reply is no command", frame(bytes([0x42, 1, 0, 0, 1, 2, 3, 4]), 0))
    add("host", "id", "a command is no reply", frame(bytes([0x02, 1]), by_name["command", "ping"].schema))
    return bad


def pack(message: Message, values: list[int | bytes]) -> bytes:
    return struct.pack("<" + "".join(field.code for field in message.fields), *values)


# ---- C ---------------------------------------------------------------------------------------------------------------

GENERATED = "Generated by protocol/generate.py from messages.toml. Do not edit."


def c_field(field: Field) -> str:
    if field.type.startswith("bytes"):
        return f"uint8_t {field.name}[{field.size}]"
    return f"{SCALARS[field.type][1]} {field.name}"


def c_header(protocol: Protocol) -> str:
    out = [f"// {GENERATED}", "// clang-format off", "#ifndef ANNULUS_MESSAGES_H", "#define ANNULUS_MESSAGES_H", ""]
    out += ["#include <stdint.h>", "", f"#define SCHEMA_HASH 0x{protocol.schema_hash:08X}U"]
    out += [f"#define PROTOCOL_{name.upper()} {value}U" for name, value in protocol.constants.items()]
    out += [f"#define LIMIT_{name.upper()} {value}U" for name, value in protocol.limits.items()]
    out.append(f"#define REPLY_BIT 0x{REPLY_BIT:02X}U")
    out.append(f"#define PAYLOAD_MAX {max(message.length for message in protocol.messages)}U")
    out.append(f"#define EVENT_PAYLOAD_MAX {max(message.length for message in protocol.of('event'))}U")
    for name, members in protocol.enums.items():
        out += ["", "enum {"]
        out += [f"    {name.upper()}_{member.upper()} = {value}," for member, value in members.items()] + ["};"]
    for name, members in protocol.flags.items():
        out.append("")
        out += [f"#define {name.upper()}_{member.upper()} {value}U" for member, value in members.items()]
    out += ["", "enum {"]
    out += [f"    {m.kind.upper()}_{m.name.upper()} = 0x{m.id:02X}," for m in protocol.messages] + ["};"]
    for message in protocol.messages:
        stem = f"{message.kind}_{message.name}"
        out += ["", f"// {message.doc}", f"#define {stem.upper()}_LENGTH {message.length}U"]
        if not message.fields:
            continue
        out.append("typedef struct {")
        for field in message.fields:
            note = ", ".join(text for text in (field.unit, field.doc) if text)
            out.append(f"    {c_field(field)};" + (f"  // {note}" if note else ""))
        out.append(f"}} {stem}_t;")
        out.append(f"void {stem}_pack(const {stem}_t* self, uint8_t* payload);")
        out.append(f"void {stem}_unpack({stem}_t* self, const uint8_t* payload);")
        if has_range(message):
            out.append("// Index of the first field outside its range, or RANGE_OK.")
            out.append(f"uint8_t {stem}_range(const {stem}_t* self);")
    out += ["", "#define RANGE_OK 0xFFU", "", "typedef struct {"]
    out += [
        "    uint8_t id;",
        "    uint8_t length;  // of the payload, bytes",
        "    uint8_t schema;  // taken into the CRC",
    ]
    out += ["    uint8_t query;   // 1: a repeat is carried out anew", "} layout_t;", ""]
    out += [
        "// Layout of a message, or NULL for an id nobody has.",
        "const layout_t* layout_of(uint8_t id);",
        "",
        "#endif",
        "",
    ]
    return "\n".join(out)


def has_range(message: Message) -> bool:
    return message.kind == "command" and any(f.min is not None or f.max is not None or f.enum for f in message.fields)


def c_source(protocol: Protocol) -> str:
    out = [
        f"// {GENERATED}",
        "// clang-format off",
        '#include "messages.h"',
        "",
        "#include <stddef.h>",
        "#include <string.h>",
        "",
    ]
    out += C_PRIMITIVES.strip("\n").splitlines()
    for message in protocol.messages:
        if not message.fields:
            continue
        stem = f"{message.kind}_{message.name}"
        for verb in ("pack", "unpack"):
            out.append("")
            if verb == "pack":
                out.append(f"void {stem}_pack(const {stem}_t* const self, uint8_t* const payload)")
            else:
                out.append(f"void {stem}_unpack({stem}_t* const self, const uint8_t* const payload)")
            out.append("{")
            at = 0
            for field in message.fields:
                if field.type.startswith("bytes"):
                    pair = [f"payload + {at}", f"self->{field.name}"]
                    to, source = pair if verb == "pack" else reversed(pair)
                    out.append(f"    memcpy({to}, {source}, {field.size});")
                elif verb == "pack":
                    value = f"(uint32_t)self->{field.name}" if field.type == "i32" else f"self->{field.name}"
                    out.append(f"    put{8 * field.size}(payload + {at}, {value});")
                else:
                    cast = "(int32_t)" if field.type == "i32" else ""
                    out.append(f"    self->{field.name} = {cast}get{8 * field.size}(payload + {at});")
                at += field.size
            out.append("}")
        if has_range(message):
            out += ["", f"uint8_t {stem}_range(const {stem}_t* const self)", "{"]
            for index, field in enumerate(message.fields):
                low, high = field.min, field.max
                if field.enum:
                    low, high = None, max(protocol.enums[field.enum].values())
                tests = [f"self->{field.name} < {low}U"] if low else []
                tests += [f"self->{field.name} > {high}U"] if high is not None else []
                for test in tests:
                    out += [f"    if ({test}) {{", f"        return {index}U;", "    }"]
            out += ["    return RANGE_OK;", "}"]
    out += ["", "static const layout_t layouts[] = {"]
    out += [
        f"    {{0x{m.id:02X}, {m.length}, 0x{m.schema:02X}, {int(m.query)}}},  // {m.kind} {m.name}"
        for m in protocol.messages
    ]
    out += ["};", ""]
    out += [*C_LAYOUT_OF.strip("\n").splitlines(), ""]
    return "\n".join(out)


C_PRIMITIVES = """
static inline void put8(uint8_t* const to, const uint8_t value)
{
    to[0] = value;
}

static inline void put16(uint8_t* const to, const uint16_t value)
{
    to[0] = (uint8_t)value;
    to[1] = (uint8_t)(value >> 8);
}

static inline void put32(uint8_t* const to, const uint32_t value)
{
    put16(to, (uint16_t)value);
    put16(to + 2, (uint16_t)(value >> 16));
}

static inline uint8_t get8(const uint8_t* const from)
{
    return from[0];
}

static inline uint16_t get16(const uint8_t* const from)
{
    return (uint16_t)(from[0] | (from[1] << 8));
}

static inline uint32_t get32(const uint8_t* const from)
{
    return get16(from) | ((uint32_t)get16(from + 2) << 16);
}
"""

C_LAYOUT_OF = """
const layout_t* layout_of(const uint8_t id)
{
    for (size_t i = 0; i < sizeof(layouts) / sizeof(layouts[0]); i++) {
        if (layouts[i].id == id) {
            return &layouts[i];
        }
    }
    return NULL;
}
"""


def c_vectors(protocol: Protocol, golden: dict[str, Any]) -> str:
    """A C test table: each vector as a function that packs the fields it was made from and unpacks them again."""
    out = [
        f"// {GENERATED}",
        "// clang-format off",
        '#include "vectors.h"',
        "",
        "#include <string.h>",
        "",
        '#include "messages.h"',
        "",
    ]
    rows = []
    by_key = {(message.kind, message.name): message for message in protocol.messages}
    for number, vector in enumerate(golden["messages"]):
        message = by_key[vector["kind"], vector["name"]]
        body, wire = bytes.fromhex(vector["body"]), bytes.fromhex(vector["wire"])
        routine = "NULL"
        if message.fields:
            stem, routine = f"{message.kind}_{message.name}", f"vector_{number}"
            out += [f"static int {routine}(uint8_t* const payload)", "{", f"    {stem}_t made, back;"]
            out += ["    memset(&made, 0, sizeof made);", "    memset(&back, 0, sizeof back);"]
            for field in message.fields:
                value = vector["fields"][field.name]
                if field.type.startswith("bytes"):
                    chunk = ", ".join(f"0x{byte:02x}" for byte in bytes.fromhex(value))
                    out.append(f"    memcpy(made.{field.name}, (const uint8_t[]){{{chunk}}}, {field.size});")
                else:
                    literal = f"(int32_t){value}LL" if field.type == "i32" else f"{value}U"
                    out.append(f"    made.{field.name} = {literal};")
            out += [f"    {stem}_pack(&made, payload);", f"    {stem}_unpack(&back, payload);"]
            out += ["    return memcmp(&made, &back, sizeof made) == 0;", "}", ""]
        rows.append(
            f'    {{"{message.kind} {message.name}", 0x{message.id:02X}, {vector["sequence"]}, {vector["boot"]}, '
            f"{len(body)}, {len(wire)}, {c_string(body)}, {c_string(wire)}, {routine}}},"
        )
    out += [
        "const vector_t vectors[] = {",
        *rows,
        "};",
        "const size_t vector_count = sizeof vectors / sizeof vectors[0];",
        "",
    ]
    rows = []
    for item in golden["bad"]:
        if item["to"] == "controller":
            wire = bytes.fromhex(item["wire"])
            rows.append(f'    {{"{item["doc"]}", {len(wire)}, {c_string(wire)}}},')
    out += ["const bad_vector_t bad_vectors[] = {", *rows, "};"]
    out += ["const size_t bad_vector_count = sizeof bad_vectors / sizeof bad_vectors[0];", ""]
    return "\n".join(out)


def c_string(data: bytes) -> str:
    return "(const uint8_t[]){" + ", ".join(f"0x{byte:02x}" for byte in data) + "}"


# ---- Python ----------------------------------------------------------------------------------------------------------

PYTHON_HEAD = '''"""Every message of the wire, as it crosses it. {generated}

Payloads only: identity, sequence, CRC and framing are codec.py's. `pack` raises AnnulusError for a value that does not
fit its field; `unpack` raises ValueError for a payload of the wrong length or an enumeration value nobody defined.
Ranges are the controller's to enforce (status OUT_OF_RANGE, `detail` = index into FIELDS).
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import ClassVar, Self

from annulus.vocabulary import AnnulusError, EdgeFlag, Lamp

SCHEMA_HASH = 0x{schema_hash:08X}
REPLY_BIT = 0x{reply_bit:02X}
'''

PYTHON_BASE = '''

@dataclass(frozen=True, slots=True)
class Message:
    """What every message has. ID and SCHEMA_BYTE enter the frame; LENGTH is the payload's, in bytes."""

    ID: ClassVar[int]
    SCHEMA_BYTE: ClassVar[int]
    LAYOUT: ClassVar[struct.Struct]
    LENGTH: ClassVar[int]
    FIELDS: ClassVar[tuple[str, ...]]

    def pack(self) -> bytes:
        """The payload, LENGTH bytes."""
        raise NotImplementedError

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """The message in a payload of exactly LENGTH bytes."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Reply(Message):
    """Answer to a command: the same sequence, the values actually applied."""

    status: StatusCode
    detail: int


@dataclass(frozen=True, slots=True)
class Command(Message):
    """Host to controller. QUERY: changes nothing, so a repeat is carried out anew."""

    REPLY: ClassVar[type[Reply]]
    QUERY: ClassVar[bool]


@dataclass(frozen=True, slots=True)
class Event(Message):
    """Controller to host, unasked, with a sequence of its own."""


@dataclass(frozen=True, slots=True)
class Notice(Message):
    """Controller to host, without sequence; may be lost without harm."""


def _pack(name: str, layout: struct.Struct, *values: int | bytes) -> bytes:
    try:
        return layout.pack(*values)
    except struct.error as error:
        raise AnnulusError(f"{name}: a value does not fit its field on the wire: {error}") from None


def _fits(name: str, value: bytes, size: int) -> bytes:
    if len(value) > size:
        raise AnnulusError(f"{name}: {len(value)} bytes where {size} fit")
    return value


def _values(layout: struct.Struct, payload: bytes) -> tuple[int, ...]:
    if len(payload) != layout.size:
        raise ValueError(f"payload of {len(payload)} bytes where {layout.size} were expected")
    return layout.unpack(payload)
'''


def python_module(protocol: Protocol) -> str:
    out = PYTHON_HEAD.format(generated=GENERATED, schema_hash=protocol.schema_hash, reply_bit=REPLY_BIT).splitlines()
    out += [
        f"{'PROTOCOL_VERSION' if name == 'version' else name.upper()} = {value}"
        for name, value in protocol.constants.items()
    ]
    out += [f"{name.upper()} = {value}" for name, value in protocol.limits.items()]
    for table, names, base in ((protocol.enums, ENUM_NAMES, "IntEnum"), (protocol.flags, FLAG_NAMES, "IntFlag")):
        for name, members in table.items():
            if names[name] not in FROM_VOCABULARY:
                out += ["", "", f"class {names[name]}({base}):"]
                out += [f"    {member.upper()} = {value}" for member, value in members.items()]
    out += PYTHON_BASE.rstrip("\n").splitlines()
    order = {"reply": 0, "command": 1, "event": 2, "notice": 3}
    for message in sorted(protocol.messages, key=lambda m: (order[m.kind], m.id)):
        out += python_class(message)
    for kind, table in (("command", "COMMANDS"), ("reply", "REPLIES"), ("event", "EVENTS"), ("notice", "NOTICES")):
        base = kind.capitalize()
        out += (
            ["", f"{table}: dict[int, type[{base}]] = {{"]
            if table != "COMMANDS"
            else ["", "", f"{table}: dict[int, type[{base}]] = {{"]
        )
        out += [f"    0x{message.id:02X}: {message.camel}," for message in protocol.of(kind)] + ["}"]
    out += ["MESSAGES: dict[int, type[Message]] = {**COMMANDS, **REPLIES, **EVENTS, **NOTICES}", ""]
    return "\n".join(out)


def python_class(message: Message) -> list[str]:
    out = ["", "", "@dataclass(frozen=True, slots=True)", f"class {message.camel}({message.kind.capitalize()}):"]
    code = "<" + "".join(field.code for field in message.fields)
    doc_lines = wrap(message.doc, 116)
    if len(doc_lines) == 1 and len(doc_lines[0]) <= 110:
        out.append(f'    """{doc_lines[0]}"""')
    else:
        out += [f'    """{doc_lines[0]}', *(f"    {line}" for line in doc_lines[1:]), '    """']
    names = ", ".join(f'"{field.name}"' for field in message.fields) + ("," if len(message.fields) == 1 else "")
    out += [
        "",
        f"    ID: ClassVar[int] = 0x{message.id:02X}",
        f"    SCHEMA_BYTE: ClassVar[int] = 0x{message.schema:02X}",
    ]
    out += [
        f'    LAYOUT: ClassVar[struct.Struct] = struct.Struct("{code}")',
        f"    LENGTH: ClassVar[int] = {message.length}",
    ]
    if len(names) > 60:
        out.append("    FIELDS: ClassVar[tuple[str, ...]] = (")
        out += [f'        "{field.name}",' for field in message.fields] + ["    )"]
    else:
        out.append(f"    FIELDS: ClassVar[tuple[str, ...]] = ({names})")
    if message.kind == "command":
        out.append(f"    REPLY: ClassVar[type[Reply]] = {message.camel}Reply")
        out.append(f"    QUERY: ClassVar[bool] = {message.query}")
    own = message.fields[2:] if message.kind == "reply" else message.fields
    out += [""] if own else []
    for field in own:
        note = "; ".join(text for text in (field.unit, field.doc) if text)
        out.append(f"    {field.name}: {field.python}" + (f"  # {note}" if note else ""))
    packed = []
    for field in message.fields:
        if field.type.startswith("bytes"):
            packed.append(f'_fits("{message.name}.{field.name}", self.{field.name}, {field.size})')
        else:
            packed.append(f"self.{field.name}")
    out += ["", "    def pack(self) -> bytes:"]
    one_line = f"        return _pack({', '.join([f'{chr(34)}{message.name}{chr(34)}', 'self.LAYOUT', *packed])})"
    if len(one_line) <= 120:
        out.append(one_line)
    else:
        out += ["        return _pack(", f'            "{message.name}",', "            self.LAYOUT,"]
        out += [f"            {item}," for item in packed] + ["        )"]
    out += ["", "    @classmethod", "    def unpack(cls, payload: bytes) -> Self:"]
    if not message.fields:
        return [*out, "        _values(cls.LAYOUT, payload)", "        return cls()"]
    out.append("        v = _values(cls.LAYOUT, payload)")
    made = [
        f"{f.python}(v[{i}])" if f.enum or f.flags or f.type.startswith("bytes") else f"v[{i}]"
        for i, f in enumerate(message.fields)
    ]
    one_line = f"        return cls({', '.join(made)})"
    if len(one_line) <= 120:
        return [*out, one_line]
    return [*out, "        return cls(", *(f"            {item}," for item in made), "        )"]


def wrap(text: str, width: int) -> list[str]:
    lines, line = [], ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}" if line else word
    return [*lines, line]


# ---- reference -------------------------------------------------------------------------------------------------------


def reference(protocol: Protocol) -> str:
    out = ["# Reference of the wire", "", f"<!-- {GENERATED} -->", ""]
    out += ["The rules are in [README.md](README.md); this page lists what the rules apply to.", ""]
    out += [f"Protocol version {protocol.constants['version']}, schema hash `0x{protocol.schema_hash:08X}`.", ""]
    out += ["| constant | value |", "|---|---|"]
    out += [f"| {name} | {value} |" for name, value in {**protocol.constants, **protocol.limits}.items()]
    out += ["", "## Enumerations", ""]
    for name, members in protocol.enums.items():
        out.append(f"- **{name}**: " + ", ".join(f"{value} {member}" for member, value in members.items()))
    out += ["", "## Flags", ""]
    for name, members in protocol.flags.items():
        out.append(f"- **{name}**: " + ", ".join(f"{value} {member}" for member, value in members.items()))
    titles = {"command": "Commands and their replies", "event": "Events", "notice": "Notices"}
    replies = {message.name: message for message in protocol.of("reply")}
    for kind, title in titles.items():
        out += ["", f"## {title}"]
        for message in protocol.of(kind):
            marks = [mark for mark, on in (("frozen", message.frozen), ("query", message.query)) if on]
            out += ["", f"### {message.name} 0x{message.id:02X}" + (f" ({', '.join(marks)})" if marks else "")]
            out += ["", message.doc, ""]
            out += reference_table(message)
            if kind == "command":
                reply = replies[message.name]
                out += ["", f"Reply 0x{reply.id:02X}:", "", *reference_table(reply)]
    return "\n".join([*out, ""])


def reference_table(message: Message) -> list[str]:
    wire = HEADER_SIZE[message.kind] + message.length + 4
    out = [f"Payload {message.length} bytes, {wire} on the wire, schema byte 0x{message.schema:02X}."]
    if not message.fields:
        return out
    out += ["", "| at | field | type | unit | range | what |", "|---|---|---|---|---|---|"]
    at = 0
    for field in message.fields:
        kind = field.enum or field.flags
        low, high = field.min, field.max
        span = "" if low is None and high is None else f"{'' if low is None else low}..{'' if high is None else high}"
        out.append(
            f"| {at} | {field.name} | {field.type}{f' ({kind})' if kind else ''} | {field.unit} | {span} "
            f"| {field.doc} |"
        )
        at += field.size
    return out


def main(arguments: list[str]) -> int:
    if arguments not in ([], ["--check"]):
        print("usage: generate.py [--check]", file=sys.stderr)
        return 2
    protocol = load(HERE / "messages.toml")
    golden = vectors(protocol)
    files = {
        ROOT / "firmware/core/messages.h": c_header(protocol),
        ROOT / "firmware/core/messages.c": c_source(protocol),
        ROOT / "firmware/tests/vectors.c": c_vectors(protocol, golden),
        ROOT / "host/annulus/link/messages.py": python_module(protocol),
        HERE / "REFERENCE.md": reference(protocol),
        HERE / "vectors.json": json.dumps(golden, indent=1) + "\n",
    }
    stale = [path for path, text in files.items() if not path.is_file() or path.read_text() != text]
    for path in stale:
        if arguments:
            print(f"stale: {path.relative_to(ROOT)}; run protocol/generate.py", file=sys.stderr)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(files[path])
            print(f"written: {path.relative_to(ROOT)}")
    return 1 if arguments and stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
