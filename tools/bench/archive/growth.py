"""`annulus archive compare` on pairs drawn from seeds, and on the pair of ../shared/survey where it is: places, roll,
growth found and made up."""

import importlib.util
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from annulus.archive.comparison import Comparison, compare, compare_maps
from tools.bench.table import ROOT, Row

SURVEY = ROOT.parent / "shared" / "survey"
SEEDS = 6  # of each kind
Z_P95_MM, ROLL_DEG, ERROR_MM = 3.0, 0.3, 0.08
NOTE = """
6 m each: texture of 0.04 mm, ovality, a bead, defects with bowls and pans for floors of which some grew by 0.25 mm or
more, are new or gone; noise 0.05 mm, cables a percent apart that slip, a head off centre that shakes and rolls. A wall
without texture has nothing between its defects to go by: informs. The shared pair, 24 m, was drawn by a program that is
not ours.
"""


@dataclass(frozen=True)
class Score:
    z_p95_mm: float
    roll_rms_deg: float
    found: int
    grown: int
    false: int
    errors_mm: tuple[float, ...]
    within_k2: int


def pairs() -> Any:
    """The module that draws pairs, which the tests have too."""
    spec = importlib.util.spec_from_file_location("archive_pairs", ROOT / "tests" / "unit" / "archive" / "pairs.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def score(found: Comparison, z: Any, roll: Any, defects: Sequence[dict[str, float]]) -> Score:
    """As the shared pair's scorer does."""
    place = found.alignment.z_mm
    ok = np.isfinite(place) & (z > 0)
    turned = (found.alignment.roll_deg - roll + 180) % 360 - 180
    true, used, errors, within = [one for one in defects if one["growth_mm"]], set[int](), [], 0
    for change in found.changed:
        for k, one in enumerate(true):
            off = abs((change.clock_deg - one["clock_deg"] + 180) % 360 - 180)
            near = abs(change.z_mm - one["z_mm"]) < one["length_mm"] / 2 + 10 and off < one["arc_deg"] / 2 + 6
            if k not in used and near:
                used.add(k)
                errors.append(change.growth_mm - one["growth_mm"])
                within += abs(errors[-1]) <= change.growth_k2_mm
                break
    p95 = float(np.percentile(np.abs((place - z)[ok]), 95))
    rms = float(np.sqrt(np.mean(turned[ok] ** 2)))
    return Score(p95, rms, len(used), len(true), len(found.changed) - len(used), tuple(errors), within)


def rows() -> list[Row]:
    drawn = pairs()
    plain = drawn.Scene(length_mm=6000, slips_mm=(18.0, -12.0), grown=4, unchanged=4, new=2, spots=150)
    kinds = (
        ("cables 0.3 % apart", plain, True),
        ("1 % short, from 0.7 m on, roll jumps, one repaired", replace(
            plain, scale=-0.01, zero_mm=700, jumps_deg=(3.0, -5.0), gone=1), True),
        ("1 % long, slips to 40 mm, gaps, one repaired", replace(
            plain, scale=0.01, gaps_mm=(150.0, 80.0), slips_mm=(40.0, -25.0, 8.0), gone=1), True),
        ("no roll sensor, turned by 140 deg, noise 0.07 mm", replace(plain, imu=False, roll_deg=140.0, noise_mm=0.07),
         True),
        ("no texture at all", replace(plain, texture_rms_mm=0.0, gone=1), False),
    )  # fmt: skip
    table = []
    for number, (what, scene, asked) in enumerate(kinds):
        scores, began = [], time.process_time()
        for k in range(SEEDS):
            pair = drawn.draw(100 * number + k, scene)
            defects = [vars(one) for one in pair.defects]
            scores.append(score(compare_maps(pair.first, pair.second), pair.z_of_second, pair.roll_of_second, defects))
        took = (time.process_time() - began) / SEEDS
        table += _told(f"{what}, {SEEDS} pairs", scores, asked, f"{took:.0f} s each")
    if (SURVEY / "truth.json").is_file():
        truth = json.loads((SURVEY / "truth.json").read_text())
        began = time.process_time()
        found = compare(*(Path(SURVEY / f"survey-a-{year}.npz") for year in (2024, 2025)))
        one = score(found, np.array(truth["true_z_of_second"]), np.array(truth["roll_of_second"]), truth["defects"])
        table += _told("shared pair", [one], True, f"{time.process_time() - began:.0f} s")
    return table


def _told(what: str, scores: Sequence[Score], asked: bool, took: str) -> list[Row]:
    errors = np.array([error for one in scores for error in one.errors_mm])
    p95, roll = max(one.z_p95_mm for one in scores), max(one.roll_rms_deg for one in scores)
    found, grown, false = (sum(getattr(one, name) for one in scores) for name in ("found", "grown", "false"))
    rms = float(np.sqrt(np.mean(errors**2))) if len(errors) else np.nan
    within = sum(one.within_k2 for one in scores)

    def met(good: bool) -> bool | None:
        return bool(good) if asked else None

    return [
        Row(f"{what}: place p95, worst pair", "-", f"<= {Z_P95_MM:g} mm", f"{p95:.2f} mm", met(p95 <= Z_P95_MM)),
        Row(f"{what}: roll rms, worst pair", "-", f"<= {ROLL_DEG:g} deg", f"{roll:.2f} deg", met(roll <= ROLL_DEG)),
        Row(
            f"{what}: grown found; made up", "-", "all; none", f"{found} of {grown}; {false} ({took})",
            met(found == grown and false == 0),
        ),
        Row(
            f"{what}: growth, rms; within its k = 2", "-", f"<= {ERROR_MM:g} mm; -",
            f"{rms:.3f} mm; {within} of {found}", met(rms <= ERROR_MM),
        ),
    ]  # fmt: skip
