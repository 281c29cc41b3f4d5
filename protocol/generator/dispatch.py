"""C: from a command's payload to its reply's. Unpack, range, whom it is allowed to, status, pack: all that the schema
says of a command. What it then does is written by hand (core/commands.c, core/queries.c)."""

from collections.abc import Callable

from generator.c import has_range
from generator.schema import GENERATED, NEEDS, Message, Protocol


def dispatch_header(protocol: Protocol) -> str:
    out = [f"// {GENERATED}", "// clang-format off", "#ifndef ANNULUS_DISPATCH_H", "#define ANNULUS_DISPATCH_H", ""]
    out += ['#include "controller.h"', "", "// What a command needs beside fields in range; messages.toml."]
    out += ["enum { " + ", ".join(f"NEEDS_{need.upper() or 'NOTHING'}" for need in NEEDS) + " };", ""]
    out += [
        "// Carry out a command that came over this line; its reply's payload.",
        "void dispatch(controller_t* self, uint8_t line, const command_t* command, uint8_t reply[PAYLOAD_MAX]);",
        "",
        "// By hand: what each command does. It is asked only when its fields are in range and its needs there, and it",
        "// returns the status; the reply's other fields are 0 before. `holds_` fills in what holds, refused or not.",
    ]
    for command in protocol.of("command"):
        out.append(f"uint8_t {execute(command)};")
        if command.holds:
            out.append(f"void holds_{command.name}(const controller_t* self, reply_{command.name}_t* reply);")
    return "\n".join([*out, "", "#endif", ""])


def execute(command: Message) -> str:
    payload = f"const command_{command.name}_t* command, " if command.fields else ""
    return f"execute_{command.name}(controller_t* self, {payload}reply_{command.name}_t* reply)"


def dispatch_source(protocol: Protocol) -> str:
    commands = protocol.of("command")
    out = [f"// {GENERATED}", "// clang-format off", '#include "dispatch.h"', "", "#include <string.h>", ""]
    out += ['#include "commands.h"', "", "typedef union {"]
    out += [f"    command_{c.name}_t {c.name};" for c in commands if c.fields]
    out += ["} any_command_t;", "", "// Every reply begins with status and detail.", "typedef union {"]
    out += ["    struct {", "        uint8_t status;", "        uint8_t detail;", "    } head;"]
    out += [f"    reply_{c.name}_t {c.name};" for c in commands]
    out += ["} any_reply_t;", ""]
    out += ["// Index of the first field outside its range, or RANGE_OK."]
    out += ["static uint8_t unpack(any_command_t* const command, const uint8_t id, const uint8_t* const payload)"]
    out += ["{", *switch(commands, unpacked), "    return RANGE_OK;", "}", ""]
    out += ["static uint8_t execute(controller_t* const self, const uint8_t id, const any_command_t* const command,"]
    out += ["                       any_reply_t* const reply)"]
    out += ["{", *switch(commands, executed), "    return STATUS_OK;", "}", ""]
    out += ["static void pack(const controller_t* const self, const uint8_t id, any_reply_t* const reply,"]
    out += ["                 uint8_t* const answer)"]
    out += ["{", *switch(commands, packed), "}", ""]
    out += ["void dispatch(controller_t* const self, const uint8_t line, const command_t* const command,"]
    out += ["              uint8_t answer[const PAYLOAD_MAX])"]
    out += ["{", "    static const uint8_t needs[] = {"]
    out += [f"        [COMMAND_{c.name.upper()}] = NEEDS_{c.needs.upper() or 'NOTHING'}," for c in commands]
    out += [*DISPATCH.strip("\n").splitlines(), ""]
    return "\n".join(out)


DISPATCH = """
    };
    const uint8_t id = command->layout->id;
    any_command_t fields;
    any_reply_t reply;
    memset(&fields, 0, sizeof fields);
    memset(&reply, 0, sizeof reply);
    self->asking = line;
    const uint8_t range = unpack(&fields, id, command->payload);
    uint8_t status = commands_refusal(self, needs[id], range, &reply.head.detail);
    if (status == STATUS_OK) {
        status = execute(self, id, &fields, &reply);
    }
    reply.head.status = status;
    pack(self, id, &reply, answer);
}
"""


def switch(commands: list[Message], lines: Callable[[Message], list[str]]) -> list[str]:
    out = ["    switch (id) {"]
    for command in commands:
        out += [f"    case COMMAND_{command.name.upper()}:", *(f"        {line}" for line in lines(command))]
    return [*out, "    default:", "        break;", "    }"]


def unpacked(command: Message) -> list[str]:
    if not command.fields:
        return ["break;"]
    stem = f"command_{command.name}"
    checked = f"return {stem}_range(&command->{command.name});" if has_range(command) else "break;"
    return [f"{stem}_unpack(&command->{command.name}, payload);", checked]


def executed(command: Message) -> list[str]:
    argument = f"&command->{command.name}, " if command.fields else ""
    return [f"return execute_{command.name}(self, {argument}&reply->{command.name});"]


def packed(command: Message) -> list[str]:
    holds = [f"holds_{command.name}(self, &reply->{command.name});"] if command.holds else []
    return [*holds, f"reply_{command.name}_pack(&reply->{command.name}, answer);", "break;"]
