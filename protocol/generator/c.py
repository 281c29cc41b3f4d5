"""C: the messages, the pins, and the golden vectors as a table for the unit tests."""

from typing import Any

from generator.schema import GENERATED, REPLY_BIT, SCALARS, Field, Message, Protocol


def c_field(field: Field) -> str:
    if field.type.startswith("bytes"):
        return f"uint8_t {field.name}[{field.size}]"
    return f"{SCALARS[field.type][1]} {field.name}"


def c_header(protocol: Protocol) -> str:
    out = [f"// {GENERATED}", "// clang-format off", "#ifndef ANNULUS_MESSAGES_H", "#define ANNULUS_MESSAGES_H", ""]
    out += ["#include <stdint.h>", "", f"#define SCHEMA_HASH 0x{protocol.schema_hash:08X}U"]
    for name, number in {**protocol.wire, **protocol.controller, **protocol.limits}.items():
        out.append(f"#define {name.upper()} {number.value}U  // {number.what}")
    out += [f"#define TICKS_PER_{unit} {protocol.tick_hz // per}U" for unit, per in (("US", 10**6), ("MS", 10**3))]
    out.append(f"#define REPLY_BIT 0x{REPLY_BIT:02X}U")
    out.append(f"#define PAYLOAD_MAX {max(message.length for message in protocol.messages)}U")
    out.append(f"#define EVENT_PAYLOAD_MAX {max(message.length for message in protocol.of('event'))}U")
    for name, members in protocol.enums.items():
        out += ["", "enum {"]
        out += [f"    {name.upper()}_{member.upper()} = {value}," for member, value in members.items()] + ["};"]
    for name, members in protocol.flags.items():
        out.append("")
        out += [f"#define {name.upper()}_{member.upper()} {value}U" for member, value in members.items()]
        out += flags_at_level(protocol, name)
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
    out += ["    uint8_t query;   // 1: a repeat is carried out anew"]
    out += ["    uint8_t since;   // level from which on it is known", "} layout_t;", ""]
    out += [
        "// Chips of every burst code, chip 0 first, as 0 and 1; none of the uploaded one.",
        f"extern const char* const burst_codes[{len(protocol.enums['burst_code'])}];",
        "",
        "// Layout of a message, or NULL for an id nobody has.",
        "const layout_t* layout_of(uint8_t id);",
        "",
        "// Level from which on a fault's code is known.",
        "uint8_t fault_since(uint8_t fault);",
        "",
        "// Ids of commands, id 0 in bit 0 of byte 0; and of events, id 0x80 in bit 0.",
        "extern const uint8_t known_commands[8];",
        f"#define KNOWN_EVENTS 0x{sum(1 << (m.id - 0x80) for m in protocol.of('event')):08X}U",
        "",
        "#endif",
        "",
    ]
    return "\n".join(out)


def flags_at_level(protocol: Protocol, name: str) -> list[str]:
    """For a host of a lower level: those of the flags that it knows."""
    since = {member: protocol.added.get((name, member), 1) for member in protocol.flags[name]}
    if set(since.values()) == {1}:
        return []
    out = [f"// Of the flags of `{name}`, those that a host of this level knows."]
    out += [f"static inline uint32_t {name}_flags_at_level(const uint8_t level)", "{"]
    for level in sorted(set(since.values()) - {1}):
        known = sum(value for member, value in protocol.flags[name].items() if since[member] < level)
        out += [f"    if (level < {level}U) {{", f"        return {known}U;", "    }"]
    return [*out, f"    return {sum(protocol.flags[name].values())}U;", "}"]


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
                tests += [f"self->{field.name} > {high}U"] if high is not None and high < field.top else []
                for test in tests:
                    out += [f"    if ({test}) {{", f"        return {index}U;", "    }"]
            out += ["    return RANGE_OK;", "}"]
    out += ["", "static const layout_t layouts[] = {"]
    out += [
        f"    {{0x{m.id:02X}, {m.length}, 0x{m.schema:02X}, {int(m.query)}, {m.since}}},  // {m.kind} {m.name}"
        for m in protocol.messages
    ]
    out += ["};", "", f"const char* const burst_codes[{len(protocol.enums['burst_code'])}] = {{"]
    for name in protocol.enums["burst_code"]:
        out.append(f'    [BURST_CODE_{name.upper()}] = "{protocol.codes.get(name, "")}",')
    out += ["};", ""]
    out += [*C_LAYOUT_OF.strip("\n").splitlines(), ""]
    out += ["uint8_t fault_since(const uint8_t fault)", "{"]
    for name, since in ((name, protocol.added.get(("fault", name), 1)) for name in protocol.enums["fault"]):
        if since > 1:
            out += [f"    if (fault == FAULT_{name.upper()}) {{", f"        return {since}U;", "    }"]
    if not any(table == "fault" for table, _ in protocol.added):
        out.append("    (void)fault;")
    out += ["    return 1U;", "}", ""]
    known = sum(1 << m.id for m in protocol.of("command")).to_bytes(8, "little")
    out += [f"const uint8_t known_commands[8] = {{{', '.join(f'0x{byte:02X}' for byte in known)}}};", ""]
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


def c_pins(protocol: Protocol) -> str:
    out = [f"// {GENERATED}", "// clang-format off", "#ifndef ANNULUS_PINS_H", "#define ANNULUS_PINS_H", "", "enum {"]
    out += [f"    PIN_{name.upper()} = {pin.number},  // {pin.what}" for name, pin in protocol.pins.items()]
    out += [f"    PIN_COUNT = {max(pin.number for pin in protocol.pins.values()) + 1},", "};", "", "// One bit a pin."]
    high = [pin.number for pin in protocol.pins.values() if pin.high_at_reset]
    for name, numbers in (
        ("INPUT_PINS", protocol.pin_numbers("in")),
        ("OUTPUT_PINS", protocol.pin_numbers("out")),
        ("HIGH_AT_RESET_PINS", high),
    ):
        out.append(f"#define {name} 0x{sum(1 << number for number in numbers):08X}U")
    for first, second in (("PROJECTOR", "LED"), ("MICROWAVE", "TRIGGER"), ("ODOMETER_A", "ODOMETER_B")):
        text = f"{second} next to {first}: one state machine has both"
        out.append(f'_Static_assert(PIN_{second} == PIN_{first} + 1, "{text}");')
    return "\n".join([*out, "", "#endif", ""])


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
