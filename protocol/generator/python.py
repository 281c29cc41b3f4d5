"""Python: the messages for link/, and what every room may know of the controller."""

from generator.schema import GENERATED, REPLY_BIT, Field, Message, Protocol

# Python names of enumerations: the message classes own the short ones, vocabulary.py owns two of these outright.
ENUM_NAMES = {
    "update_refusal": "UpdateRefusal",
    "status": "StatusCode",
    "lamp": "Lamp",
    "fault": "FaultCode",
    "boot_cause": "BootCause",
    "stop_cause": "StopCause",
    "burst_code": "BurstCode",
    "crash": "CrashKind",
    "image_why": "ImageWhy",
    "image_flash": "ImageFlash",
    "part": "RoundPart",
    "board_kind": "BoardKind",
    "presence": "Presence",
}
FLAG_NAMES = {
    "edge": "EdgeFlag",
    "state": "StateFlag",
    "turntable": "TurntableFlag",
    "interlock": "InterlockFlag",
    "polarity": "PolarityFlag",
    "arm": "ArmFlag",
}
FROM_VOCABULARY = ("EdgeFlag", "Lamp")

PYTHON_HEAD = '''"""Every message of the wire, as it crosses it. {generated}

Tables of fields: fields.py makes payloads of them and reads them; identity, sequence, CRC and framing are codec.py's.
Ranges are the controller's to enforce (status OUT_OF_RANGE, `detail` = index into FIELDS).
"""

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import ClassVar

from annulus_pipe.link.fields import Message, wire
from annulus_pipe.vocabulary import EdgeFlag, Lamp

SCHEMA_HASH = 0x{schema_hash:08X}
REPLY_BIT = 0x{reply_bit:02X}
'''

PYTHON_BASE = '''

@dataclass(frozen=True, slots=True)
class Reply(Message):
    """Answer to a command: the same sequence, the values actually applied."""

    status: StatusCode
    detail: int


@dataclass(frozen=True, slots=True)
class Command(Message):
    """Host to controller. QUERY: changes nothing, so a repeat is carried out anew."""

    REPLY: ClassVar[type[Reply]]
    QUERY: ClassVar[bool] = False


@dataclass(frozen=True, slots=True)
class Event(Message):
    """Controller to host, unasked, with a sequence of its own."""


@dataclass(frozen=True, slots=True)
class Notice(Message):
    """Controller to host, without sequence; may be lost without harm."""
'''


def messages_module(protocol: Protocol) -> str:
    out = PYTHON_HEAD.format(generated=GENERATED, schema_hash=protocol.schema_hash, reply_bit=REPLY_BIT).splitlines()
    out += [f"{name.upper()} = {number.value}" for name, number in protocol.wire.items()]
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


def python_type(field: Field) -> str:
    if field.enum:
        return ENUM_NAMES[field.enum]
    if field.flags:
        return FLAG_NAMES[field.flags]
    return "bytes" if field.type.startswith("bytes") else "int"


def python_class(message: Message) -> list[str]:
    codes = " ".join(field.code for field in message.fields)
    since = f", since={message.since}" if message.since > 1 else ""
    out = ["", "", f'@wire("{message.name}", 0x{message.id:02X}, 0x{message.schema:02X}, "{codes}"{since})']
    out.append(f"class {message.camel}({message.kind.capitalize()}):")
    doc_lines = wrap(message.doc, 116)
    if len(doc_lines) == 1 and len(doc_lines[0]) <= 110:
        out.append(f'    """{doc_lines[0]}"""')
    else:
        out += [f'    """{doc_lines[0]}', *(f"    {line}" for line in doc_lines[1:]), '    """']
    if message.kind == "command":
        out += ["", f"    REPLY = {message.camel}Reply"] + (["    QUERY = True"] if message.query else [])
    own = message.fields[2:] if message.kind == "reply" else message.fields
    out += [""] if own else []
    for field in own:
        note = "; ".join(text for text in (field.unit, field.doc) if text)
        out.append(f"    {field.name}: {python_type(field)}" + (f"  # {note}" if note else ""))
    return out


def wrap(text: str, width: int) -> list[str]:
    lines, line = [], ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}" if line else word
    return [*lines, line]


CONTROLLER_HEAD = '''"""What every room may know of the controller: its tick, measures, limits, pins and codes.

{generated}
"""

from collections.abc import Mapping

TICK_S = {tick_s}
TICK_NS = {tick_ns}
TICKS_PER_US = {ticks_per_us}
'''


def controller_module(protocol: Protocol) -> str:
    hz = protocol.tick_hz
    head = CONTROLLER_HEAD.format(
        generated=GENERATED, tick_s=f"{1 / hz:e}".replace(".000000", ""), tick_ns=10**9 // hz, ticks_per_us=hz // 10**6
    )
    out = head.splitlines()
    out += [f"{name.upper()} = {number.value}  # {number.what}" for name, number in protocol.controller.items()]
    out += ["", "# Limits, compiled into the controller and enforced there."]
    out += [f"{name.upper()} = {number.value}  # {number.what}" for name, number in protocol.limits.items()]
    out += ["", "# Pins, by GPIO."]
    out += [f"PIN_{name.upper()} = {pin.number}  # {pin.what}" for name, pin in protocol.pins.items()]
    for use in ("in", "out"):
        names = ", ".join(f"PIN_{name.upper()}" for name, pin in protocol.pins.items() if pin.use == use)
        one_line = f"{use.upper()}PUT_PINS = ({names})"
        lines = [f"{use.upper()}PUT_PINS = (", *(f"    {name}," for name in names.split(", ")), ")"]
        out += [one_line] if len(one_line) <= 120 else lines
    out += ["", "CODES: Mapping[str, str] = {  # burst codes built in; chips, chip 0 first"]
    out += [f'    "{name.replace("_", "-")}": "{chips}",' for name, chips in protocol.codes.items()]
    return "\n".join([*out, "}", ""])
