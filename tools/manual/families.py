"""Every AnnulusError of the source, and the family it belongs to (docs/manual/families.toml): the page of all messages.

A message is what is handed to AnnulusError, as the source has it, what is filled in in braces. A family claims messages
by module, or by module and a regular expression; the first that matches has it.
"""

import ast
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "host/annulus_pipe"
FAMILIES = ROOT / "docs/manual/families.toml"
WORDS_MIN = 2  # of a message that is worth showing


@dataclass(frozen=True, slots=True)
class Message:
    """module : below host/annulus_pipe, as a family names it."""

    module: str
    line: int
    template: str  # `{path}: cannot be read`

    @property
    def shown(self) -> str:
        """For people: what is filled in is a dot or three, ends of sentences stay."""
        text = re.sub(r"\{[^{}]*(?:\{[^{}]*\}[^{}]*)*\}", "…", self.template)
        return " ".join(re.sub(r"…(?:[ ,]+…)+", "…", text).split())


@dataclass(frozen=True, slots=True)
class Family:
    area: str
    title: str
    means: str
    do: str
    claims: tuple[str, ...]

    def claim_on(self, message: Message) -> str | None:
        for claim in self.claims:
            module, _, pattern = claim.partition(": ")
            mine = message.module.startswith(module) if module.endswith("/") else message.module == module
            if mine and (not pattern or re.search(pattern, message.template)):
                return claim
        return None


@cache
def messages() -> tuple[Message, ...]:
    """All of them, by module and line."""
    found = [
        Message(path.relative_to(SOURCE).as_posix(), node.lineno, _template(node.args[0]))
        for path in SOURCE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and _name(node.func) == "AnnulusError" and node.args
    ]
    return tuple(sorted(found, key=lambda one: (one.module, one.line)))


def _name(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _template(node: ast.expr) -> str:
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(_template(part) for part in parts)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _template(left) + _template(right)
        case ast.FormattedValue(value=value):
            return "{" + ast.unparse(value) + "}"
        case ast.IfExp(body=body, orelse=orelse):
            return _template(body) + " | " + _template(orelse)
    return "{" + ast.unparse(node) + "}"


@cache
def families() -> tuple[Family, ...]:
    """The core's, then those that lie in the wings' own folders."""
    files = (FAMILIES, *sorted((ROOT / "host/annulus_pipe/wings").glob("*/families.toml")))
    parts: list[Mapping[str, Any]] = [tomllib.loads(file.read_text(encoding="utf-8")) for file in files]
    return tuple(
        Family(area["name"], one["title"], one["means"], one["do"], tuple(one["messages"]))
        for data in parts
        for area in data["area"]
        for one in area["family"]
    )


def sorted_out(all_of_them: Sequence[Message]) -> tuple[dict[Family, list[Message]], list[Message], list[str]]:
    """Messages by family; those of none; claims on words that no message of their module has."""
    by: dict[Family, list[Message]] = {family: [] for family in families()}
    claims = {claim for family in families() for claim in family.claims}
    orphans, unused = [], {claim for claim in claims if ": " in claim}
    for message in all_of_them:
        for family in families():
            claim = family.claim_on(message)
            if claim is not None:
                by[family].append(message)
                unused.discard(claim)
                break
        else:
            orphans.append(message)
    return by, orphans, sorted(unused)


def page() -> str:
    by, orphans, unused = sorted_out(messages())
    if orphans or unused:
        told = [f"{one.module}:{one.line}: {one.template}" for one in orphans]
        raise ValueError(f"{FAMILIES}: no family for {told}; no message for {unused}")
    out, area = [], ""
    for family, mine in by.items():
        if family.area != area:
            area = family.area
            out.append(f"\n## {area}\n")
        out.append(f"### {family.title}\n\n{family.means}\n\n**Do:** {family.do}\n")
        out += [f"- `{text.replace('`', chr(39))}`" for text in _told(mine)]
        out.append("")
    return "\n".join(out)


def _told(mine: Sequence[Message]) -> Iterator[str]:
    """Each once, those without words of their own left out."""
    seen = set()
    for message in mine:
        text = message.shown
        if text not in seen and len(re.findall(r"[a-zA-Z]{3,}", text)) >= WORDS_MIN:
            seen.add(text)
            yield text
