"""Defects found so far in a scan that is under way: each window's are put together with those of the windows before.

A window is looked at when the head has moved on; its ends show less than its middle: at the leading end rings are still
to come, at the trailing end some passed before the window began. So in its middle the window is believed, also where it
shows no defect; near its trailing end the window before is; and near its leading end nothing is listed yet.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.numeric.palette import DEVIATION_LIVE_MM, deviation_table
from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey

LISTED_MAX, FRAMES_MAX = 500, 12
LEADING_OF_DIAMETER, TRAILING_OF_DIAMETER = 0.5, 1.5  # at a window's ends, which are no part of its middle
SAME_OF_DIAMETER = 0.1  # along the pipe: two defects that do not touch and are at least so far apart are two
ALONG_MAX = 2000  # numbers of a line along the pipe
SECTION_MM = 2.5  # to both sides of a defect's place, of which its section is the median
UNSEEN_GREY, PICTURE_MAX, PICTURE_PX_MM = 150, 640, 2.0
COLOURS = 49  # of a picture: more are noise, and make it twice as large


@dataclass(frozen=True, slots=True, eq=False)
class FoundDefect:
    """A defect with the number that stays with it and the frames that saw it.

    closeup : what is shown of it from close by, 50 to 150 kB; empty where it is kept for long.
    """

    id: int
    defect: Defect
    frames: tuple[int, ...]
    closeup: tuple[dict[str, Any], bytes] = field(default_factory=lambda: ({}, b""))

    def to_dict(self) -> dict[str, Any]:
        one = self.defect
        known = math.isfinite(one.depth_k2_mm)
        return {
            "id": self.id,
            "kind": one.kind.value,
            "z_mm": one.z_mm,
            "clock_deg": one.clock_deg,
            "clock": one.clock,
            "depth_mm": one.depth_mm,
            "depth_k2_mm": one.depth_k2_mm if known else None,
            "floor_seen": one.floor_seen,
            "length_mm": one.length_mm,
            "arc_deg": one.arc_deg,
            "frames": list(self.frames),
        }


class Findings:
    """Of one scan."""

    def __init__(self, diameter_mm: float) -> None:
        self.known: list[FoundDefect] = []
        self._number = 1  # the next defect's
        self.looked_mm: tuple[float, float] | None = None
        self.diameter_mm = self.k2_mm = math.nan
        self._diameter_mm = diameter_mm

    def take_over(self, summary: Mapping[str, Any]) -> None:
        """Goes on from what `to_dict` gave; close-ups are not among it."""
        for one in summary["defects"]:
            k2 = math.nan if one["depth_k2_mm"] is None else one["depth_k2_mm"]
            defect = Defect(
                Kind(one["kind"]),
                one["z_mm"],
                one["clock_deg"],
                one["length_mm"],
                one["arc_deg"],
                one["depth_mm"],
                math.nan,
                one["floor_seen"],
                k2,
            )
            self.known.append(FoundDefect(one["id"], defect, tuple(one["frames"])))
        self._number = 1 + max((one.id for one in self.known), default=0)
        looked = summary.get("looked_mm")
        self.looked_mm = (looked[0], looked[1]) if looked else None

    def look(self, survey: Survey, way: int, begins: bool, ends: bool) -> list[FoundDefect]:
        """Put a window's defects to the others; returns which are new or say something new.

        way : +1 when the head moves towards greater z, -1 the other way. begins, ends : the window's trailing, leading
        end is the scan's own.
        """
        low, high = survey.scanned_mm
        trailing = 0.0 if begins else TRAILING_OF_DIAMETER * self._diameter_mm
        leading = 0.0 if ends else LEADING_OF_DIAMETER * self._diameter_mm
        low_margin, high_margin = (trailing, leading) if way > 0 else (leading, trailing)
        middle = min(low + low_margin, high), max(high - high_margin, low)
        seen_to = (low, max(high - leading, low)) if way > 0 else (min(low + leading, high), high)
        before = self.looked_mm or seen_to
        self.looked_mm = min(before[0], seen_to[0]), max(before[1], seen_to[1])
        self.diameter_mm, self.k2_mm = survey.diameter_mean_mm, survey.diameter_k2_mm
        new: list[FoundDefect] = []
        left = [one for one in self.known if not middle[0] <= one.defect.z_mm <= middle[1]]
        open_ = [one for one in self.known if middle[0] <= one.defect.z_mm <= middle[1]]
        for defect in survey.defects:
            if not middle[0] <= defect.z_mm <= middle[1]:
                continue
            same = [one for one in (*open_, *left) if is_same(one.defect, defect, self._diameter_mm)]
            old = min(same, key=lambda one: abs(one.defect.z_mm - defect.z_mm), default=None)
            if old is not None and _says_the_same(old.defect, defect):
                goes_on = replace(old, defect=defect)
            else:
                number = self._number if old is None else old.id
                self._number += old is None
                frames = frames_of(defect, survey.profiles)
                goes_on = FoundDefect(number, defect, frames)
                new.append(replace(goes_on, closeup=closeup(number, defect, survey)))
            open_ = [one for one in open_ if one is not old]
            left = [one for one in left if one is not old]
            left.append(goes_on)
        self.known = sorted(left, key=lambda one: -one.defect.depth_mm)[:LISTED_MAX]
        self.known.sort(key=lambda one: (one.defect.z_mm, one.defect.clock_deg))
        listed = {one.id for one in self.known}
        return [one for one in new if one.id in listed]

    def to_dict(self, scan: int) -> dict[str, Any]:
        """Body of topic defects: every defect found so far, and the pipe's diameter in the last window."""
        return {
            "scan": scan,
            "looked_mm": None if self.looked_mm is None else list(self.looked_mm),
            "defects": [one.to_dict() for one in self.known],
            "diameter_mm": _known(self.diameter_mm),
            "k2_mm": _known(self.k2_mm),
        }


def is_same(one: Defect, other: Defect, diameter_mm: float) -> bool:
    """Same kind, same place: they touch, or nearly, along the pipe and around it."""
    apart = abs(one.z_mm - other.z_mm)
    if one.kind is not other.kind or apart > max(SAME_OF_DIAMETER * diameter_mm, (one.length_mm + other.length_mm) / 2):
        return False
    around = abs((one.clock_deg - other.clock_deg + 180.0) % 360.0 - 180.0)
    return one.kind is Kind.OVALITY or around <= (one.arc_deg + other.arc_deg) / 2


def frames_of(defect: Defect, profiles: Sequence[Profile]) -> tuple[int, ...]:
    """Of which profiles have points there: FRAMES_MAX at most, evenly spread."""
    z0, z1 = defect.z_range_mm
    frames = []
    for profile in profiles:
        x, y, z = profile.points_mm.T
        around = np.abs((np.degrees(np.arctan2(x, -y)) - defect.clock_deg + 180.0) % 360.0 - 180.0)
        if ((z >= z0) & (z <= z1) & (around <= defect.arc_deg / 2)).any():
            frames.append(profile.frame)
    some = np.unique(np.linspace(0, len(frames) - 1, min(FRAMES_MAX, len(frames))).round().astype(int))
    return tuple(frames[i] for i in some)


def closeup(number: int, defect: Defect, survey: Survey) -> tuple[dict[str, Any], bytes]:
    """Body, without its scan, and PNG of topic closeup: the pipe's section and a line along it through a defect, and
    the deviation around it as a picture, along the pipe to the right, clock downwards."""
    wall = survey.wall
    rows = np.flatnonzero(np.abs(wall.z_mm - defect.z_mm) <= max(SECTION_MM, wall.z_step_mm))
    section = _medians(wall.radius_mm[rows]) if len(rows) else np.full(len(wall.clock_deg), np.nan)
    columns = len(wall.clock_deg)
    at = int(defect.clock_deg / wall.clock_step_deg) % columns
    reach = defect.length_mm / 2 + survey.nominal_diameter_mm
    near = np.flatnonzero(np.abs(wall.z_mm - defect.z_mm) <= reach)
    near = near[:: 1 + len(near) // ALONG_MAX]
    step = (int(near[1] - near[0]) if len(near) > 1 else 1) * wall.z_step_mm
    beside = (at + np.arange(-1, 2)) % columns
    along = _medians(wall.radius_mm[near][:, beside].T) if len(near) else np.zeros(0)
    picture, z_range, clock_range = _picture(defect, wall, survey.nominal_diameter_mm)
    body = {
        "id": number,
        "section_mm": section.astype("<f4").tobytes(),
        "along_mm": along.astype("<f4").tobytes(),
        "along_from_mm": float(wall.z_mm[near[0]]) if len(near) else defect.z_mm,
        "along_step_mm": step,
        "nominal_mm": survey.nominal_diameter_mm / 2,
        "picture_z_mm": list(z_range),
        "picture_clock_deg": clock_range,
    }
    return body, picture


def _picture(defect: Defect, wall: Wall, diameter_mm: float) -> tuple[bytes, tuple[float, float], list[float]]:
    import cv2

    reach = defect.length_mm / 2 + diameter_mm / 2
    rows = np.flatnonzero(np.abs(wall.z_mm - defect.z_mm) <= reach)
    columns = len(wall.clock_deg)
    half = min(columns // 2, int((defect.arc_deg / 2 + 45.0) / wall.clock_step_deg))
    middle = int(defect.clock_deg / wall.clock_step_deg)
    deviation = wall.deviation_mm()[rows][:, (middle + np.arange(-half, half)) % columns].T
    ends = max(DEVIATION_LIVE_MM, defect.depth_mm)
    table = deviation_table(COLOURS)
    at = np.clip((np.nan_to_num(deviation) / ends + 1.0) / 2 * (len(table) - 1), 0, len(table) - 1).astype(int)
    pixels: NDArray[np.uint8] = table[at][..., ::-1].copy()
    pixels[~np.isfinite(deviation)] = UNSEEN_GREY
    arc_mm = math.radians(wall.clock_step_deg) * diameter_mm / 2
    size = [PICTURE_PX_MM * wall.z_step_mm * len(rows), PICTURE_PX_MM * arc_mm * 2 * half]
    smaller = min(1.0, PICTURE_MAX / max(size))
    width, height = (max(1, round(smaller * side)) for side in size)
    pixels = np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
    z = (float(wall.z_mm[rows[0]]), float(wall.z_mm[rows[-1]])) if len(rows) else (defect.z_mm, defect.z_mm)
    clock = [(middle - half) * wall.clock_step_deg, (middle + half) * wall.clock_step_deg]
    return cv2.imencode(".png", pixels)[1].tobytes(), z, clock


def _medians(values: Float32Array) -> FloatArray:
    """Down the first axis, NaN passed over, and where there is nothing else."""
    known = np.isfinite(values)
    out = np.full(values.shape[1], np.nan)
    some = known.any(axis=0)
    out[some] = np.nanmedian(values[:, some], axis=0)
    return out


def _says_the_same(one: Defect, other: Defect) -> bool:
    """To what is shown: 0.01 mm of depth, 0.5 mm and a degree of place and size."""
    same = one.floor_seen == other.floor_seen and abs(one.depth_mm - other.depth_mm) < 0.01
    places = (one.z_mm - other.z_mm, one.length_mm - other.length_mm)
    return (
        same
        and all(abs(d) < 0.5 for d in places)
        and abs(one.clock_deg - other.clock_deg) < 1.0
        and (abs(one.arc_deg - other.arc_deg) < 1.0)
    )


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
