"""Rows of a benchmark, the table they make, and the run that makes it."""

import importlib
import os
import platform
import subprocess
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field
from enum import StrEnum
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT.parent / "shared" / "scenes"  # not on a user's machine: such rows are left out there
MARKS = {True: "met", False: "**missed**", None: ""}
RESTS_ON = ("truth", "calibration", "seeds", "draws", "left out")
HEADLINE_DRAWS = 10  # a number beside the source's that fewer draws made says how many, for one may be a lucky one


class Truth(StrEnum):
    """Whose a row's truth is."""

    SOURCE = "source's simulation"
    TWIN = "our twin"  # or another drawing of our own
    SECOND = "our second drawer"  # other physics and another hand's habits, but ours
    OTHER = "other renderer"  # or solver: a program that is not ours
    REAL = "real"
    NONE = "none"  # a time, or what is compared with itself


@dataclass(frozen=True, slots=True)
class Basis:
    """What a row's number rests on, so that it is compared with its like.

    calibration : "exact" (the truth's), "own" (found by the product from pictures) or "-" where there is none. seeds :
    "set on" where they were in view while constants were set, "held out" where not, "-" where nothing is drawn.
    draws : so many independent ones. left_out : of the data, before the number was made.
    """

    truth: Truth
    calibration: str
    seeds: str
    draws: int = 1
    left_out: str = "nothing"


@dataclass(frozen=True, slots=True)
class Row:
    """`ok` is None where nothing was asked and the number only informs."""

    what: str
    source: str  # the dissertation's number, or "-"
    target: str
    measured: str  # with unit
    ok: bool | None = None
    theory: str = "-"  # what can be reached at all, or is exact


@dataclass(slots=True)
class Table:
    """Topics are modules of `package` with `rows() -> list[Row]`, in the order in which they run, and their headings.

    `made_by` is the command that writes `folder`/RESULTS.md; "" if the table is only printed. claims : by topic and by
    how a row's title begins, what it rests on; the longest beginning counts. alone : topics are being run by
    themselves, so that their pictures go to build/pictures, and those beside RESULTS.md stay what it was made with.
    """

    package: str
    title: str
    topics: Mapping[str, str]
    folder: Path
    made_by: str = ""
    claims: Mapping[str, Mapping[str, Basis]] = field(default_factory=dict)
    alone: bool = field(default=False, init=False)

    def basis(self, topic: str, what: str) -> Basis | None:
        """Of a row by its title; None where nobody said."""
        of = self.claims.get(topic, {})
        begins = [begin for begin in of if what.startswith(begin)]
        return of[max(begins, key=len)] if begins else None

    @property
    def pictures(self) -> Path:
        folder = Path("build/pictures") if self.alone else self.folder / "pictures"
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def run(self, wanted: Sequence[str] = ()) -> int:
        """Runs the topics `wanted`, or all, and then writes RESULTS.md whole. The exit status: 1 if anything missed."""
        before, text, missed = os.getloadavg()[0], [""], 0
        self.alone = bool(wanted)
        for topic in wanted or self.topics:
            began = time.monotonic()
            print(f"== {topic}", flush=True)
            rows, note = self._rows(topic)
            missed += sum(row.ok is False for row in rows)
            lines = section(self.topics[topic], rows, note, [self.basis(topic, row.what) for row in rows])
            print("\n".join(lines), f"{time.monotonic() - began:.0f} s", flush=True)
            text += lines
        if self.made_by and not wanted:
            (self.folder / "RESULTS.md").write_text("\n".join([*self._head(before), *text]))
            _quoted_anew()
        print(f"{missed} rows miss their target" if missed else "every target met")
        return 1 if missed else 0

    def _rows(self, topic: str) -> tuple[list[Row], str]:
        """Its rows and its note; one that breaks, while it is imported or later, becomes a row that says so."""
        try:
            module = importlib.import_module(f"{self.package}.{topic}")
            return module.rows(), getattr(module, "NOTE", "").strip()
        except Exception as error:  # must not cost the others their minutes
            traceback.print_exc()
            reason = " ".join(str(error).split()).replace("|", "/")
            return [Row(f"{topic} broke", "-", "runs", f"{type(error).__name__}: {reason}", False)], ""

    def _head(self, load_before: float) -> list[str]:
        def git(*arguments: str) -> str:
            done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True)
            return done.stdout.strip()

        changed = " with changes" if git("status", "--porcelain", "--", "*.py", "*.c", "*.h") else ""
        return [
            f"# {self.title}",
            f"Made by `{self.made_by}` at {git('rev-parse', '--short', 'HEAD')}{changed}, Python "
            f"{platform.python_version()}, {platform.machine()}, {os.cpu_count()} cores; load before and at the end "
            f"{load_before:.1f}, {os.getloadavg()[0]:.1f}. Do not edit. Pictures: [pictures/](pictures).",
        ]


def _quoted_anew() -> None:
    """docs/manual/source.md has numbers of these tables."""
    try:
        importlib.import_module("tools.source").write()
    except ValueError as error:
        print(f"docs/manual/source.md stays as it was: {error}")


def section(title: str, rows: Sequence[Row], note: str = "", bases: Sequence[Basis | None] = ()) -> list[str]:
    """Markdown of one topic. Columns of theory, and of what the numbers rest on, only where a row has any."""
    theory = any(row.theory != "-" for row in rows)
    rests = RESTS_ON if any(bases) else ()
    head = ["what", "source", *(["theory"] if theory else []), "asked", "this project", "", *rests]
    lines = [f"## {title}", *([note, ""] if note else []), line(head), "|---" * len(head) + "|"]
    for row, basis in zip(rows, bases or [None] * len(rows), strict=True):
        known = [row.source, row.theory] if theory else [row.source]
        rest = [str(value) for value in astuple(basis)] if basis else ["-"] * len(rests)
        lines.append(line([row.what, *known, row.target, row.measured, verdict(row, basis), *rest]))
    return [*lines, ""]


def verdict(row: Row, basis: Basis | None) -> str:
    """ "met" beside a number of the source says of how many draws, where they are few."""
    beside = basis is not None and basis.draws < HEADLINE_DRAWS and any(c.isdigit() for c in row.source)
    if row.ok and basis is not None and beside:
        return f"met, {basis.draws} draw{'s' if basis.draws > 1 else ''}"
    return MARKS[row.ok]


def line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
