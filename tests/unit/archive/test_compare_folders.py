"""Two folders of results: every defect that either lists comes out paired with its growth, new, gone or not seen."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.archive.comparison import Comparison, compare, compare_maps
from annulus_pipe.archive.growth import GrowthVerdict
from annulus_pipe.cli.app import app
from annulus_pipe.vocabulary import AnnulusError
from tests.unit.archive.pairs import Pair, Scene, draw

SHORT = Scene(length_mm=3000, slips_mm=(15.0,), grown=2, unchanged=2, new=1, gone=1, spots=80, zero_mm=-80)


def folder(out: Path, pair: Pair, year: int) -> Path:
    """Results as far as compare reads them: the map, and a summary with what stands there that year."""
    out.mkdir()
    wall = (pair.first, pair.second)[year]
    away = np.where(np.isfinite(wall.deviation_mm), np.rint(1000 * wall.deviation_mm), -32768).astype(np.int16)
    np.savez(
        out / "wall.npz",
        deviation_um=away,
        z_step_mm=wall.step_mm,
        radius_mm=wall.radius_mm,
        imu_roll_deg=wall.imu_roll_deg,
    )
    listed = [listed_of(pair, one, year) for one in pair.defects if abs(one.depth_mm + year * one.growth_mm) > 0.1]
    listed.append(
        {
            "kind": "ovality",
            "z_mm": 1500.0,
            "length_mm": 400.0,
            "clock_deg": 20.0,
            "arc_deg": 360.0,
            "depth_mm": 1.0,
            "depth_k2_mm": 0.1,
        }
    )
    (out / "summary.json").write_text(json.dumps({"format": "annulus-summary/1", "defects": listed}))
    return out


def listed_of(pair: Pair, one: Any, year: int) -> dict[str, Any]:
    row = int(np.argmin(np.abs(pair.z_of_second - one.z_mm)))
    depth = one.depth_mm + year * one.growth_mm
    return {
        "kind": "loss" if depth > 0 else "bump",
        "depth_mm": abs(depth),
        "length_mm": one.length_mm,
        "arc_deg": one.arc_deg,
        "z_mm": one.z_mm if year == 0 else 4.0 * row,
        "clock_deg": (one.clock_deg if year == 0 else one.clock_deg - pair.roll_of_second[row]) % 360,
    }


def test_every_listed_defect_comes_out_once_with_its_growth(tmp_path: Path) -> None:
    pair = draw(3, replace(SHORT, oval_growth=0.3))
    first, second = (folder(tmp_path / str(year), pair, year) for year in (0, 1))
    found = compare(first, second)
    for year in (0, 1):
        names = [name for one in found.growth.changes for name in (one.first, one.second)[year].split()]
        there = [one for one in pair.defects if abs(one.depth_mm + year * one.growth_mm) > 0.1]
        assert sorted(names) == sorted(f"D{k}" for k in range(1, len(there) + 2))
    for one in pair.defects:
        change = min(
            (change for change in found.growth.changes if change.arc_deg < 360),
            key=lambda change: abs(change.z_mm - one.z_mm) + abs((change.clock_deg - one.clock_deg + 180) % 360 - 180),
        )
        assert bool(change.first) == (one.depth_mm != 0) and bool(change.second) == (one.growth_mm != -one.depth_mm)
        if one.growth_mm:
            assert change.growth_mm == pytest.approx(one.growth_mm, abs=0.15)
        else:
            assert change.verdict is GrowthVerdict.SAME
    oval = next(one for one in found.growth.changes if one.arc_deg == 360)
    assert oval.first and oval.second and oval.verdict is GrowthVerdict.GROWN


@pytest.mark.deep(gate="tests/unit/archive/test_compare_folders.py::test_a_summary_that_is_none_is_one_line")
def test_ovality_that_grew_by_a_third_is_told_within_its_k2() -> None:
    pair = draw(4, replace(SHORT, oval_growth=0.3))
    found = compare_maps(pair.first, pair.second)
    assert within_k2(pair, found) > 0.9
    assert "changed most" in found.ovality_sentence() and "no more than" not in found.ovality_sentence()


@pytest.mark.deep(gate="tests/unit/archive/test_compare_folders.py::test_a_summary_that_is_none_is_one_line")
def test_ovality_that_stayed_is_said_to_be_no_more_than_may_be_off() -> None:
    pair = draw(4, SHORT)
    found = compare_maps(pair.first, pair.second)
    known = np.isfinite(found.ovality.change)
    assert np.mean(np.abs(found.ovality.change[known]) <= found.ovality.change_k2[known]) > 0.9
    assert np.nanmedian(found.ovality.change_k2) < 0.1  # percent


def within_k2(pair: Pair, found: Comparison) -> float:
    """The share of stations whose change is as it is drawn, within its k = 2."""
    oval = found.ovality
    known = np.isfinite(oval.change)
    true = 100 * pair.oval_growth_mm(oval.z_mm) / found.difference.radius_mm
    return float(np.mean(np.abs(oval.change - true)[known] <= oval.change_k2[known]))


@pytest.mark.deep(gate="tests/unit/archive/test_compare_folders.py::test_a_summary_that_is_none_is_one_line")
def test_what_one_year_lists_beyond_the_others_ends_was_not_seen(tmp_path: Path) -> None:
    pair = draw(3, SHORT)
    first, second = (folder(tmp_path / str(year), pair, year) for year in (0, 1))
    summary = json.loads((second / "summary.json").read_text())
    place = {"kind": "loss", "z_mm": -400.0, "length_mm": 20.0, "clock_deg": 90.0, "arc_deg": 10.0, "depth_mm": 1.0}
    summary["defects"].append(place)
    (second / "summary.json").write_text(json.dumps(summary))
    found = compare(first, second)
    name = f"D{len(summary['defects'])}"
    (beyond,) = [one for one in found.growth.changes if name in one.second.split()]
    assert beyond.verdict is GrowthVerdict.UNSEEN and not beyond.first
    told = json.dumps(found.to_dict(), allow_nan=False)
    assert '"listed_second": ["' + name in told


def test_a_summary_that_is_none_is_one_line(tmp_path: Path) -> None:
    pair = draw(3, SHORT)
    first, second = (folder(tmp_path / str(year), pair, year) for year in (0, 1))
    (second / "summary.json").write_text("{}")
    with pytest.raises(AnnulusError, match=r"summary\.json"):
        compare(first, second)


@pytest.mark.deep(
    gate="tests/unit/archive/test_compare_folders.py::test_every_listed_defect_comes_out_once_with_its_growth"
)
def test_terminal_and_page_name_what_is_listed(tmp_path: Path) -> None:
    pair = draw(3, SHORT)
    folders = [str(folder(tmp_path / str(year), pair, year)) for year in (0, 1)]
    page = tmp_path / "growth.html"
    ran = CliRunner().invoke(app, ["archive", "compare", *folders, "--page", str(page)])
    assert ran.exit_code == 0, ran.output
    assert "not listed then, D" in ran.output and "ovality    changed most" in ran.output
    assert "Listed then" in page.read_text() and page.read_text().count("data:image/png;base64,") == 2
