"""Our docstrings as numpydoc wants them: ours say `name : text. other : text` in one paragraph."""

import re

_RULE = re.compile(r"-{3,}")
_NAMED = re.compile(r"\w+(?:, \w+)* : ")
_BETWEEN = re.compile(r"(?<=[.;,)]) (?=\w+(?:, \w+)* : )")
_ERROR = re.compile(r"(\w+Error)\b[,:]?\s*(.*)")


def told_apart(lines: list[str]) -> list[str]:
    """A docstring's lines with each name of a section on a line of its own, what it is below it."""
    out: list[str] = []
    section = ""
    for at, line in enumerate(lines):
        if _is_rule(line):
            section = lines[at - 1].strip() if at else ""
        elif at + 1 < len(lines) and _is_rule(lines[at + 1]):
            section = ""
        elif section and line.startswith(">>>"):
            out += ["", "Examples", "--------"]
            section = ""
        elif section == "Raises" and (error := _ERROR.match(line)):
            out += [error[1], f"    {error[2]}"]
            continue
        elif section and _NAMED.match(line):
            out += _told(line)
            continue
        elif section and line.strip() and not line.startswith(" ") and out and out[-1].startswith("    "):
            first, *others = _BETWEEN.split(line)  # goes on with what the line before began
            out += [f"    {first}", *(part for other in others for part in _told(other))]
            continue
        out.append(line)
    return out


def _told(line: str) -> list[str]:
    out = []
    for one in _BETWEEN.split(line):
        name, _, text = one.partition(" : ")
        out += [name, f"    {text}"]
    return out


def _is_rule(line: str) -> bool:
    return bool(_RULE.fullmatch(line.strip()))
