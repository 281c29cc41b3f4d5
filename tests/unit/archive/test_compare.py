"""Two scans of one pipe: rows find their place, what grew is found with its k = 2, and nothing is made up."""

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.archive.comparison import Comparison, compare_maps
from annulus_pipe.archive.wall_map import WallMap
from annulus_pipe.cli.app import app
from annulus_pipe.vocabulary import AnnulusError
from tests.unit.archive.pairs import Pair, Scene, draw

SHORT = Scene(length_mm=3000, slips_mm=(15.0,), grown=2, unchanged=2, new=1, spots=80, zero_mm=-80)


@lru_cache(maxsize=1)
def short() -> tuple[Pair, Comparison]:
    pair = draw(3, SHORT)
    return pair, compare_maps(pair.first, pair.second)


def places_mm(pair: Pair, found: Comparison) -> float:
    off = found.alignment.z_mm - pair.z_of_second
    return float(np.percentile(np.abs(off[np.isfinite(off)]), 95))


def roll_deg(pair: Pair, found: Comparison) -> float:
    off = (found.alignment.roll_deg - pair.roll_of_second + 180) % 360 - 180
    return float(np.sqrt(np.nanmean(off**2)))


def growths(pair: Pair, found: Comparison) -> tuple[int, int, list[float], list[float]]:
    """Of those that grew, found; made up; errors, mm; errors in their k = 2."""
    used: set[int] = set()
    errors, parts = [], []
    for change in found.changed:
        for k, one in enumerate(pair.grown):
            off = abs((change.clock_deg - one.clock_deg + 180) % 360 - 180)
            if k not in used and abs(change.z_mm - one.z_mm) < one.length_mm / 2 + 10 and off < one.arc_deg / 2 + 6:
                used.add(k)
                errors.append(change.growth_mm - one.growth_mm)
                parts.append(abs(errors[-1]) / change.growth_k2_mm)
                break
    return len(used), len(found.changed) - len(used), errors, parts


@pytest.mark.deep(
    gate="tests/unit/archive/test_compare.py::test_a_pipe_that_did_not_change_has_no_growth_and_the_limit_is_said"
)
def test_rows_find_their_place_and_growth_is_found_with_none_made_up() -> None:
    pair, found = short()
    assert places_mm(pair, found) < 1.5 and roll_deg(pair, found) < 0.25
    hit, false, errors, parts = growths(pair, found)
    assert (hit, false) == (len(pair.grown), 0)
    assert np.sqrt(np.mean(np.square(errors))) < 0.08 and max(parts) < 2.0


@pytest.mark.deep(
    gate="tests/unit/archive/test_compare.py::test_a_pipe_that_did_not_change_has_no_growth_and_the_limit_is_said"
)
def test_what_is_said_of_places_holds_for_95_percent() -> None:
    pair, found = short()
    off = np.abs(found.alignment.z_mm - pair.z_of_second)
    known = np.isfinite(off)
    assert np.mean(off[known] <= 2 * found.alignment.sigma_z_mm[known]) > 0.9
    assert known.mean() > 0.9


@pytest.mark.deep(
    gate="tests/unit/archive/test_compare.py::test_a_pipe_that_did_not_change_has_no_growth_and_the_limit_is_said"
)
def test_a_bare_pipe_says_how_unsure_its_places_are_and_nothing_is_made_up() -> None:
    shares, sizes = [], []
    for seed in (6, 7, 8):
        pair = draw(seed, replace(SHORT, texture_rms_mm=0.0, unchanged=3, gone=1))
        found = compare_maps(pair.first, pair.second)
        off = np.abs(found.alignment.z_mm - pair.z_of_second)
        known = np.isfinite(off)
        shares.append(np.mean(off[known] <= 2 * found.alignment.sigma_z_mm[known]))
        sizes.append(np.median(found.alignment.sigma_z_mm[known]))
        assert growths(pair, found)[1] == 0
        assert found.alignment.found < 0.5
    assert np.mean(shares) > 0.85 and max(sizes) < 20.0


def test_a_pipe_that_did_not_change_has_no_growth_and_the_limit_is_said() -> None:
    pair = draw(5, replace(SHORT, grown=0, new=0, unchanged=4))
    found = compare_maps(pair.first, pair.second)
    assert found.changed == []
    assert found.sentence().startswith("No growth that these two scans could tell; the smallest")
    assert 0.05 < found.growth.least_median_mm < 0.25


@pytest.mark.deep(
    gate="tests/unit/archive/test_compare.py::test_a_pipe_that_did_not_change_has_no_growth_and_the_limit_is_said"
)
def test_swapped_scans_shrink_what_grew() -> None:
    pair, there = short()
    back = compare_maps(pair.second, pair.first)
    assert len(back.changed) == len(there.changed)
    assert sum(one.growth_mm for one in back.changed) == pytest.approx(
        -sum(one.growth_mm for one in there.changed), abs=0.2
    )


@pytest.mark.deep(
    gate="tests/unit/archive/test_compare.py::test_a_pipe_that_did_not_change_has_no_growth_and_the_limit_is_said"
)
def test_a_scan_from_the_other_end_is_turned_about_and_said_so() -> None:
    pair, there = short()
    found = compare_maps(pair.first, pair.second.turned_about())
    assert found.alignment.reversed and "other end" in found.remarks()[0]
    off = found.alignment.z_mm[::-1] - pair.z_of_second
    assert np.nanpercentile(np.abs(off), 95) < 1.5
    assert [one.verdict for one in found.changed] == [one.verdict for one in there.changed]


def test_two_pipes_do_not_match() -> None:
    pair = draw(3, SHORT, pipe=77)
    with pytest.raises(AnnulusError, match="does not match"):
        compare_maps(pair.first, pair.second)


def test_pipes_of_two_sizes_do_not_match() -> None:
    pair, _ = short()
    with pytest.raises(AnnulusError, match="radius"):
        compare_maps(pair.first, replace(pair.second, radius_mm=100.0))


def test_stretches_that_do_not_overlap_do_not_match() -> None:
    pair = draw(3, SHORT)
    cut = 300
    first = WallMap("first", pair.first.deviation_mm[:cut], 0.0, 4.0, 76.2, pair.first.imu_roll_deg[:cut])
    second = WallMap("second", pair.second.deviation_mm[-cut:], 0.0, 4.0, 76.2, pair.second.imu_roll_deg[-cut:])
    with pytest.raises(AnnulusError, match="does not match"):
        compare_maps(first, second)


@pytest.mark.deep(
    gate="tests/unit/archive/test_compare.py::test_a_pipe_that_did_not_change_has_no_growth_and_the_limit_is_said"
)
def test_other_steps_columns_and_nominal_radii_are_one_pipe() -> None:
    pair = draw(8, replace(SHORT, step_second_mm=5.0, columns_second=288, radius_second_mm=76.0))
    found = compare_maps(pair.first, pair.second)
    assert places_mm(pair, found) < 2.0
    hit, false, _, _ = growths(pair, found)
    assert (hit, false) == (len(pair.grown), 0)


@pytest.mark.deep(
    gate="tests/unit/archive/test_compare.py::test_a_pipe_that_did_not_change_has_no_growth_and_the_limit_is_said"
)
def test_nothing_grew_where_one_of_the_two_did_not_see() -> None:
    pair, _ = short()
    one = pair.grown[0]
    hidden = pair.second.deviation_mm.copy()
    hidden[np.abs(pair.z_of_second - one.z_mm) < one.length_mm] = np.nan
    found = compare_maps(pair.first, replace(pair.second, deviation_mm=hidden))
    assert all(abs(change.z_mm - one.z_mm) > one.length_mm / 2 for change in found.changed)
    assert len(found.changed) == len(pair.grown) - 1


@pytest.mark.deep(
    gate="tests/unit/archive/test_compare.py::test_a_pipe_that_did_not_change_has_no_growth_and_the_limit_is_said"
)
def test_the_command_writes_json_a_page_and_says_what_grew(tmp_path: Path) -> None:
    pair, there = short()
    files = []
    for wall in (pair.first, pair.second):
        files.append(tmp_path / f"{wall.name}.npz")
        away = np.where(np.isfinite(wall.deviation_mm), np.rint(1000 * wall.deviation_mm), -32768).astype(np.int16)
        np.savez(
            files[-1],
            deviation_um=away,
            z_step_mm=wall.step_mm,
            radius_mm=wall.radius_mm,
            imu_roll_deg=wall.imu_roll_deg,
        )
    out, page = tmp_path / "growth.json", tmp_path / "growth.html"
    ran = CliRunner().invoke(
        app, ["archive", "compare", *map(str, files), "-o", str(out), "--page", str(page), "--json"]
    )
    assert ran.exit_code == 0, ran.output
    told = json.loads(out.read_text())
    assert len(told["z_of_second"]) == len(told["roll_of_second"]) == len(pair.second.deviation_mm)
    assert len(told["growth"]) == len(there.changed)
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 2 and "<script" not in text and "http" not in text
    assert told["says"] in text
