"""What is marked on a map of clock position against distance: defects by outline and number, features by letter and
undecided places by question mark."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from contourpy import contour_generator
from matplotlib.patches import Rectangle
from scipy import ndimage

from annulus.numeric.arrays import FloatArray
from annulus.report.paper import AXES_MM, FEATURE, INK, badge, letter, question
from annulus.wall.defects import ALL_ROUND_DEG, Defect, Kind
from annulus.wall.grid import Wall
from annulus.wall.indications import LabelArray
from annulus.wall.survey import Survey

CLOSED_MM = 8.0  # half of what a gap may measure that is a rod's shadow and not the defect's shape
BADGE_MM = 4.6  # on paper
LETTER_MM = 1.9


@dataclass(frozen=True, slots=True)
class Mark:
    """One thing on the wall: its name in the tables, where it lies, and its outline, lines of (N, 2) m and degrees."""

    name: str
    z_range_mm: tuple[float, float]
    clock_deg: float
    arc_deg: float
    ovality: bool = False
    lines: tuple[FloatArray, ...] = ()

    @property
    def style(self) -> dict[str, Any]:
        if self.name[0] == "?":
            return {"ec": INK, "ls": (0, (3, 2)), "lw": 1.3}
        return {"ec": FEATURE, "ls": "-", "lw": 1.3}

    @property
    def badge(self) -> dict[str, Any]:
        return {"colour": FEATURE, "shape": "round"} if self.name.isalpha() else {}


def marks_of(survey: Survey) -> tuple[Mark, ...]:
    """Everything that has a name in the page's tables."""
    out = [
        Mark(
            str(i), one.z_range_mm, one.clock_deg, one.arc_deg, one.kind is Kind.OVALITY,
            () if one.kind is Kind.OVALITY else outline(survey.wall, survey.detection.label, i, one),
        )
        for i, one in enumerate(survey.defects, start=1)
    ]  # fmt: skip
    out += [Mark(letter(i), one.z_range_mm, one.clock_deg, one.arc_deg) for i, one in enumerate(survey.features)]
    for i, place in enumerate(survey.detection.undecided):
        out.append(Mark(question(i), place.z_range_mm, place.clock_deg, place.arc_deg))
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
    y, x = np.ogrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1]
    disc = (y / (reach[0] + 0.5)) ** 2 + (x / (reach[1] + 0.5)) ** 2 <= 1
    solid = ndimage.binary_fill_holes(ndimage.binary_closing(mask, disc))
    blurred = ndimage.gaussian_filter(solid.astype(float), reach / 2)
    z = (wall.z_mm[0] + (first - pad + np.arange(len(mask))) * wall.z_step_mm) / 1000
    clock = (np.arange(mask.shape[1]) - pad - turn + 0.5) * wall.clock_step_deg
    lines = contour_generator(z, clock, blurred.T).lines(0.5 * float(blurred.max()))
    return tuple(np.asarray(line) for line in lines)


def draw_marks(axes: Any, marks: Sequence[Mark], height_mm: float, *, names: bool = True) -> None:
    """Every mark that reaches into the axes, whose x are m and whose y degrees; names : with badges beside them."""
    low, high = axes.get_xlim()
    placed: list[tuple[float, float, float]] = []  # middle and half width, mm on paper

    def free(x: float, y: float, half: float) -> bool:
        return all(abs(x - a) >= half + b or abs(y - c) >= BADGE_MM for a, c, b in placed)

    def put(mark: Mark, spots: Iterator[tuple[float, float]]) -> None:
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
            _bracket(axes, first, last, -0.9 / height_mm * 360, INK)
            if names:
                put_above(axes, mark, (first + last) / 2, height_mm)
            continue
        for line in mark.lines:
            for turn in (-360, 0, 360):  # what reaches over 12 o'clock comes in again from the other edge
                if line[:, 1].max() + turn > 0 and line[:, 1].min() + turn < 360:
                    for width, colour in ((3.0, "white"), (1.3, INK)):
                        axes.plot(line[:, 0], line[:, 1] + turn, color=colour, lw=width, zorder=4)
        if mark.arc_deg >= ALL_ROUND_DEG:
            if not mark.lines:
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
                    (at[1] + 4, beside), (at[0] - 4, beside),
                    *((middle + dx, over - 3.6 - dy) for dy in (0, 5) for dx in (6, -6, 12, -12)),
                ]
            )  # fmt: skip
        if names:
            put(mark, spots)


def put_above(axes: Any, mark: Mark, x_m: float, height_mm: float) -> None:
    badge(axes, x_m, -0.9 / height_mm * 360, mark.name, **mark.badge)


def name_above(axes: Any, marks: Sequence[Mark]) -> None:
    """Names along the upper edge, where the things lie; those that would run into each other share a place."""
    low, high = axes.get_xlim()
    groups: list[tuple[float, list[str]]] = []
    here = [(sum(one.z_range_mm) / 2000, one.name) for one in marks if _reaches(one, low, high)]
    for z, name in sorted(here):
        at = float(np.clip((z - low) / (high - low), 0, 1)) * AXES_MM
        if groups and at - groups[-1][0] < 2.5 + 0.9 * (len(_joined(groups[-1][1])) + len(name)):
            groups[-1][1].append(name)
        else:
            groups.append((at, [name]))
    for at, names in groups:
        axes.text(
            at / AXES_MM, 1.0, _joined(names), transform=axes.transAxes, ha="center", va="bottom", fontsize=9,
            fontweight="bold",
        )  # fmt: skip


def _reaches(mark: Mark, low: float, high: float) -> bool:
    return mark.z_range_mm[1] / 1000 >= low and mark.z_range_mm[0] / 1000 <= high


def _joined(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{names[0]} .. {names[-1]}"


def _bracket(axes: Any, first: float, last: float, y: float, colour: str) -> None:
    axes.annotate(
        "", (first, y), (last, y), annotation_clip=False,
        arrowprops={"arrowstyle": "|-|,widthA=0.3,widthB=0.3", "lw": 1.2, "color": colour},
    )  # fmt: skip
