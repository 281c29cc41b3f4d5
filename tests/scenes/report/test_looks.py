"""How a page looks: in a browser at three widths, to a checker of accessibility, and on two papers by two printers."""

import io
import json
import math
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pypdf
import pytest
from browser import chromium, faults, opened
from synthetic_pipe import CALIBRATION, bump, pocket, round_pipe, scan

from annulus_pipe.qualification.digs import Dig, DugKind
from annulus_pipe.qualification.matching import SurveyPlace
from annulus_pipe.qualification.trials import Pull
from annulus_pipe.qualification.unity import SurveyResults, ToolClaim, study
from annulus_pipe.report import Paper, ScanAccount, write
from annulus_pipe.report.pdf import to_pdf
from annulus_pipe.report.unity_page import draw_unity, unity_page
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.conformity import Criteria, judge
from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure
from annulus_pipe.wall.survey import survey
from annulus_pipe.wall.texture import LedFrame
from annulus_pipe.wings.fringe.measure.plate import Plate
from annulus_pipe.wings.fringe.plate_page import write_plate
from annulus_pipe.wings.joints.page import write_joint_page

PAGES = ("damaged", "sound", "plate", "joint", "unity")
WIDTHS = (1400, 1024, 390)
MOST = [("damaged", 10), ("sound", 7), ("plate", 3), ("joint", 3), ("unity", 3)]  # pages on paper
PAPERS = {"A4": (595.3, 841.9), "Letter": (612.0, 792.0)}  # points
JOINT = Feature(FeatureKind.JOINT, 90.0, 8.0, remark="butt fusion", measures=(FeatureMeasure("height_mm", 3.4, 0.193),))
OPENING = Feature(FeatureKind.BRANCH, 60.0, 25.0, 355.0, 20.0, (FeatureMeasure("inner_d_mm", 25.2, 1.0),))
PLACE = Defect(Kind.LOSS, 30.0, 60.0, 12.0, 20.0, 1.5, 200.0, False, 2.4)
LIMITS = """
title = "What the client named"
accept_severity = 1
[[loss]]
severity = 3
depth_mm = 2.0
[[ovality]]
severity = 2
percent = 3
[[bore]]
severity = 5
smallest_mm = 145
"""
LONG = 'a recording with </style> a name, as "long" as they get/' + "x" * 90 + ".mcap"


def write_pipes(out: Path) -> None:
    camera = CALIBRATION.camera
    grey = np.full((camera.height, camera.width, 3), 120, np.uint8)
    shape = bump(pocket(round_pipe, 90, 12, 130, 160, 4.0), 200, 170, 14, 3.0)
    pipe = survey(scan(shape, z_mm=[3.0 * i for i in range(36)]), CALIBRATION, [LedFrame(4, 20.0, grey)])
    assert len(pipe.defects) == 2
    pipe = replace(pipe, features=(JOINT, OPENING), detection=replace(pipe.detection, undecided=(PLACE,)))
    findings = (Finding("dark", "one frame is dark: it says nothing", (7,)),)
    account = ScanAccount(
        LONG,
        {"projector": 36, "led": 1, "unknown": 2},
        {"camera": 3, "frames_unknown": 2},
        {},
        findings,
        verdict=judge(pipe, Criteria.from_dict(tomllib.loads(LIMITS))),
    )
    write(pipe, account, out / "damaged")
    plain = survey(scan(round_pipe, z_mm=[4.0 * i for i in range(20)]), CALIBRATION)
    assert not plain.defects
    write(plain, ScanAccount("a sound pipe", {"projector": 20}, {}, {}), out / "sound")


def write_flat(out: Path) -> None:
    x, y = np.arange(60.0), np.arange(40.0)
    height = np.where(x[None] > 55, np.nan, np.hypot(x[None] - 30, y[:, None] - 20) / 10)
    places = np.arange(4.0)
    plate = Plate(
        x,
        y,
        height,
        np.full_like(height, 0.02),
        np.full_like(height, 90.0),
        np.full_like(height, 0.5),
        np.ones(height.shape, bool),
        300.0,
        {"too little light": 160},
        (0, 1, 2, 3),
        places,
        0.01 + 0 * places,
        places,
        (),
        {},
    )
    write_plate(plate, ScanAccount("a plate", {"projector": 4}, {}, {}), out / "plate")


def write_joint(folder: Path) -> None:
    folder.mkdir(parents=True)
    spread = {"median": 10.0, "least": 9.0, "greatest": 11.0}
    summary = {
        "outer_diameter_mm": 110.0,
        "wall_mm": spread,
        "ovality_percent": 0.4,
        "T_mm": spread,
        "T_sigma_mm": 0.03,
        "W_mm": spread,
        "W_sigma_mm": 0.04,
        "zone_density_percent": spread,
        "angles_without_zone": 3,
        "hilo_mm": {"greatest_outside": -0.5, "at_deg": 90.0, "sigma": 0.02, "axes_aside": 0.25},
    }
    flaw = {
        "kind": "void",
        "phi_deg": 12.0,
        "rho": 50.0,
        "from_joint_mm": -0.5,
        "arc_deg": 3.0,
        "length_mm": 1.5,
        "depth_mm": 2.0,
        "snr": 9.0,
    }
    (folder / "features.json").write_text(json.dumps({"summary": summary, "found": [flaw]}))
    picture = cv2.imencode(".png", np.full((300, 1350, 3), 200, np.uint8))[1].tobytes()
    for name in ("density.png", "beads.png", "features.png"):
        (folder / name).write_bytes(picture)
    write_joint_page(folder)


def write_unity(out: Path) -> None:
    """Digs of every outcome."""
    names = ("D1", "D2", "D3", "D4", "?1")
    kinds = ("loss", "bump", "loss", "loss", "loss")
    places = [
        SurveyPlace(name, kind, 900.0 * i, 90.0, 20.0, 30.0, 0.7 * i, 0.2, i == 3, name == "?1")
        for i, (name, kind) in enumerate(zip(names, kinds, strict=True), 1)
    ]
    rows = [(1, "loss", 0.6, 0.1), (2, "bump", 2.2, 0.1), (3, "loss", 2.4, math.nan), (5, "loss", 3.0, 0.1)]
    rows += [(6, "loss", 1.0, 0.1), (7, "sound", math.nan, math.nan)]
    digs = [
        Dig(i, f"a place with a name {i}", DugKind(kind), 900.0 * i - 80.0, 95.0, depth, u, 20.0, 20.0)
        for i, kind, depth, u in rows
    ]
    claim = ToolClaim(0.8, (("", 0.3),), "as claimed")
    found = study(SurveyResults(Pull(LONG, "", 0.0, 9000.0, 60.0, 0.2), tuple(places)), digs, "digs.csv", claim, 300.0)
    out.mkdir()
    page = unity_page(found, draw_unity(found), "2026-11-29T02:00:00+00:00")
    (out / "report.html").write_text(page, encoding="utf-8")


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("pages")
    write_pipes(out)
    write_flat(out)
    write_joint(out / "joint")
    write_unity(out / "unity")
    return out


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as one:
        yield one


@pytest.mark.deep(
    gate="tests/scenes/report/test_looks.py::test_report_pdf_has_every_column_page_numbers_letters_of_its_own_and_tags"
)
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", PAGES)
def test_a_page_fits_every_window_asks_for_nothing_and_has_no_fault(
    pages: Path, browser: Any, name: str, width: int
) -> None:
    with opened(browser, pages / name / "report.html", width) as (tab, asked):
        assert tab.evaluate("document.documentElement.scrollWidth") == width
        assert asked == []
        assert faults(tab) == []


def depths(folder: Path) -> list[str]:
    """What the depth column says."""
    page = (folder / "report.html").read_text(encoding="utf-8")
    return re.findall(r'<td class="depth">([^<]+)</td>', page)


def check_print(data: bytes, paper: str, wanted: list[str], most: int) -> None:
    reader = pypdf.PdfReader(io.BytesIO(data))
    assert 1 <= len(reader.pages) <= most
    said = ""
    for number, page in enumerate(reader.pages, start=1):
        width, height = float(page.mediabox.width), float(page.mediabox.height)
        assert (width, height) == pytest.approx(PAPERS[paper], abs=1.5)
        beyond: list[str] = []

        def look(
            text: str, ctm: list[float], tm: list[float], *_: Any, right: float = width, out: list[str] = beyond
        ) -> None:
            x = tm[4] * ctm[0] + ctm[4]
            if text.strip() and x > right - 10:  # drawings have places of their own, from their middle
                out.append(text)

        text = page.extract_text(visitor_text=look)
        assert f"page {number} of {len(reader.pages)}" in " ".join(text.split())
        assert not beyond
        said += text
    plain = "".join(said.split())
    for one in wanted:
        assert "".join(one.split()) in plain, one


@pytest.mark.deep(
    gate="tests/scenes/report/test_looks.py::test_report_pdf_has_every_column_page_numbers_letters_of_its_own_and_tags"
)
@pytest.mark.parametrize("paper", PAPERS)
@pytest.mark.parametrize(("name", "most"), MOST)
def test_a_browser_prints_every_column_with_page_numbers(
    pages: Path, browser: Any, name: str, most: int, paper: str
) -> None:
    with opened(browser, pages / name / "report.html", 1400) as (tab, _):
        data = tab.pdf(format=paper, print_background=True)
    wanted = depths(pages / name)
    assert len(wanted) >= (3 if name == "damaged" else 0)
    check_print(data, paper, wanted, most)


@pytest.mark.deep(but="joint-3-Letter")
@pytest.mark.parametrize("paper", PAPERS)
@pytest.mark.parametrize(("name", "most"), MOST)
def test_report_pdf_has_every_column_page_numbers_letters_of_its_own_and_tags(
    pages: Path, name: str, most: int, paper: str
) -> None:
    page = (pages / name / "report.html").read_text(encoding="utf-8")
    data = to_pdf(page, Paper.A4 if paper == "A4" else Paper.LETTER)
    check_print(data, paper, depths(pages / name), most)
    reader = pypdf.PdfReader(io.BytesIO(data))
    title = re.search("<title>([^<]*)</title>", page)
    assert title and reader.metadata and reader.metadata.author == "annulus"
    assert reader.root_object["/MarkInfo"]["/Marked"] and reader.root_object["/Lang"] == "en"  # type: ignore[index]
    fonts = {str(f["/BaseFont"]) for one in reader.pages for f in one["/Resources"]["/Font"].values()}  # type: ignore[index]
    assert fonts and all("DejaVu" in name for name in fonts)


@pytest.mark.parametrize("name", PAGES)
def test_nothing_is_wider_than_the_paper(pages: Path, browser: Any, name: str) -> None:
    """A4 between its margins is 186 mm, 703 px; what is wider would be cut off, tables first."""
    with opened(browser, pages / name / "report.html", 703) as (tab, _):
        tab.emulate_media(media="print")
        assert tab.evaluate("document.documentElement.scrollWidth") == 703


def test_the_pictures_on_paper_are_as_wide_as_their_scale_says(pages: Path, browser: Any) -> None:
    """186 mm, of which 150 are the axis."""
    with opened(browser, pages / "damaged" / "report.html", 1400) as (tab, _):
        tab.emulate_media(media="print")
        wide = tab.evaluate("[...document.querySelectorAll('.figure img')].map(x => x.getBoundingClientRect().width)")
    assert len(wide) == 3 and wide == pytest.approx([186 / 25.4 * 96] * 3, abs=0.5)


@pytest.mark.deep(
    gate="tests/scenes/report/test_looks.py::test_report_pdf_has_every_column_page_numbers_letters_of_its_own_and_tags"
)
def test_a_system_without_fonts_writes_letters_all_the_same(pages: Path, tmp_path: Path) -> None:
    """A fresh Debian has none; fontconfig then gives nothing, and WeasyPrint alone draws boxes."""
    empty = tmp_path / "fonts.conf"
    empty.write_text(f"<fontconfig><dir>{tmp_path}</dir><cachedir>{tmp_path}</cachedir></fontconfig>")
    source, out = pages / "damaged" / "report.html", tmp_path / "report.pdf"
    program = (
        "import sys, pathlib; from annulus_pipe.report.pdf import to_pdf\n"
        "source, out = map(pathlib.Path, sys.argv[1:]);"
        "out.write_bytes(to_pdf(source.read_text(encoding='utf-8')))"
    )
    environment = {**os.environ, "FONTCONFIG_FILE": str(empty)}
    done = subprocess.run(
        [sys.executable, "-c", program, str(source), str(out)], env=environment, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    check_print(out.read_bytes(), "A4", depths(pages / "damaged"), 10)
