"""Promises of the manual as a reader meets it: built without a warning, searched from a folder, nothing fetched; and
what it tells a reader to type does what it says.
"""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_core_python.sync_playwright import Axe
from browser import chromium
from playwright.sync_api import Page

from tools.manual import commands
from tools.manual.__main__ import build
from tools.manual.pages import DOCS
from tools.sample.__main__ import write as write_sample

pytestmark = [pytest.mark.timeout(900), pytest.mark.deep(gate="tests/unit/test_docs.py::test_examples_can_be_typed")]

AXED = ("index", "manual/first-scan", "manual/troubleshooting", "manual/head-toml", "manual/python")
LOOKED_AT = (
    *AXED,
    "manual/commands",
    "manual/messages",
    "manual/topics",
    "manual/gallery",
    "manual/rooms/daemon",
    "manual/accuracy/metrology",
)
RUN = re.compile(r"^<!-- run: .* -->\n```sh\n(.*?)^```", re.M | re.S)
ALONE = ("timing", "sample", "burst show", "burst design", "bore simulate")  # need no head, file or minutes


@pytest.fixture(scope="module")
def manual(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("shipped") / "manual"
    build(place)
    return place


@pytest.fixture(scope="module")
def page(manual: Path) -> Iterator[Page]:
    with chromium() as browser:
        yield browser.new_page(viewport={"width": 1400, "height": 1000})


def test_it_is_small_whole_and_put_in_place_of_the_old_one(manual: Path) -> None:
    size = sum(file.stat().st_size for file in manual.rglob("*") if file.is_file())
    assert size < 10e6 and not list(manual.parent.glob(".manual-*"))
    assert (manual / "index.html").is_file() and (manual / "searchindex.js").is_file()
    assert not [
        one
        for one in manual.rglob("*.html")
        if re.search(r"<(?:script|link|img)[^>]+(?:src|href)=\"https?:", one.read_text("utf-8"))
    ]


def test_searching_it_from_a_folder_finds_pages_and_fetches_nothing(manual: Path, page: Page) -> None:
    left, wrong = [], []
    page.on(
        "request", lambda request: left.append(request.url) if not request.url.startswith(("file:", "data:")) else None
    )
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto((manual / "index.html").as_uri())
    page.fill(".sidebar-search", "interlock")
    page.keyboard.press("Enter")
    page.wait_for_selector("#search-results li a", timeout=30_000)
    page.wait_for_timeout(500)
    found = page.locator("#search-results li a").all_inner_texts()
    assert len(found) > 5 and any("controller" in text.lower() for text in found)
    assert page.url.startswith("file:") and not left and not wrong


@pytest.mark.parametrize("width", [1400, 390])
def test_no_page_is_wider_than_its_window(manual: Path, page: Page, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    wide = {}
    for name in LOOKED_AT:
        page.goto((manual / f"{name}.html").as_uri())
        wide[name] = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
    page.set_viewport_size({"width": 1400, "height": 1000})
    assert not {name: over for name, over in wide.items() if over > 0}


def test_axe_finds_nothing_serious(manual: Path, page: Page) -> None:
    axe, found = Axe(), []
    for name in AXED:
        page.goto((manual / f"{name}.html").as_uri())
        violations: list[dict[str, Any]] = axe.run(page)["violations"]
        found += [(name, one["id"]) for one in violations if one["impact"] in ("serious", "critical")]
    assert not found


@pytest.fixture(scope="module")
def typed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of somebody who has the sample installed."""
    installed = tmp_path_factory.mktemp("installed")
    (installed / "annulus_sample").mkdir()
    (installed / "annulus_sample/__init__.py").touch()
    write_sample(installed / "annulus_sample")
    return {**os.environ, "PYTHONPATH": str(installed), "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}


def run(line: str, folder: Path, environment: dict[str, str]) -> str:
    done = subprocess.run(shlex.split(line), cwd=folder, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
    return done.stdout


def said_by(name: str, folder: Path, environment: dict[str, str]) -> str:
    """What a page's blocks that are marked to be run print, one after the other."""
    blocks = RUN.findall((DOCS / "manual" / name).read_text("utf-8"))
    return "".join(run(line, folder, environment) for block in blocks for line in block.strip().splitlines())


@pytest.mark.parametrize(
    ("name", "what"), [("calibrate.md", "poses      good"), ("tune.md", "every row sees all of it")]
)
def test_what_a_page_says_to_type_runs(name: str, what: str, typed: dict[str, str], tmp_path: Path) -> None:
    assert what in said_by(name, tmp_path, typed)


def test_four_defects_are_found_as_the_first_page_says(typed: dict[str, str], tmp_path: Path) -> None:
    said = said_by("first-scan.md", tmp_path, typed)
    assert "0 change" in said and "0 places damaged" in said
    assert [line.split()[0] for line in said.splitlines() if " clock " in line] == ["loss", "bump", "loss", "ovality"]
    assert (tmp_path / "results/report.html").is_file() and (tmp_path / "pipe-truth.json").is_file()


def test_every_block_marked_to_be_run_is_run() -> None:
    marked = {page.name for page in (DOCS / "manual").glob("*.md") if "<!-- run:" in page.read_text("utf-8")}
    assert marked == {"calibrate.md", "tune.md", "first-scan.md"}


def test_examples_of_help_run_where_they_need_nothing(typed: dict[str, str], tmp_path: Path) -> None:
    lines = {name: line for name, line in reversed([*commands.examples()])}  # the first of each
    for name in ALONE:
        run(lines[f"annulus {name}"], tmp_path, typed)


def test_without_the_sample_or_the_manual_one_line_says_how_to_get_them(tmp_path: Path) -> None:
    for command, what in (("sample", "make sample"), ("docs", "make docs")):
        code = f"import sys; sys.modules['annulus_sample'] = None; sys.argv = ['annulus', {command!r}]; "
        code += "import annulus_pipe.shipped as s; s.MANUAL = 'nowhere'; s._MADE_BY = {'nowhere': 'make docs'}; "
        done = subprocess.run(
            [sys.executable, "-c", code + "from annulus_pipe.cli import main; main()"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 1 and what in done.stderr and done.stderr.count("\n") == 1, done.stderr
