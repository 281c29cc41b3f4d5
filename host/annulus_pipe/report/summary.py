"""summary.json: what one scan says, in numbers and plain types."""

import importlib.metadata
import math
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from annulus_pipe.hooks import Sheet
from annulus_pipe.job import Observation, Origin
from annulus_pipe.numeric.rounding import clock_face, stored, stored_k2
from annulus_pipe.report.account import ScanAccount
from annulus_pipe.report.names import marked
from annulus_pipe.wall.conformity import RULE, Group, Verdict
from annulus_pipe.wall.defects import Defect
from annulus_pipe.wall.features import Feature
from annulus_pipe.wall.scale import anchor
from annulus_pipe.wall.standing import FEW
from annulus_pipe.wall.stations import OVALITY_FORMULA, OVALITY_NAME
from annulus_pipe.wall.survey import Survey, Views
from annulus_pipe.wall.unjudged import Unjudged
from annulus_pipe.wall.vibration import Vibration


def summarize(survey: Survey, account: ScanAccount, files_ms: float, beside: Sequence[Sheet] = ()) -> dict[str, Any]:
    """The figures of one scan as in summary.json: mm, degrees, None where nothing could be measured. files_ms: what the
    other files took."""
    start, end = survey.scanned_mm
    wall_ms = sum(survey.timing_ms.values())
    timing = {**account.timing_ms, "results_wall": wall_ms, "results_total": wall_ms + files_ms}
    roll = survey.roll_range_deg or (None, None)
    out = {
        "format": "annulus-summary/1",
        "source": account.source,
        "job": account.origin.job.to_dict(),
        "origin": _origin(account.origin),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "frames": dict(account.frames),
        "points": survey.points,
        "scanned_mm": {"from": stored(start), "to": stored(end), "length": stored(end - start)},
        "stations": len(survey.stations.z_mm),
        "seen_percent": stored(100.0 * survey.seen_fraction),
        "hidden_percent": stored(100.0 * survey.shadowed_fraction),
        "noise_mm": stored(survey.noise_mm),
        "diameter_mm": {
            "mean": stored(survey.diameter_mean_mm),
            "min": stored(survey.diameter_min_mm),
            "max": stored(survey.diameter_max_mm),
            "nominal": survey.nominal_diameter_mm,
            "k2": stored_k2(survey.diameter_k2_mm),
        },
        "scale": _scale(survey),
        "ovality": {
            "definition": OVALITY_NAME,
            "formula": OVALITY_FORMULA,
            "max_percent": stored(survey.ovality_max_percent),
            "shape_max_percent": stored(survey.shape_ovality_max_percent),
            "shape_median_percent": stored(survey.shape_ovality_median_percent),
        },
        "defects": [
            _defect(defect) | _severity(account.verdict, "defect", i) for i, defect in enumerate(survey.defects)
        ],
        "features": [
            _feature(feature) | _severity(account.verdict, "feature", i) for i, feature in enumerate(survey.features)
        ],
        "undecided": [
            _defect(place) | {"why": place.why} | _severity(account.verdict, "undecided", i)
            for i, place in enumerate(survey.detection.undecided)
        ],
        "not_seen": [_hole(place) for place in survey.unjudged if place.is_hole],
        "observations": [_observation(i, one) for i, one in enumerate(account.origin.observations)],
        "marks_left_out": account.origin.marks_left_out,
        "unsupported": sum(place.why == FEW for place in survey.detection.undecided),
        "limits": {
            "depth_mm": stored(survey.depth_limit_mm),
            "size_mm": stored(survey.size_limit_mm),
            "ovality_percent": survey.detection.limits.ovality_percent,
        },
        "qualification": account.stated.to_dict(),
        "drops": dict(account.drops),
        "rejected": dict(survey.rejected),
        "timing_ms": {name: stored(value) for name, value in timing.items()},
        "versions": versions(),
        "head_deg": {
            "lean_sigma": stored(survey.lean_sigma_deg),
            "roll_min": None if roll[0] is None else stored(roll[0]),
            "roll_max": None if roll[1] is None else stored(roll[1]),
        },
        "warnings": [
            {"kind": str(w.kind), "text": w.text, "frames": list(w.frames)}
            for w in (*account.findings, *survey.findings)
        ],
    }
    if len(survey.cameras) > 1:
        out["seen_by_percent"] = {
            "several" if one is None else str(one): stored(100.0 * part)
            for one, part in survey.seen_by_fraction().items()
        }
    if survey.views is not None:
        out["views"] = _views(survey.views)
    for one in beside:
        out |= one.summary
    if survey.vibration is not None:
        out["vibration"] = _vibration(survey.vibration)
    if account.verdict is not None:
        out["conformity"] = _conformity(account.verdict)
    if account.truth is not None:
        out["truth"] = dict(account.truth)
    plain: dict[str, Any] = finite(out)
    return plain


def _scale(survey: Survey) -> dict[str, Any] | None:
    """What anchors diameters; percent of the radius, k = 2 of what all of them have in common."""
    scale = survey.scale
    if scale is None:
        return None
    grown = {"ring_size": scale.of("focal", "slide"), "anamorphic": scale.of("anamorphic")}
    return {
        "anchor": anchor(scale, survey.diameter_mean_mm),
        "common_k2_percent": stored_k2(200.0 * scale.part),
        "oval_k2_percent": stored_k2(200.0 * scale.oval_part),
        "drifted": {
            name: {"percent": stored(100.0 * value), "k2": stored_k2(200.0 * sigma)}
            for name, (value, sigma) in grown.items()
        },
        "references": [
            {
                "z_from_mm": stored(one.from_mm),
                "z_to_mm": stored(one.to_mm),
                "diameter_mm": one.diameter_mm,
                "k2": one.diameter_k2_mm,
                "as_calibrated_mm": stored(mm),
                "used": used,
            }
            for used, sections in ((True, scale.references), (False, scale.refused))
            for one, mm, *_ in sections
        ],
    }


def _origin(origin: Origin) -> dict[str, Any]:
    begun, ended = origin.utc
    return {
        "begun_utc": begun or None,
        "ended_utc": ended or None,
        "controller": dict(origin.controller),
        "calibration": {
            "file": origin.calibration_file or None,
            "fingerprint": origin.calibration_fingerprint or None,
            **{k: dict(v) for k, v in origin.calibration.items()},
        },
        "recorded_with": dict(origin.versions),
    }


def _severity(verdict: Verdict | None, group: Group, index: int) -> dict[str, Any]:
    """Severity and decision of one thing. Empty where no limit was named for its kind: an entry could be read as a
    pass."""
    one = None if verdict is None else verdict.worst_of(group, index)
    return {} if one is None else {"severity": one.severity, "decision": str(one.decision)}


def _conformity(verdict: Verdict) -> dict[str, Any]:
    return {
        "title": verdict.criteria.title,
        "accept_severity": verdict.criteria.accepted,
        "rule": RULE,
        "decision": str(verdict.decision),
        "remarks": list(verdict.remarks),
        "not_established": [
            {
                "limits": list(one.kinds),
                "z_from_mm": stored(one.z_from_mm),
                "z_to_mm": stored(one.z_to_mm),
                "clock_deg": stored(one.clock_deg),
                "arc_deg": stored(one.arc_deg),
                "clock_from_to": list(one.clock_range),
                "reason": one.reason,
                "usual": one.usual,
            }
            for one in verdict.not_established
        ],
        "items": [
            {
                "of": one.group,
                "index": one.index,
                "kind": one.kind,
                "quantity": one.quantity,
                "value": stored(one.value),
                "k2": stored_k2(one.k2),
                "at_least": one.at_least,
                "limit": one.limit,
                "z_mm": stored(one.z_mm),
                "severity": one.severity,
                "severities": list(one.severities),
                "decision": str(one.decision),
            }
            for one in verdict.items
        ],
    }


def _hole(place: Unjudged) -> dict[str, Any]:
    """usual: every scan has such, a rod's strip or an end. more: it stands for so many that are too many to list."""
    return {
        "z_from_mm": stored(place.z_from_mm),
        "z_to_mm": stored(place.z_to_mm),
        "clock_deg": stored(place.clock_deg),
        "arc_deg": stored(place.arc_deg),
        "clock_from_to": list(place.clock_range),
        "reason": place.reason,
        "usual": place.usual,
        **({"more": place.more} if place.more else {}),
    }


def _views(views: Views) -> dict[str, Any]:
    return {
        "moved_mm": stored(views.moved_mm),
        "moved_k2_mm": stored_k2(2 * views.moved_sigma_mm),
        "turned_deg": stored(views.turned_deg),
        "turned_k2_deg": stored_k2(2 * views.turned_sigma_deg),
        "placed_by": "wall" if views.matched else "mounting",
        "not_seen_forward_percent": stored(100.0 * views.not_seen_alone),
        "not_seen_percent": stored(100.0 * views.not_seen),
        "differ_sigma": stored(views.differ_sigma),
        "disagree_percent": stored(100.0 * views.disagree_fraction),
        "diameter_differs_mm": stored(views.size_mm),
        "diameter_differs_k2_mm": stored_k2(views.size_k2_mm),
    }


def _vibration(found: Vibration) -> dict[str, Any]:
    return {
        "lines": [
            {
                "cycles_per_m": one.cycles_per_m,
                "hertz": one.hertz,
                "amplitude_mm": one.amplitude_mm,
                "by_mode_mm": dict(one.mm),
            }
            for one in found.lines
        ],
        "rms_mm": {"before": found.rms_mm[0], "after": found.rms_mm[1]},
        "note": found.why,
    }


def versions() -> dict[str, str]:
    out = {"python": platform.python_version()}
    for distribution in ("annulus-pipe", "numpy", "scipy", "opencv-python-headless"):
        name = distribution.removesuffix("-pipe")
        try:
            out[name] = importlib.metadata.version(distribution)
        except importlib.metadata.PackageNotFoundError:
            out[name] = "unknown"
    return out


def _defect(defect: Defect) -> dict[str, Any]:
    first, last = defect.z_range_mm
    return {
        "kind": str(defect.kind),
        "z_mm": stored(defect.z_mm),
        "clock_deg": stored(defect.clock_deg),
        "clock": defect.clock,
        "length_mm": stored(defect.length_mm),
        "arc_deg": stored(defect.arc_deg),
        "depth_mm": stored(defect.depth_mm),
        "depth_k2_mm": stored_k2(defect.depth_k2_mm),
        "area_mm2": stored(defect.area_mm2),
        "all_round": defect.is_all_round,
        "floor_seen": defect.floor_seen,
        "hidden_mm": stored(defect.shadowed_mm),
        "z_from_mm": stored(first),
        "z_to_mm": stored(last),
        "clock_from_to": list(defect.clock_range),
    }


def _feature(feature: Feature) -> dict[str, Any]:
    """What was measured stands under its own name, its uncertainty beside it: height_mm, height_k2_mm."""
    first, last = feature.z_range_mm
    out: dict[str, Any] = {
        "kind": str(feature.kind),
        "z_mm": stored(feature.z_mm),
        "clock_deg": stored(feature.clock_deg),
        "clock": feature.clock,
        "length_mm": stored(feature.length_mm),
        "arc_deg": stored(feature.arc_deg),
        "z_from_mm": stored(first),
        "z_to_mm": stored(last),
        "remark": feature.remark,
    }
    for one in feature.measures:
        out[one.name] = stored(one.value)
        out[one.k2_name] = stored_k2(one.k2)
    return out


def _observation(index: int, one: Observation) -> dict[str, Any]:
    """z_mm: of the head at that moment. picture: whose the report shows."""
    return {
        "mark": marked(index),
        "z_mm": stored(one.z_mm),
        "clock_deg": None if one.clock_deg is None else stored(one.clock_deg),
        "clock": None if one.clock_deg is None else clock_face(one.clock_deg),
        "text": one.text,
        "utc": one.utc or None,
        "picture": one.shows or None,
        "frame": one.frame,
        "camera": one.camera,
    }


def finite(value: Any) -> Any:
    """The same with None for what JSON has no number for."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, np.generic):
        return finite(value.item())
    return value
