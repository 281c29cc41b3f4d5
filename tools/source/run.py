"""Runs commands of the table as they stand, in a folder that looks like a checkout's root."""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from tools.bench.table import ROOT
from tools.source import Entry, entries, parts

PART_S = 600.0  # far beyond the longest, about a minute: a command that waits for something is ended


class Workplace:
    """A folder with what the lines expect of a checkout. A part of a line that ran is not run again: what it made is
    there, and what it printed is kept."""

    def __init__(self, folder: Path) -> None:
        (folder / "build").mkdir(parents=True)
        (folder / "tests").symlink_to(ROOT / "tests")
        self._folder, self._ran = folder, dict[str, tuple[int, str]]()

    def done(self, line: str) -> tuple[int, str]:
        """The status of a line of the table, that of its first part that fails, and what was printed until then."""
        printed = ""
        for part in parts(line):
            if part not in self._ran:
                self._ran[part] = self._run(part)
            status, text = self._ran[part]
            printed += text
            if status:
                return status, printed
        return 0, printed

    def _run(self, part: str) -> tuple[int, str]:
        places = [str(Path(sys.executable).parent), os.environ.get("PATH", "")]
        ran = subprocess.run(
            ["bash", "-c", part],
            cwd=self._folder,
            env=os.environ | {"PATH": os.pathsep.join(places), "PYTHONPATH": str(ROOT)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=PART_S,
        )
        return ran.returncode, ran.stdout


def amiss(status: int, printed: str, rows: Sequence[Entry]) -> list[str]:
    """What is wrong with a line's answer: its status, and numbers that its rows quote and it did not print."""
    if status:
        return [f"status {status}: {printed.strip().splitlines()[-1] if printed.strip() else 'nothing printed'}"]
    text = " ".join(printed.split())
    return [f"{row.section}: does not print {one!r}" for row in rows for one in row.prints if one not in text]


def lines(sections: Sequence[str] = ()) -> dict[str, list[Entry]]:
    """Every line once, with the rows that have it."""
    out: dict[str, list[Entry]] = {}
    for row in entries():
        if row.command and (not sections or any(row.section.startswith(one) for one in sections)):
            out.setdefault(row.command, []).append(row)
    return out


def run(folder: Path, sections: Sequence[str]) -> int:
    place, failed = Workplace(folder / "checkout"), 0
    for line, rows in lines(sections).items():
        began = time.monotonic()
        wrong = amiss(*place.done(line), rows)
        failed += bool(wrong)
        print(f"{time.monotonic() - began:5.1f} s  {'; '.join(wrong) or 'ok'}  {line}", flush=True)
    print(f"{failed} lines fail" if failed else "every line runs")
    return 1 if failed else 0
