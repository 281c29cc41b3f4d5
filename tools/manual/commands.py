"""The command line, from the command line: every command, argument, option, default and example."""

import re
import shlex
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any, get_args

import typer

from annulus_pipe.cli.app import app

PROGRAM = "annulus"


def tree() -> Iterator[tuple[str, Any]]:
    """Every command and group as it is typed, a group before its commands: ("annulus record verify", the command)."""
    return _below(PROGRAM, typer.main.get_command(app))


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    yield name, command
    if is_group(command):
        context = typer.Context(command)
        for verb in command.list_commands(context):
            yield from _below(f"{name} {verb}", command.get_command(context, verb))


def is_group(command: Any) -> bool:
    return hasattr(command, "list_commands")


def examples() -> Iterator[tuple[str, str]]:
    """(command, a line to type) of every example."""
    for name, command in tree():
        for line in example(command)[0]:
            yield name, line


def example(command: Any) -> tuple[list[str], str]:
    """A command's example as lines to type, and the words behind them."""
    lines, words = [], ""
    text = (command.epilog or "").removeprefix("Example: ")
    for part in re.split(r"\. (?=[A-Z][a-z]+ )| && |, then ", text):
        line = part.removeprefix("Without hardware: ")
        if line.startswith(f"{PROGRAM} "):
            lines.append(line)
        else:
            words += part
    return lines, words


def parse(line: str) -> None:
    """Reads a line as the program would, up to the moment at which it would do something. `..` stands for more words.
    Raises what the program would: click's UsageError, or ValueError for what is no line of ours."""
    program, *words = shlex.split(line)
    if program != PROGRAM:
        raise ValueError(f"{line!r}: expected {PROGRAM} first")
    command, context, more = typer.main.get_command(app), None, ".." in words
    words = [word for word in words if word != ".."]
    while True:
        context = command.make_context(command.name or PROGRAM, words, parent=context, resilient_parsing=more)
        if not is_group(command):
            return
        left = [*getattr(context, "_protected_args", []), *context.args]
        _, below, words = command.resolve_command(context, left)
        if below is None:
            raise ValueError(f"{line!r}: no such command")
        command = below


def page() -> str:
    out = []
    for name, command in tree():
        if command.hidden:
            continue
        depth = max(len(name.split()) - 1, 1)
        if depth == 1 and name != PROGRAM:
            out.append(f"\n## {name}\n")
        elif name != PROGRAM:
            out.append(f"\n### {name}\n")
        out.append(f"{_text(command.help)}\n")
        if is_group(command):
            rows = [
                f"| [`{name} {verb}`](#{_anchor(f'{name} {verb}')}) | {_cell(_first(below.help))} |"
                for verb, below in command.commands.items()
                if not below.hidden
            ]
            out.append("\n".join(["| command | |", "|---|---|", *rows]) + "\n")
            continue
        lines, words = example(command)
        if lines:
            out.append("```sh\n" + "\n".join(lines) + f"\n```\n\n{_plain(words)}\n")
        rows = [row for parameter in command.params if (row := _row(parameter))]
        if rows:
            out.append("\n".join(["| | takes | default | |", "|---|---|---|---|", *rows]) + "\n")
    return "\n".join(out)


def _row(parameter: Any) -> str | None:
    if parameter.name == "help" or parameter.hidden:
        return None
    if isinstance(parameter, typer.core.TyperArgument):
        name = f"`{parameter.metavar or parameter.name.upper()}`"
        default = "" if parameter.required else "may be left out"
    else:
        name = ", ".join(f"`{one}`" for one in [*parameter.opts, *parameter.secondary_opts])
        default = "**needed**" if parameter.required else _default(parameter)
    return f"| {name} | {_cell(_takes(parameter))} | {default} | {_cell(parameter.help or '')} |"


def _takes(parameter: Any) -> str:
    kind = parameter.type_descriptor.annotation
    kind = (get_args(kind) or (kind,))[0]
    if getattr(parameter, "is_flag", False):
        return ""
    several = "; may be repeated" if parameter.multiple or parameter.nargs == -1 else ""
    if parameter.metavar and not isinstance(parameter, typer.core.TyperArgument):
        return parameter.metavar + several
    if isinstance(kind, type) and issubclass(kind, Enum):
        return ", ".join(str(one.value) for one in kind) + several
    name = {str: "text", Path: "path", float: "number", int: "whole number"}.get(kind, getattr(kind, "__name__", ""))
    low, high = parameter.min, parameter.max
    if low is not None and high is not None:
        name += f", {_number(low)} to {_number(high)}"
    elif low is not None or high is not None:
        name += f", {_number(low)} or more" if high is None else f", {_number(high)} or less"
    return name + several


def _number(value: float) -> str:
    return f"{value:g}" if abs(value) < 1e5 else f"{value:.0f}"


def _default(parameter: Any) -> str:
    value = parameter.default
    if value is None or callable(value) or value in ((), []):
        return ""
    if parameter.is_flag:
        return f"`{(parameter.opts if value else parameter.secondary_opts)[0]}`" if parameter.secondary_opts else ""
    value = getattr(value, "value", value)
    return f"`{_number(value)}`" if isinstance(value, float) else f"`{value}`"


def _anchor(name: str) -> str:
    return name.replace(" ", "-")


def _first(text: str | None) -> str:
    return re.split(r"(?<=[.?!])\s", " ".join((text or "").split()), maxsplit=1)[0]


def _text(text: str | None) -> str:
    """Help as Markdown: paragraphs kept, nothing of it markup but code."""
    paragraphs = re.split(r"\n\s*\n", (text or "").strip())
    return "\n\n".join(_plain(" ".join(one.split())) for one in paragraphs)


def _cell(text: str) -> str:
    return _plain(" ".join(text.split())).replace("|", "\\|")


def _plain(text: str) -> str:
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if i % 2 else re.sub(r"([*_<\[\]])", r"\\\1", part) for i, part in enumerate(parts))
