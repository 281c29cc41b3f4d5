"""One self-contained page of a joint: what was measured, what it can and cannot say."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jinja2

from annulus_pipe.numeric.rounding import ANGLE, MEASURE, PERCENT, quoted, span
from annulus_pipe.report.sheet import minute, sheet
from annulus_pipe.report.summary import versions
from annulus_pipe.untrusted import mapping, parse_json
from annulus_pipe.vocabulary import AnnulusError

BYTES_MAX = 1 << 26
ALWAYS = ("density.png", "beads.png", "features.png")
WITH_SCAN, WITH_STRENGTHS, WITH_LIGHT = "scan.png", "correlate.png", "transmission.png"
SEEN = {"void": "void", "grain": "inclusion", "gap": "gap"}


def write_joint_page(folder: Path) -> Path:
    """report.html in a folder of `annulus joint image`, with what `register` and `correlate` added; its path.

    AnnulusError naming the file that is missing or makes no sense.
    """
    source = folder / "features.json"
    features = _json(source)
    pictures = {name: _bytes(folder / name) for name in ALWAYS}
    scan, relations = features.get("microwave"), {}
    correlated: dict[str, Any] = {}
    if scan is not None and (folder / WITH_SCAN).exists():
        pictures[WITH_SCAN] = _bytes(folder / WITH_SCAN)
    if (folder / "correlate.json").exists():
        correlated = _json(folder / "correlate.json")
        pictures[WITH_STRENGTHS] = _bytes(folder / WITH_STRENGTHS)
        relations = correlated.get("features", {})
    light: dict[str, Any] = {}
    if (folder / "transmission.json").exists():
        light = _json(folder / "transmission.json")
        pictures[WITH_LIGHT] = _bytes(folder / WITH_LIGHT)
    name = folder.resolve().name
    try:
        flaws = [{**one, "kind": SEEN[one["kind"]]} for one in features["found"]]
        page = sheet(
            "annulus_pipe.wings.joints/joint.html.j2",
            pictures,
            source=name,
            running=f"Butt-fusion joint: {name}",
            s=features["summary"],
            created=minute(datetime.now(UTC).isoformat()),
            version=versions()["annulus"],
            versions=versions(),
            flaws=flaws,
            scan=scan,
            relations=relations,
            light=light,
            n=correlated.get("n"),
            said=_sentences(features["summary"], flaws, scan, relations),
        )
    except (KeyError, TypeError, ValueError, IndexError, jinja2.UndefinedError) as error:
        raise AnnulusError(f"{source}: {error}: expected what `annulus joint image` writes") from None
    out = folder / "report.html"
    try:
        out.write_text(page, encoding="utf-8")
    except OSError as error:
        raise AnnulusError(f"{out}: cannot be written ({error.strerror})") from None
    return out


def _sentences(
    summary: dict[str, Any], flaws: list[dict[str, Any]], scan: dict[str, Any] | None, relations: dict[str, Any]
) -> list[str]:
    kinds = [one["kind"] for one in flaws]
    counted = ", ".join(
        f"{kinds.count(kind)} {kind}{'s' if kinds.count(kind) > 1 else ''}" for kind in dict.fromkeys(kinds)
    )
    out = [f"Flaws in the wall: {counted}." if flaws else "No flaw in the wall stands out."]
    hilo = summary["hilo_mm"]
    step, k2 = abs(hilo["greatest_outside"]), 2 * hilo["sigma"]
    out.append(
        f"The ends are offset by {quoted(step, MEASURE)} at most."
        if step > k2
        else f"No offset of the ends beyond {quoted(max(step, k2), MEASURE)}."
    )
    zone = summary["zone_density_percent"]
    if zone["median"] is None:
        out.append("No heat-affected zone stands out of the wall's density.")
    else:
        out.append(
            f"The heat-affected zone has {quoted(zone['median'], PERCENT)} of the plain wall's density, "
            f"{span(zone['least'], zone['greatest'], PERCENT)} round the joint."
        )
    if scan is not None and not scan["accepted"]:
        out.append(f"The near-field scan could not be laid on this joint: {scan['why_not']}.")
    elif scan is not None:
        out.append(
            f"The near-field scan lies {quoted(scan['shift_deg'], ANGLE, 2 * scan['shift_sigma_deg'])} (k = 2) from "
            f"the CT's zero, sense {scan['sense']}."
        )
    out += [
        f"{name} and the strengths: {one['verdict']} (r {one['r']:+.2f}, p over the search {one['p']:.3f})."
        for name, one in relations.items()
    ]
    return out


def _json(path: Path) -> dict[str, Any]:
    try:
        return dict(mapping(parse_json(_bytes(path), BYTES_MAX), path.name))
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}") from None


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > BYTES_MAX:
            raise AnnulusError(f"{path}: {path.stat().st_size} bytes, expected {BYTES_MAX} at most")
        return path.read_bytes()
    except OSError as error:
        raise AnnulusError(f"{path}: {error.strerror}, expected a folder of `annulus joint image`") from None
