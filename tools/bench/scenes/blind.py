"""The twin's own pipes of several pieces, drawn from a seed that nothing was chosen on: what a survey makes of them.

Scored by what the pictures were drawn from, with the bounds of `judge`. Of the cloud nothing is asked: the twin's walls
are no surface that points could be held against in space.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from annulus_pipe.twin.scan import world_named, write_scan
from tools.bench.scenes.judge import BOUNDS, CLOCK_DEG, PLACE_MM, POCKET_LENGTH_MM, Check, verdict

FRAMES = {"butt": 26, "coupling": 26, "branch": 26, "bend": 60, "water": 26}  # a frame every 5 mm; in a bend every 12
BESIDE_MM = 8.0  # of a true thing's ends: what is listed so near is that thing
BEND = {"radius_percent": 1.0, "angle_deg": 0.3, "start_mm": 1.5}
POCKET_MM = 0.2  # of one pocket's depth, or its own k = 2


def draw(world: str, seed: int, scan: Path) -> None:
    """A scan folder of one of `FRAMES`, with calibration and truth."""
    write_scan(world_named(world, seed, True, None), scan, FRAMES[world])


def blind_checks(scan: Path, out: Path) -> Iterator[Check]:
    """Of one scan and its results: everything true beside what was listed for it, then what was listed for nothing."""
    truth = json.loads((scan / "truth.json").read_text(encoding="utf-8"))
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    line = json.loads((out / "centreline.json").read_text(encoding="utf-8"))
    seen = line["line_mm"][0][0], line["line_mm"][-1][0]
    named = [one for one in truth["named"] if _overlap(one, *seen)]
    green, words = verdict((out / "report.html").read_text(encoding="utf-8"))
    anything = bool(named or truth["defects"] or summary.get("undecided"))
    yield Check("verdict", f"{'green: ' if green else ''}{words}", not (green and anything))
    for one in named:
        yield from _named(one, [d for d in summary["features"] if _overlap(one, *_span(d))])
    for one in (d for d in truth["defects"] if _overlap(d, *seen)):
        yield from _defect(one, [d for d in summary["defects"] if _overlap(one, *_span(d))])
    yield from _bends(truth["centreline"]["bends"], line["bends"])
    true = [*named, *truth["defects"]]
    for one in [*summary["features"], *summary["defects"]]:
        if one["kind"] != "bend" and not any(_overlap(t, *_span(one)) for t in true):
            yield Check("false", f"{one['kind']} at {one['z_mm']:.0f} mm", False)


def _named(one: Mapping[str, Any], listed: Sequence[Mapping[str, Any]]) -> Iterator[Check]:
    mine = [d for d in listed if d["kind"] == one["kind"]]
    what = f"{one['kind']} {one['z_mm']:.0f}"
    if not mine:
        other = ", ".join(d["kind"] for d in listed)
        yield Check(what, f"misnamed {other}" if other else "missed", False)
        return
    found = min(mine, key=lambda d: abs(d["z_mm"] - one["z_mm"]))
    yield Check(what, "found", True)
    for name, true in one.items():
        bound = BOUNDS.get(name, BOUNDS.get(f"{one['kind']} {name}"))
        if name == "hilo_clock_deg":
            off = (found.get(name, 180.0) - true + 180.0) % 360.0 - 180.0
            yield Check(name, f"{found.get(name)} of {true:.0f}", abs(off) <= CLOCK_DEG)
        elif bound is not None:
            value = found.get(name)
            told = "not measured" if value is None else f"{value:g}"
            limit = 2 * bound if name == "angle_deg" else bound  # pictures of half size
            yield Check(name, f"{told} of {true:.2f}", value is not None and abs(value - true) <= limit)
    if "inner_d_mm" in one:
        yield Check("place", f"{found['z_mm'] - one['z_mm']:+.1f} mm", abs(found["z_mm"] - one["z_mm"]) <= PLACE_MM)


def _defect(one: Mapping[str, Any], listed: Sequence[Mapping[str, Any]]) -> Iterator[Check]:
    mine = [d for d in listed if d["kind"] == one["kind"]]
    what = f"{one['kind']} {one['z_mm']:.0f}"
    if not mine:
        yield Check(what, "missed", False)
        return
    found = min(mine, key=lambda d: abs(d["z_mm"] - one["z_mm"]))
    off, k2 = found["depth_mm"] - one["depth_mm"], found.get("depth_k2_mm") or 0.0
    yield Check(what, f"{found['depth_mm']:.2f} of {one['depth_mm']:.2f} mm", abs(off) <= max(POCKET_MM, k2))
    off = found["length_mm"] - one["length_mm"]
    yield Check("length", f"{found['length_mm']:.1f} of {one['length_mm']:.1f} mm", abs(off) <= POCKET_LENGTH_MM)


def _bends(true: Sequence[Mapping[str, Any]], found: Sequence[Mapping[str, Any]]) -> Iterator[Check]:
    if len(true) != len(found):
        yield Check("bends", f"{len(found)} of {len(true)}", False)
        return
    for one, other in zip(true, found, strict=True):
        off = {
            "radius_percent": 100.0 * (other["radius_mm"] / one["radius_mm"] - 1.0),
            "angle_deg": other["angle_deg"] - one["angle_deg"],
            "start_mm": other["start_mm"] - one["start_mm"],
        }
        for name, value in off.items():
            yield Check(f"bend {name}", f"{value:+.3f}", abs(value) <= BEND[name])


def _span(one: Mapping[str, Any]) -> tuple[float, float]:
    half = 0.5 * float(one["length_mm"])
    return one["z_mm"] - half, one["z_mm"] + half


def _overlap(one: Mapping[str, Any], low: float, high: float) -> bool:
    first, last = _span(one)
    return first - BESIDE_MM <= high and low <= last + BESIDE_MM
