import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.storage.calibration_file import load_calibration
from annulus_pipe.vocabulary import AnnulusError

GIVEN = [
    "pattern",
    "design",
    "--pipe-mm",
    "152.4",
    "--distance-mm",
    "56",
    "--sensor-radius-mm",
    "9",
    "--glass-mm",
    "45",
    "--projector-f-mm",
    "12",
]


def test_the_slide_is_to_scale_and_the_calibration_loads(tmp_path: Path) -> None:
    run = CliRunner().invoke(app, [*GIVEN, "--f", "235", "--size", "832x616", "--slit-px", "4", "-o", str(tmp_path)])
    assert run.exit_code == 0, run.output
    svg = (tmp_path / "slide.svg").read_text()
    width_pt = float(re.search(r'width="([\d.]+)pt"', svg)[1])  # type: ignore[index]
    assert re.search(rf'viewBox="0 0 {width_pt:.6f}'.rstrip("0"), svg)  # a unit of the drawing is a point of the page
    # the outermost stripe, as its circle's leftmost and rightmost points
    stated = float(run.stdout.split("written")[0].split()[-1])
    circles = [
        [float(v) for v in re.findall(r"[MC] ([\d.]+) ", path)]
        + [float(v) for v in re.findall(r" ([\d.]+) [\d.]+ \n", path)]
        for path in re.findall(r'<path d="(M [^"]*?z)', svg)
        if path.count("C") == 8
    ]
    widest = max(max(xs) - min(xs) for xs in circles if xs)
    assert widest / 72 * 25.4 / 2 == pytest.approx(stated, abs=5e-5)
    assert (tmp_path / "slide.pdf").read_bytes()[:5] == b"%PDF-"
    assert len(load_calibration(tmp_path / "calibration.json").rings) == 8


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["-o", "x"], "either --camera FILE or --f"),
        (["-o", "x", "--f", "235", "--size", "big"], "like 1664x1232"),
        (["-o", "x", "--f", "235", "--size", "832x616", "--stripes", "5", "--rings", "4"], "give one"),
    ],
)
def test_contradictions_are_said(more: list[str], said: str) -> None:
    with pytest.raises(AnnulusError, match=said):
        CliRunner().invoke(app, [*GIVEN, *more], catch_exceptions=False)
