"""What is asked of a scene's score, and how far it was kept."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

GROSS_PERCENT = 0.05  # of the points, off by more than 2 mm
K2 = (0.93, 0.97)  # part of the points that lie within twice their sigma, every slice of the pipe about its own axis
IN_GAP = 200  # points claimed between two pipe ends, where nothing is
POCKET_BIAS_MM, POCKET_LENGTH_MM, GROOVE_MM = 0.05, 5.0, 0.1
CLOCK_DEG = 10.0  # of the hi-lo
PLACE_MM = 3.0  # of an opening, along the pipe and round it
BOUNDS = {  # of what a feature measures; after its kind where kinds differ
    "height_mm": 0.5,
    "width_mm": 2.0,
    "hilo_mm": 0.2,
    "angle_deg": 0.15,
    "gap_mm": 2.5,
    "step_mm": 0.15,
    "inner_d_mm": 3.0,
    "water level_mm": 1.0,
    "deposit level_mm": 0.3,
    "taper radius_after_mm": 0.15,
}
SMALL_PX = 832  # pictures so wide have pixels twice as large: angles may be off twice as much
TARGETS = (
    f"gross <= {GROSS_PERCENT} %, k2 {K2[0]:.2f} to {K2[1]:.2f} (centred), points in a gap < {IN_GAP}, nothing "
    "misnamed, missed or false, no green verdict beside a feature or anything undecided\n"
    f"bead height 0.5 mm, width 2 mm, hi-lo 0.2 mm and {CLOCK_DEG:.0f} deg, angle 0.15 deg (0.3 in pictures of "
    f"{SMALL_PX} px), gap 2.5 mm, step 0.15 mm, opening's place {PLACE_MM:.0f} mm and diameter 3 mm, level 1 mm (silt "
    f"0.3), taper's radius 0.15 mm, groove {GROOVE_MM} mm,\npocket's length {POCKET_LENGTH_MM:.0f} mm and, over all "
    f"scenes, mean depth {POCKET_BIAS_MM} mm"
)


@dataclass(frozen=True, slots=True)
class Check:
    """One number beside its truth. `ok` is None where nothing is asked of it."""

    what: str
    text: str
    ok: bool | None


def scene_checks(score: Mapping[str, Any], page: str, undecided: int) -> Iterator[Check]:
    """Of a scene as a whole; `page` is report.html, `undecided` how many places it could not decide."""
    counts = score["misnamed"], score["missed"], len(score["false"])
    yield Check("list", f"{score['found']}/{'/'.join(map(str, counts))}", not any(counts))
    yield Check("gross", f"{score['gross_percent']:.2f} %", score["gross_percent"] <= GROSS_PERCENT)
    yield Check("k2", f"{score['k2']:.3f} ({score['k2_centred']:.3f})", K2[0] <= score["k2_centred"] <= K2[1])
    if any(one["name"] == "gap" for one in score["features"]):
        yield Check("points in the gap", str(score["points_in_openings"]), score["points_in_openings"] < IN_GAP)
    green, words = verdict(page)
    yield Check("verdict", f"{'green: ' if green else ''}{words}", not (green and (score["features"] or undecided)))


def verdict(page: str) -> tuple[bool, str]:
    """Whether the report's first sentence is on green, and what it says."""
    found = re.search(r'<div class="verdict ([^"]*)">(.*?)<small>', page, re.S)
    return ("sound" in found[1], " ".join(found[2].split())) if found else (True, "no verdict")


def feature_checks(
    one: Mapping[str, Any], truth: Mapping[str, Any], listed: Sequence[Mapping[str, Any]]
) -> Iterator[Check]:
    """Of one true feature or defect; `listed` are the survey's own features, for what the score does not ask."""
    yield Check("", one["state"] + (" as " + "; ".join(one["listed"]) if one["state"] == "misnamed" else ""), None)
    if "depth" in one and one["name"] in ("pocket", "groove", "bump"):
        off = one["depth"] - one["depth_true"]
        least = one["floor_seen"] is False
        asked = None if one["name"] != "groove" else abs(off) <= GROOVE_MM or (least and off < 0)
        yield Check("depth", f"{'at least ' if least else ''}{one['depth']:.2f} of {one['depth_true']:.2f} mm", asked)
        if one["within_k2"] is False:
            yield Check("k2 of the depth", "does not hold", None)
    if "length" in one and one["name"] in ("pocket", "bump"):
        off = one["length"] - one["length_true"]
        text = f"{one['length']:.1f} of {one['length_true']:.1f} mm, place off by {one['z_error']:+.1f}"
        yield Check("length", text, abs(off) <= POCKET_LENGTH_MM if one["name"] == "pocket" else None)
    small = truth["scene"]["camera"]["width"] <= SMALL_PX
    for name, true in one.get("measures_true", {}).items() if one["state"] == "found" else ():
        measured = [d[name] for d in one["measured"] if d.get(name) is not None]
        bound = BOUNDS.get(name, BOUNDS.get(f"{one['name']} {name}"))
        if bound and name == "angle_deg" and small:
            bound *= 2
        if not measured:
            yield Check(name, f"not measured, is {true}", None if bound is None else False)
            continue
        value = min(measured, key=lambda v: abs(v - true))
        yield Check(name, f"{value:g} of {true:g}", None if bound is None else abs(value - true) <= bound)
    yield from _places(one, truth["scene"]["pipe"], listed)


def _places(one: Mapping[str, Any], pipe: Mapping[str, Any], listed: Sequence[Mapping[str, Any]]) -> Iterator[Check]:
    """An opening's place, and the clock position of a hi-lo."""
    z, clock = sum(one["z"]) / 2, one["clock_deg"]
    near = min(listed, key=lambda d: abs(d["z_mm"] - z), default=None)
    if one["state"] != "found" or near is None:
        return
    if one["name"] in ("branch", "tee"):
        along, round_mm = near["z_mm"] - z, math.radians(_turn(near["clock_deg"] - clock)) * pipe["radius"]
        text = f"off by {along:+.1f} mm along, {round_mm:+.1f} mm round"
        yield Check("place", text, math.hypot(along, round_mm) <= PLACE_MM)
    kind = {"joint": "joint", "gap": "coupling"}.get(one["name"], "")
    shift = pipe.get("features", {}).get(kind, {}).get("hilo_mm")
    if shift and math.hypot(*shift) and near.get("hilo_clock_deg") is not None:
        true = math.degrees(math.atan2(shift[0], -shift[1])) % 360
        off = _turn(near["hilo_clock_deg"] - true)
        yield Check("hilo_clock_deg", f"{near['hilo_clock_deg']:.0f} of {true:.0f}", abs(off) <= CLOCK_DEG)


def pocket_bias(scores: Sequence[Mapping[str, Any]]) -> Check:
    """Mean error of the depths of all pockets whose floor was seen."""
    off = [
        one["depth"] - one["depth_true"]
        for score in scores
        for one in score["features"]
        if one["name"] == "pocket" and "depth" in one and one["floor_seen"] is not False
    ]
    if not off:
        return Check("pockets", "none found", None)
    mean = sum(off) / len(off)
    return Check(
        f"mean depth of {len(off)} pockets", f"{mean:+.3f} mm", abs(mean) <= POCKET_BIAS_MM if len(off) > 2 else None
    )


def _turn(degrees: float) -> float:
    return (degrees + 180.0) % 360.0 - 180.0
