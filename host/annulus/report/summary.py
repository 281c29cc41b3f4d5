"""summary.json as a value: what one scan says, in numbers."""

import importlib.metadata
import math
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus.numeric.arrays import BoolArray
from annulus.rings.diagnosis import Finding
from annulus.wall.defects import Defect, Detection
from annulus.wall.grid import Wall
from annulus.wall.profile import Profile
from annulus.wall.stations import OVALITY_FORMULA, OVALITY_NAME, Stations
from annulus.wall.vibration import Vibration


@dataclass(frozen=True, slots=True)
class Summary:
    """What summary.json says. Lengths in mm, angles in degrees, None where nothing could be measured."""

    source: str
    created: str
    frames: Mapping[str, int]
    points: int
    scanned_mm: Mapping[str, float]
    seen_percent: float
    hidden_percent: float  # of the wall: behind steps, so that no ring's light got there; part of what was not seen
    noise_mm: float
    diameter_mm: Mapping[str, float | None]
    ovality: Mapping[str, Any]
    defects: tuple[Defect, ...]
    unsupported: int  # places that look like a defect, but to one ring in one frame only: not listed
    limits: Mapping[str, float]
    drops: Mapping[str, int]
    rejected: Mapping[str, int]
    timing_ms: Mapping[str, float]
    versions: Mapping[str, str]
    truth: Mapping[str, Any] | None
    warnings: tuple[Finding, ...] = ()
    vibration: Vibration | None = None  # None: not looked for
    head_deg: Mapping[str, float | None] = field(default_factory=dict)  # lean_sigma; roll_min, roll_max or None

    def to_dict(self) -> dict[str, Any]:
        """As in summary.json: plain types, None where there is no number."""
        out = {
            "format": "annulus-summary/1", "source": self.source, "created": self.created, "frames": dict(self.frames),
            "points": self.points, "scanned_mm": dict(self.scanned_mm), "seen_percent": round(self.seen_percent, 2),
            "hidden_percent": round(self.hidden_percent, 3),
            "noise_mm": round(self.noise_mm, 4), "diameter_mm": dict(self.diameter_mm), "ovality": dict(self.ovality),
            "defects": [_defect(defect) for defect in self.defects], "unsupported": self.unsupported,
            "limits": dict(self.limits), "drops": dict(self.drops), "rejected": dict(self.rejected),
            "timing_ms": {name: round(value, 3) for name, value in self.timing_ms.items()},
            "versions": dict(self.versions), "head_deg": dict(self.head_deg),
            "warnings": [{"kind": str(w.trouble), "text": w.text, "frames": list(w.frames)} for w in self.warnings],
        }  # fmt: skip
        if self.vibration is not None:
            out["vibration"] = {
                "lines": [
                    {"cycles_per_m": one.cycles_per_m, "hertz": one.hertz, "amplitude_mm": one.amplitude_mm,
                     "by_mode_mm": dict(one.mm)}
                    for one in self.vibration.lines
                ],
                "rms_mm": {"before": self.vibration.rms_mm[0], "after": self.vibration.rms_mm[1]},
                "note": self.vibration.why,
            }  # fmt: skip
        if self.truth is not None:
            out["truth"] = dict(self.truth)
        plain: dict[str, Any] = _finite(out)
        return plain


def summarize(
    wall: Wall, dark: BoolArray, findings: Detection, stations: Stations, nominal_mm: float, profiles: Sequence[Profile],
    points: int, frames: Mapping[str, int], drops: Mapping[str, int], timing: Mapping[str, float], source: str,
    truth: Mapping[str, Any] | None, warnings: tuple[Finding, ...] = (), vibration: Vibration | None = None,
) -> Summary:  # fmt: skip
    """Draw the figures of one scan together; arguments as in `results.write_results`, nominal_mm a diameter."""
    start, end = float(wall.z_mm[0] - wall.z_step_mm / 2), float(wall.z_mm[-1] + wall.z_step_mm / 2)
    rejected: Counter[str] = Counter()
    for profile in profiles:
        rejected.update(profile.rejected)
    radius = wall.mean_radius_mm
    limits = findings.limits
    noise = float(np.median(wall.noise_mm))
    return Summary(
        source=source,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        frames=frames,
        points=points,
        scanned_mm={"from": round(start, 1), "to": round(end, 1), "length": round(end - start, 1)},
        seen_percent=100.0 * float(wall.seen.mean()),
        hidden_percent=100.0 * float(dark.mean()),
        noise_mm=noise,
        diameter_mm={
            "mean": _extreme(np.mean, stations.diameter_mean_mm),
            "min": _extreme(np.min, stations.diameter_min_mm),
            "max": _extreme(np.max, stations.diameter_max_mm),
            "nominal": nominal_mm,
            "k2": _extreme(np.median, stations.diameter_k2_mm),
        },
        ovality={
            "definition": OVALITY_NAME,
            "formula": OVALITY_FORMULA,
            "max_percent": _extreme(np.max, stations.ovality_percent),
            "shape_max_percent": _extreme(np.max, stations.shape_ovality_percent),
            "shape_median_percent": _extreme(np.median, stations.shape_ovality_percent),
        },
        defects=findings.defects,
        unsupported=findings.unconfirmed,
        limits={
            "depth_mm": round(max(limits.seed_noise * noise, limits.seed_of_radius * radius), 3),
            "size_mm": round(limits.size_of_radius * radius, 2),
            "ovality_percent": limits.ovality_percent,
        },
        drops=drops,
        rejected=dict(sorted(rejected.items())),
        timing_ms=timing,
        versions=_versions(),
        truth=truth,
        warnings=warnings,
        vibration=vibration,
        head_deg=_head(profiles),
    )


def _head(profiles: Sequence[Profile]) -> dict[str, float | None]:
    """How well the head's lean was known (median sigma), and its roll where a sensor gave it."""
    lean = np.array([profile.lean_sigma_deg for profile in profiles], dtype=np.float64)
    roll = [profile.pose.roll for profile in profiles if profile.pose is not None and profile.pose.roll is not None]
    return {
        "lean_sigma": _extreme(np.median, lean),
        "roll_min": round(math.degrees(min(roll)), 2) if roll else None,
        "roll_max": round(math.degrees(max(roll)), 2) if roll else None,
    }


def _versions() -> dict[str, str]:
    out = {"python": platform.python_version()}
    for name in ("annulus", "numpy", "scipy", "opencv-python-headless"):
        try:
            out[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            out[name] = "unknown"
    return out


def _extreme(of: Any, values: NDArray[np.float64]) -> float | None:
    known = values[np.isfinite(values)]
    return round(float(of(known)), 4) if len(known) else None


def _defect(defect: Defect) -> dict[str, Any]:
    first, last = defect.z_range_mm
    return {
        "kind": str(defect.kind), "z_mm": round(defect.z_mm, 2), "clock_deg": round(defect.clock_deg, 2),
        "clock": defect.clock, "length_mm": round(defect.length_mm, 2), "arc_deg": round(defect.arc_deg, 2),
        "depth_mm": round(defect.depth_mm, 3), "depth_k2_mm": round(defect.depth_k2_mm, 3),
        "area_mm2": round(defect.area_mm2, 1), "floor_seen": defect.floor_seen,
        "hidden_mm": round(defect.shadowed_mm, 1),
        "z_from_mm": round(first, 2), "z_to_mm": round(last, 2), "clock_from_to": list(defect.clock_range),
    }  # fmt: skip


def _finite(value: Any) -> Any:
    """The same with None for what JSON has no number for."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, np.generic):
        return _finite(value.item())
    return value
