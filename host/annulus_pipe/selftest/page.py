"""The result for people: one page that opens anywhere and prints, or a table for a terminal."""

import json
from importlib import resources
from pathlib import Path

import jinja2

from annulus_pipe.selftest.promise import PromiseVerdict, Row
from annulus_pipe.selftest.run import SelfTest
from annulus_pipe.vocabulary import AnnulusError

TEMPLATE = "page.html.j2"
SHOWN = {
    PromiseVerdict.KEPT: "kept",
    PromiseVerdict.BROKEN: "BROKEN",
    PromiseVerdict.NOT_WIRED: "not wired",
    PromiseVerdict.NOT_TESTED: "not tested",
    PromiseVerdict.INFORMS: "",
}


def verdict_line(test: SelfTest) -> str:
    """The result in a sentence."""
    missing = sum(row.verdict is PromiseVerdict.NOT_WIRED for row in test.rows)
    beyond = sum(row.verdict is PromiseVerdict.NOT_TESTED for row in test.rows)
    broken = f"{test.broken} BROKEN" if test.broken else "none broken"
    return f"{test.kept} promises kept, {broken}, {missing} not wired, {beyond} beyond a board's own reach"


def render_page(test: SelfTest) -> str:
    """One HTML document: no script, no font and no picture from anywhere else."""
    text = resources.files("annulus_pipe.selftest").joinpath(TEMPLATE).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    untested = (PromiseVerdict.NOT_WIRED, PromiseVerdict.NOT_TESTED)
    return environment.from_string(text).render(
        t=test,
        verdict=verdict_line(test),
        measured=[row for row in test.rows if row.verdict not in untested],
        untested=[row for row in test.rows if row.verdict in untested],
        shown=SHOWN,
    )


def render_table(rows: tuple[Row, ...]) -> str:
    """Columns for a terminal, the reason behind a verdict where there is no measurement."""
    lines = [
        (row.what, row.promise, row.measured if row.measured != "-" else row.why, SHOWN[row.verdict]) for row in rows
    ]
    lines.insert(0, ("", "promise", "measured", ""))
    widths = [max(len(line[i]) for line in lines) for i in range(3)]
    return "\n".join(
        "  ".join(cell.ljust(w) for cell, w in zip(line, (*widths, 0), strict=True)).rstrip() for line in lines
    )


def write(test: SelfTest, folder: Path) -> Path:
    """selftest.html and selftest.json; the page's path. AnnulusError when the folder cannot be written."""
    page = folder / "selftest.html"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        page.write_text(render_page(test), encoding="utf-8")
        (folder / "selftest.json").write_text(json.dumps(test.to_dict(), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise AnnulusError(f"{folder}: cannot be written ({error.strerror})") from None
    return page
