"""Rows of a benchmark, the table they make, and the run that makes it."""

import importlib
import os
import platform
import subprocess
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT.parent / "shared" / "scenes"  # not on a user's machine: such rows are left out there
MARKS = {True: "met", False: "**missed**", None: ""}


@dataclass(frozen=True, slots=True)
class Row:
    """`ok` is None where nothing was asked and the number only informs."""

    what: str
    source: str  # the dissertation's number, or "-"
    target: str
    measured: str  # with unit
    ok: bool | None = None
    theory: str = "-"  # what can be reached at all, or is exact


@dataclass(frozen=True, slots=True)
class Table:
    """Topics are modules of `package` with `rows() -> list[Row]`, in the order in which they run, and their headings.

    `made_by` is the command that writes `folder`/RESULTS.md; "" if the table is only printed.
    """

    package: str
    title: str
    topics: Mapping[str, str]
    folder: Path
    made_by: str = ""

    @property
    def pictures(self) -> Path:
        (self.folder / "pictures").mkdir(exist_ok=True)
        return self.folder / "pictures"

    def run(self, wanted: Sequence[str] = ()) -> int:
        """Runs the topics `wanted`, or all, and then writes RESULTS.md whole. The exit status: 1 if anything missed."""
        before, text, missed = os.getloadavg()[0], [""], 0
        for topic in wanted or self.topics:
            began = time.monotonic()
            print(f"== {topic}", flush=True)
            rows, note = self._rows(topic)
            missed += sum(row.ok is False for row in rows)
            lines = section(self.topics[topic], rows, note)
            print("\n".join(lines), f"{time.monotonic() - began:.0f} s", flush=True)
            text += lines
        if self.made_by and not wanted:
            (self.folder / "RESULTS.md").write_text("\n".join([*self._head(before), *text]))
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


def section(title: str, rows: Sequence[Row], note: str = "") -> list[str]:
    """Markdown of one topic. A column of theory only where a row has any."""
    theory = any(row.theory != "-" for row in rows)
    head = ["what", "source", *(["theory"] if theory else []), "asked", "this project", ""]
    lines = [f"## {title}", *([note, ""] if note else []), line(head), "|---" * len(head) + "|"]
    for row in rows:
        known = [row.source, row.theory] if theory else [row.source]
        lines.append(line([row.what, *known, row.target, row.measured, MARKS[row.ok]]))
    return [*lines, ""]


def line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
