"""The source, section by section: what of it this project has (docs/manual/source.toml), as a table of the manual.

A row's numbers are not typed where a benchmark measures them: `bench` names rows of a RESULTS.md, and `{1}` in `ours`
is what the first of them measured. What a command prints and no benchmark measures stands in `prints`, and the deep
test holds the command's answer to it. tests/unit/test_source_table.py says what a row must keep.
"""

import importlib
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from tools.bench.table import ROOT, Truth

ROWS = ROOT / "docs/manual/source.toml"
PAGE = ROOT / "docs/manual/source.md"
BEGIN, END = "<!-- of source.toml, by python -m tools.source: begin -->", "<!-- end -->"
TABLES = ("metrology", "thermoacoustic", "joints", "crossbore")
STATES = ("works", "partly", "not")
THEORY, PRINTED, PHOTOGRAPHS = "theory", "source's printed data", "others' photographs"
TRUTHS = {str(one) for one in Truth} | {THEORY, PRINTED, PHOTOGRAPHS}
MISSED = "**missed**"
QUOTED = re.compile(r"\{(\d)(?:\.(source))?\}")
PACKAGE = "host/annulus_pipe"


@dataclass(frozen=True, slots=True)
class Measured:
    """One row of a RESULTS.md."""

    topic: str
    what: str
    source: str
    number: str
    verdict: str
    truth: str


@dataclass(frozen=True, slots=True)
class Entry:
    """One row of source.toml. where : paths below the package, or from the root of the checkout. command : lines joined
    by `&&`, to be typed there; "" where there is nothing to type."""

    chapter: str
    section: str
    what: str
    where: tuple[str, ...]
    command: str
    source: str
    ours: str
    bench: tuple[str, ...]
    prints: tuple[str, ...]
    truth: str
    state: str
    why: str

    @property
    def measured(self) -> list[Measured]:
        return [benched(name) for name in self.bench]

    @property
    def numbers(self) -> str:
        """`ours` with what was measured in place of {1}, {2} ..; {1.source} is what that row has of the source, printed
        or its method run there."""
        found = self.measured
        return QUOTED.sub(lambda m: getattr(found[int(m[1]) - 1], m[2] or "number"), self.ours)

    @property
    def whose(self) -> str:
        """Whose truth the numbers have."""
        of = dict.fromkeys(one.truth for one in self.measured)
        return ", ".join(of) if of else self.truth

    @property
    def missed(self) -> list[str]:
        return [one.what for one in self.measured if one.verdict == MISSED]


def parts(line: str) -> list[str]:
    """What of a line is one command each."""
    return [part.strip() for part in line.split("&&") if part.strip()]


@cache
def entries() -> tuple[Entry, ...]:
    """All rows, as they stand."""
    data: Mapping[str, Any] = tomllib.loads(ROWS.read_text(encoding="utf-8"))
    return tuple(
        Entry(
            chapter["name"],
            row["section"],
            row["what"],
            tuple(row.get("where", ())),
            row.get("command", ""),
            row.get("source", "-"),
            row.get("ours", "-"),
            tuple(row.get("bench", ())),
            tuple(row.get("prints", ())),
            row.get("truth", "-"),
            row["state"],
            row.get("why", ""),
        )
        for chapter in data["chapter"]
        for row in chapter["row"]
    )


@cache
def results() -> Mapping[str, Sequence[Measured]]:
    """The written rows of each table."""
    return {name: _results(name) for name in TABLES}


def _results(name: str) -> list[Measured]:
    titles = {title: topic for topic, title in importlib.import_module(f"tools.bench.{name}").TABLE.topics.items()}
    out, topic, head = [], "", [""]
    for line in (ROOT / f"tools/bench/{name}/RESULTS.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]] if line.startswith("| ") else []
        if line.startswith("## "):
            topic = titles[line[3:]]
        elif cells and cells[0] == "what":
            head = [cell or "verdict" for cell in cells]
        elif cells:
            row = dict(zip(head, cells, strict=True))
            out.append(Measured(topic, row["what"], row["source"], row["this project"], row["verdict"], row["truth"]))
    return out


def benched(name: str) -> Measured:
    """The row that "TABLE/TOPIC: how its title begins" names. ValueError if there is none, or more than one."""
    place, _, begins = name.partition(": ")
    table, _, topic = place.partition("/")
    found = [one for one in results()[table] if one.topic == topic and one.what.startswith(begins)]
    exact = [one for one in found if one.what == begins] or found
    if len(exact) != 1:
        raise ValueError(f"{name!r} begins {len(exact)} rows of tools/bench/{table}/RESULTS.md, expected one")
    return exact[0]


def table() -> str:
    """The page's table: chapter by chapter, and how many rows are in which state."""
    rows = entries()
    count = ", ".join(f"{sum(row.state == state for row in rows)} {state}" for state in STATES)
    out = [f"{len(rows)} rows: {count}.", ""]
    for chapter in dict.fromkeys(row.chapter for row in rows):
        out += [f"## {chapter}", "", _line(HEAD), "|---" * len(HEAD) + "|"]
        out += [_line(_cells(row)) for row in rows if row.chapter == chapter]
        out.append("")
    return "\n".join(out)


HEAD = ("section", "what", "the source", "ours", "whose truth", "state", "where", "command")


def _cells(row: Entry) -> list[str]:
    state = f"**{row.state}**" if row.state != "works" else row.state
    return [
        row.section,
        row.what,
        row.source,
        row.numbers,
        row.whose,
        f"{state}: {row.why}" if row.why else state,
        ", ".join(f"`{place}`" for place in row.where) or "-",
        f"`{row.command}`" if row.command else "-",
    ]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def written() -> str:
    """What stands between the marks on the page."""
    text = PAGE.read_text(encoding="utf-8")
    return text.partition(f"{BEGIN}\n")[2].partition(f"\n{END}")[0]


def write() -> None:
    """The table anew, between the marks."""
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(f"{BEGIN}\n")
    PAGE.write_text(f"{before}{BEGIN}\n{table()}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
