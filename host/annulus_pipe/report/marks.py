"""What is marked on a map of clock position against distance: defects by outline and number, features by letter,
undecided places by question mark, and by M what an operator marked: where the head stood, for nobody measured more."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from contourpy import contour_generator
from matplotlib.patches import Rectangle

from annulus_pipe.job import Observation
from annulus_pipe.numeric.arrays import FloatArray, LabelArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.report.names import FEATURE, INK, OBSERVED, letter, marked, question
from annulus_pipe.report.paper import AXES_MM, badge
from annulus_pipe.wall.defects import ALL_ROUND_DEG, Defect, Kind
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.survey import Survey

CLOSED_MM = 8.0  # half of what a gap may measure that is a rod's shadow and not the defect's shape
BADGE_MM = 4.6  # on paper
LETTER_MM = 1.9
NAME_MM = 1.8  # a letter of a name above


@dataclass(frozen=True, slots=True)
class WallMark:
    """One thing on the wall: its name in the tables, where it lies, and its outline, lines of (N, 2) m and degrees."""

    name: str
    z_range_mm: tuple[float, float]
    clock_deg: float
    arc_deg: float
    ovality: bool = False
    point: bool = False  # of no extent that anybody knows; round the pipe neither where arc_deg is 360
    lines: tuple[FloatArray, ...] = ()

    @property
    def style(self) -> dict[str, Any]:
        if self.point:
            return {"ec": OBSERVED, "ls": (0, (1, 2)), "lw": 1.3}
        if self.name[0] == "?":
            return {"ec": INK, "ls": (0, (3, 2)), "lw": 1.3}
        return {"ec": FEATURE, "ls": "-", "lw": 1.3}

    @property
    def badge(self) -> dict[str, Any]:
        if self.point:
            return {"colour": OBSERVED, "shape": "round"}
        return {"colour": FEATURE, "shape": "round"} if self.name.isalpha() else {}


def marks_of(survey: Survey, observations: Sequence[Observation] = ()) -> tuple[WallMark, ...]:
    """Everything that has a name in the page's tables."""
    out = [
        WallMark(
            str(i),
            one.z_range_mm,
            one.clock_deg,
            one.arc_deg,
            one.kind is Kind.OVALITY,
            lines=() if one.kind is Kind.OVALITY else outline(survey.wall, survey.detection.label, i, one),
        )
        for i, one in enumerate(survey.defects, start=1)
    ]
    out += [WallMark(letter(i), one.z_range_mm, one.clock_deg, one.arc_deg) for i, one in enumerate(survey.features)]
    for i, place in enumerate(survey.detection.undecided):
        out.append(WallMark(question(i), place.z_range_mm, place.clock_deg, place.arc_deg))
    for i, one in enumerate(observations):
        if math.isfinite(one.z_mm):
            arc = 360.0 if one.clock_deg is None else 0.0
            out.append(WallMark(marked(i), (one.z_mm, one.z_mm), one.clock_deg or 0.0, arc, point=True))
    return tuple(out)


def outline(wall: Wall, label: LabelArray, number: int, defect: Defect) -> tuple[FloatArray, ...]:
    """Closed lines round a defect, for the eye: what lies in shadow across it is no hole and no tooth of a comb."""
    first, last = np.searchsorted(wall.z_mm, np.add(defect.z_range_mm, (-2 * CLOSED_MM, 2 * CLOSED_MM)))
    mask = label[first:last] == number
    if not mask.any():
        return ()
    columns = mask.shape[1]
    turn = columns // 2 - int(defect.clock_deg / wall.clock_step_deg)
    cell_mm = np.array([wall.z_step_mm, np.radians(wall.clock_step_deg) * wall.mean_radius_mm])
    reach = np.maximum(np.round(CLOSED_MM / cell_mm), 1).astype(int)
    pad = 3 * int(reach.max())
    mask = np.pad(np.roll(mask, turn, axis=1), ((pad, pad), (0, 0)))
    mask = np.pad(mask, ((0, 0), (pad, pad)), mode="wrap")
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * int(reach[1]) + 1, 2 * int(reach[0]) + 1))
    solid = ndimage.binary_fill_holes(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, disc))
    blurred = ndimage.gaussian_filter(solid.astype(float), reach / 2)
    z = (wall.z_mm[0] + (first - pad + np.arange(len(mask))) * wall.z_step_mm) / 1000
    clock = (np.arange(mask.shape[1]) - pad - turn + 0.5) * wall.clock_step_deg
    lines = contour_generator(z, clock, blurred.T).lines(0.5 * float(blurred.max()))
    return tuple(np.asarray(line) for line in lines)


def draw_marks(axes: Any, marks: Sequence[WallMark], height_mm: float, *, names: bool = True) -> None:
    """Every mark that reaches into the axes, whose x are m and whose y degrees; names : with badges beside them."""
    low, high = axes.get_xlim()
    placed: list[tuple[float, float, float]] = []  # middle and half width, mm on paper

    def free(x: float, y: float, half: float) -> bool:
        return all(abs(x - a) >= half + b or abs(y - c) >= BADGE_MM for a, c, b in placed)

    def put(mark: WallMark, spots: Iterator[tuple[float, float]]) -> None:
        """At the first spot (mm on paper) that is free; at the first of all where none is."""
        half = (BADGE_MM + LETTER_MM * (len(mark.name) - 1)) / 2
        fits = [(float(np.clip(x, half, AXES_MM - half)), float(np.clip(y, 2.5, height_mm - 2.5))) for x, y in spots]
        x, y = next((spot for spot in fits if free(*spot, half)), fits[0])
        placed.append((x, y, half))
        badge(axes, low + x / AXES_MM * (high - low), y / height_mm * 360, mark.name, **mark.badge)

    for mark in marks:
        z0, z1 = (z / 1000 for z in mark.z_range_mm)
        if z1 < low or z0 > high:
            continue
        first, last = np.clip((z0, z1), low, high)
        at = [(z - low) / (high - low) * AXES_MM for z in (first, last)]
        middle = sum(at) / 2
        spots: Iterator[tuple[float, float]]
        if mark.ovality:
            if names:
                _bracket(axes, first, last, -0.9 / height_mm * 360, INK)
                badge(axes, (first + last) / 2, -0.9 / height_mm * 360, mark.name)
            continue
        for line in mark.lines:
            for turn in (-360, 0, 360):  # what reaches over 12 o'clock comes in again from the other edge
                if line[:, 1].max() + turn > 0 and line[:, 1].min() + turn < 360:
                    for width, colour in ((3.0, "white"), (1.3, INK)) if names else ((0.5, INK),):
                        axes.plot(line[:, 0], line[:, 1] + turn, color=colour, lw=width, zorder=4)
        if mark.point and mark.arc_deg < ALL_ROUND_DEG:
            y = mark.clock_deg % 360
            axes.plot(first, y, "D", ms=4.5, mfc=OBSERVED, mec="white", mew=0.9, zorder=5)
            beside = y / 360 * height_mm
            spots = ((middle + dx, beside + dy) for dy in (-4.5, 4.5, 0, -9, 9) for dx in (0, 6, -6))
        elif mark.arc_deg >= ALL_ROUND_DEG:
            if mark.point:
                axes.axvline(first, color=OBSERVED, lw=1.2, ls=mark.style["ls"], zorder=4)
            elif not mark.lines:
                for x in (first, last):
                    axes.axvline(x, color=mark.style["ec"], lw=1.0, ls=mark.style["ls"], zorder=4)
                _bracket(axes, first, last, 360 + 0.9 / height_mm * 360, mark.style["ec"])
            spots = ((middle + dx, height_mm - 4 - 5 * row) for row in range(5) for dx in (0, -6, 6))
        else:
            top = (mark.clock_deg - mark.arc_deg / 2) % 360
            if not mark.lines:
                for turn in (0, -360):
                    axes.add_patch(
                        Rectangle((first, top + turn), last - first, mark.arc_deg, fill=False, zorder=4, **mark.style)
                    )
            over, under = top / 360 * height_mm, (top + mark.arc_deg) % 360 / 360 * height_mm
            beside = (mark.clock_deg % 360) / 360 * height_mm
            spots = iter(
                [
                    *((middle, y) for y in (over - 3.6, under + 3.6) if 2 < y < height_mm - 2),
                    (at[1] + 4, beside),
                    (at[0] - 4, beside),
                    *((middle + dx, over - 3.6 - dy) for dy in (0, 5) for dx in (6, -6, 12, -12)),
                ]
            )
        if names:
            put(mark, spots)


def name_above(axes: Any, marks: Sequence[WallMark]) -> None:
    """Names along the upper edge, where the things lie; those that would run into each other share a place."""
    low, high = axes.get_xlim()
    groups: list[list[tuple[float, str]]] = []
    for mark in marks:
        if mark.z_range_mm[1] / 1000 >= low and mark.z_range_mm[0] / 1000 <= high:
            at = (sum(mark.z_range_mm) / 2000 - low) / (high - low)
            groups.append([(float(np.clip(at, 0, 1)) * AXES_MM, mark.name)])
    groups.sort()
    apart = False
    while not apart:
        apart = True
        for k in range(len(groups) - 1, 0, -1):
            (end, room), (begin, more) = _place(groups[k - 1]), _place(groups[k])
            if begin - end < (room + more) / 2 + NAME_MM:
                groups[k - 1] += groups.pop(k)
                apart = False
    for group in groups:
        axes.text(
            _place(group)[0] / AXES_MM,
            1.0,
            _joined(group),
            transform=axes.transAxes,
            ha="center",
            va="bottom",
            fontsize=9,
            fontweight="bold",
        )


def _place(group: Sequence[tuple[float, str]]) -> tuple[float, float]:
    """Middle and width of its text, mm on paper."""
    return (group[0][0] + group[-1][0]) / 2, NAME_MM * len(_joined(group))


def _joined(group: Sequence[tuple[float, str]]) -> str:
    names = [name for _, name in group]
    return ", ".join(names) if len(names) <= 3 else f"{names[0]} .. {names[-1]}"


def _bracket(axes: Any, first: float, last: float, y: float, colour: str) -> None:
    axes.annotate(
        "",
        (first, y),
        (last, y),
        annotation_clip=False,
        arrowprops={"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "lw": 1.2, "color": colour},
    )
