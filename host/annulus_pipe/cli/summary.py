"""What `annulus reconstruct` prints of a survey for people: summary.json, a line a thing."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from annulus_pipe.numeric.rounding import ANGLE, ARC, DISTANCE, EXTENT, MEASURE, PERCENT, digits, quoted, span

HOLES_PRINTED = 10  # the largest; the report has all


def print_summary(data: Mapping[str, Any], out: Path) -> None:
    def where(one: Mapping[str, Any]) -> str:
        return f"at {quoted(one['z_mm'], DISTANCE)}, clock {one['clock']}"

    diameter = data["diameter_mm"]
    counts = ", ".join(f"{n} {label}" for label, n in data["frames"].items())
    print(f"frames     {counts}")
    if diameter["mean"] is not None:
        between = span(diameter["min"], diameter["max"], MEASURE)
        print(f"diameter   {quoted(diameter['mean'], MEASURE, diameter.get('k2'))} mean (k=2), {between}")
    if data.get("scale"):
        print(f"scale      {data['scale']['anchor']}")
    print(f"points     {data['points']}")
    if "views" in data:
        views = data["views"]
        alone, both = (quoted(views[name], PERCENT) for name in ("not_seen_forward_percent", "not_seen_percent"))
        turned = quoted(views["turned_deg"], ANGLE, views["turned_k2_deg"])
        print(
            f"views      not seen {both}, by the forward one alone {alone}; turned {turned} by the {views['placed_by']}"
        )
    for d in data["defects"]:
        depth = quoted(d["depth_mm"], MEASURE, d.get("depth_k2_mm"), at_least=not d.get("floor_seen", True))
        hidden = f", {quoted(d['hidden_mm'], EXTENT)} of it hidden" if d["hidden_mm"] >= 0.5 else ""
        size = f"{quoted(d['length_mm'], EXTENT)} long, {quoted(d['arc_deg'], ARC)}"
        print(f"{d['kind']:<10} {depth} {where(d)}, {size}{hidden}")
    if not data["defects"]:
        print("defects    none" + (" that is sure" if data["undecided"] else ""))
    for f in data["features"]:
        at = f"at {quoted(f['z_mm'], DISTANCE)}, all round"
        if f["arc_deg"] < 360:
            at = f"{where(f)}, {quoted(f['arc_deg'], ARC)}"
        print(f"{f['kind']:<10} {at}" + (f": {f['remark']}" if f["remark"] else ""))
    if "conformity" in data:
        print(f"verdict    {data['conformity']['decision']}: {data['conformity']['title'] or 'the limits named'}")
        for remark in data["conformity"]["remarks"]:
            print(f"           {remark}")
        places = data["conformity"].get("not_established", [])
        if usual := sum(place["usual"] for place in places):
            print(f"           not seen as in every scan (strips, ends, joints' zones), see the report: {usual} places")
        for place in (place for place in places if not place["usual"]):
            clock = "all round" if place["arc_deg"] >= 360 else f"clock {' to '.join(place['clock_from_to'])}"
            where_to = f"{span(place['z_from_mm'], place['z_to_mm'], DISTANCE)}, {clock}"
            print(f"           not established: {', '.join(place['limits'])} {where_to}: {place['reason']}")
    for d in data["undecided"]:
        print(f"undecided  {quoted(d['depth_mm'], MEASURE, d['depth_k2_mm'])} {where(d)}: {d['why']}")
    # with limits they stand among what is not established
    holes = [] if "conformity" in data else [hole for hole in data["not_seen"] if not hole["usual"]]
    holes.sort(key=lambda one: -one["arc_deg"] * (one["z_to_mm"] - one["z_from_mm"]))
    for hole in holes[:HOLES_PRINTED]:
        clock = "all round" if hole["arc_deg"] >= 360 else f"clock {' to '.join(hole['clock_from_to'])}"
        print(f"not seen   {span(hole['z_from_mm'], hole['z_to_mm'], DISTANCE)}, {clock}: {hole['reason']}")
    if len(holes) > HOLES_PRINTED:
        print(f"not seen   {len(holes) - HOLES_PRINTED} smaller places, see the report")
    if "vibration" in data:
        for line in data["vibration"]["lines"]:
            hertz = "" if line["hertz"] is None else f" ({digits(line['hertz'], MEASURE)} Hz)"
            cycles = f"{digits(line['cycles_per_m'], MEASURE)} cycles/m{hertz}"
            print(f"vibration  {cycles}, {quoted(line['amplitude_mm'], MEASURE)}, taken out")
        if not data["vibration"]["lines"]:
            print(f"vibration  {data['vibration']['note'] or 'none found'}")
    for warning in data["warnings"]:
        print(f"warning    {warning['text']}")
    print(f"report     {out / 'report.html'}")
