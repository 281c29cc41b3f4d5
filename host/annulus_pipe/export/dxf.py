"""The pipe as a drawing: DXF of AutoCAD 2010, mm. Stations and centre line in space, defects on an unrolled plan.

In space: x right, y forward, z up. The plan beside it lies flat: x is the distance along the pipe, y goes down from 12
o'clock by the length of the arc at the nominal radius, clockwise looking forward, as the report's map does. What a
results folder knows of a defect is its extent, so its outline is the box of it.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.export.axes import z_up
from annulus_pipe.export.course import Space, line, outline
from annulus_pipe.export.results import Marked, Results
from annulus_pipe.export.stations import radii_of_stations
from annulus_pipe.export.tally import clock_time
from annulus_pipe.extras import need
from annulus_pipe.numeric.rounding import ARC, DISTANCE, MEASURE, digits, quoted, span
from annulus_pipe.storage.results_folder import ListedPlace

OUTLINES_MAX = 120  # stations drawn: evenly chosen, for a CAD program's sake
LABEL = 0.024  # height of a text, of the circumference
STEPS_MM = (10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 50_000, 100_000)
STEP_LABELS = 7.0  # heights of a text between two lines of the grid, at least
LINES_MAX = 400  # .. of the grid
LAYERS = {  # colours of AutoCAD's index; 7 is black on white and white on black
    "CENTRE-LINE": 1,
    "STATIONS": 7,
    "PLAN-FRAME": 7,
    "PLAN-GRID": 9,
    "PLAN-TEXT": 7,
    "PLAN-LOSS": 1,
    "PLAN-BUMP": 5,
    "PLAN-OVALITY": 6,
    "PLAN-UNDECIDED": 30,
    "PLAN-FEATURES": 94,
    "PLAN-OBSERVATIONS": 130,
    "PLAN-LIST": 7,
}
_OF_KIND = {"loss": "PLAN-LOSS", "bump": "PLAN-BUMP", "ovality": "PLAN-OVALITY"}


def write(results: Results, path: Path) -> None:
    ezdxf = need("ezdxf")
    document = ezdxf.new("R2010", setup=["linetypes"], units=ezdxf.units.MM)
    document.styles.add("ANNULUS", font="arial.ttf")
    for name, colour in LAYERS.items():
        document.layers.add(name, color=colour)
    for name, value in (("SOURCE", results.source), ("MADE_BY", results.made_by), ("CREATED", results.created)):
        document.header.custom_vars.append(name, value[:250])
    model = document.modelspace()
    _draw_space(model, results)
    plan = _Plan(model, results)
    plan.draw()
    document.set_modelspace_vport(height=1.3 * plan.height, center=(plan.middle, plan.top - plan.height / 2))
    document.saveas(path)


def _draw_space(model: Any, results: Results) -> None:
    course = z_up(line(results))
    if len(course) > 1:
        model.add_polyline3d(course, dxfattribs={"layer": "CENTRE-LINE"})
    space = Space(results)
    every = math.ceil(len(results.stations["z_mm"]) / OUTLINES_MAX)
    for z, radius in radii_of_stations(results, max(every, 1)):
        points = z_up(space(outline(radius, results.wall.clock_deg, z)))
        for run, closed in runs(np.isfinite(radius)):
            model.add_polyline3d(points[run], close=closed, dxfattribs={"layer": "STATIONS"})


def runs(seen: np.ndarray[Any, np.dtype[np.bool_]]) -> Iterator[tuple[np.ndarray[Any, Any], bool]]:
    """Indices of each stretch round the circle that was seen, two columns or more, and whether it closes."""
    if seen.all():
        yield np.arange(len(seen)), True
        return
    if not seen.any():
        return
    start = int(np.flatnonzero(~seen)[0])
    order = (np.arange(len(seen)) + start) % len(seen)  # begins at a gap, so that no stretch is cut
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen[order], [False]]).astype(np.int8)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if last - first > 1:
            yield order[first:last], False


class _Plan:
    """The unrolled wall in the drawing's plane."""

    def __init__(self, model: Any, results: Results) -> None:
        self.model, self.results = model, results
        self.radius = results.radius_mm
        self.first, self.last = results.scanned_mm
        self.height = 2 * math.pi * self.radius
        self.top = min(0.0, self.first - self.radius)  # below what stands in space
        self.middle = (self.first + self.last) / 2
        self.label = LABEL * self.height
        self.taken: set[tuple[int, int]] = set()  # where numbers stand, in steps of a line

    def draw(self) -> None:
        self._draw_grid()
        named = [(f"D{i + 1}", one, _OF_KIND.get(one.kind, "PLAN-LOSS")) for i, one in enumerate(self.results.defects)]
        named += [(f"U{i + 1}", one, "PLAN-UNDECIDED") for i, one in enumerate(self.results.undecided)]
        named += [(f"F{i + 1}", one, "PLAN-FEATURES") for i, one in enumerate(self.results.features)]
        for name, place, layer in named:
            self._draw_place(name, place, layer)
        for one in self.results.observations:
            self._draw_mark(one)
        below = self.top - self.height - 5 * self.label
        for row, (name, place, _) in enumerate(named):
            self._text(f"{name}  {_described(place)}", self.first, below - 1.8 * row * self.label, "PLAN-LIST")
        for row, one in enumerate(self.results.observations, start=len(named)):
            at = "" if one.z_mm is None else f" head at {quoted(one.z_mm, DISTANCE)}"
            clock = "" if one.clock_deg is None else f", clock {clock_time(one.clock_deg):%H:%M}"
            text = f"{one.name}  marked by the operator,{at}{clock}: {one.text}"
            self._text(text, self.first, below - 1.8 * row * self.label, "PLAN-LIST")

    def y(self, clock_deg: float) -> float:
        """Of a clock angle in 0..360: 360 is the lower edge."""
        return self.top - math.radians(clock_deg) * self.radius

    def _draw_grid(self) -> None:
        results, label = self.results, self.label
        least = max(STEP_LABELS * label, (self.last - self.first) / LINES_MAX)
        step = next((s for s in STEPS_MM if s >= least), STEPS_MM[-1])
        for z in (float(step * n) for n in range(math.ceil(self.first / step), math.floor(self.last / step) + 1)):
            self._line((z, self.top), (z, self.top - self.height), "PLAN-GRID")
            self._text(f"{z / 1000:.{3 if step % 100 else 1}f} m", z, self.y(360) - 1.8 * label, "PLAN-TEXT", "centre")
        for hour in range(13):
            y = self.y(30.0 * hour)
            if 0 < hour < 12:
                self._line((self.first, y), (self.last, y), "PLAN-GRID")
            self._text(f"{hour or 12}:00", self.first - label, y - label / 2, "PLAN-TEXT", "right")
        self._box(self.first, self.last, 0.0, 360.0, "PLAN-FRAME")
        title = (
            f"Unrolled wall, {span(self.first, self.last, DISTANCE)}, inner diameter {results.nominal_mm:g} mm nominal"
        )
        self._text(title, self.first, self.top + 4 * label, "PLAN-TEXT", scale=1.4)
        where = [text for key in ("client", "site", "pipe") if (text := results.job.get(key))]
        self._text(
            ", ".join([*where, results.source]) + ". Clockwise looking forward; y is arc length at the nominal radius",
            self.first,
            self.top + 1.8 * label,
            "PLAN-TEXT",
        )

    def _draw_place(self, name: str, place: ListedPlace, layer: str) -> None:
        first, last = (min(max(z, self.first), self.last) for z in (place.z_from_mm, place.z_to_mm))
        begin = 0.0 if place.is_all_round else place.clock_deg - place.arc_deg / 2
        for low, high in _within_circle(begin, place.arc_deg):
            if first < last and low < high:
                self._box(first, last, low, high, layer)
            else:
                self._line((first, self.y(low)), (last, self.y(high)), layer)
        if place.kind == "ovality":  # its long axis
            for clock in (place.clock_deg, (place.clock_deg + 180.0) % 360.0):
                self._line((first, self.y(clock)), (last, self.y(clock)), layer, "DASHED")
        wide = len(name) * self.label
        x = (first + last) / 2 - wide / 2 if last - first > wide else last + self.label / 2
        y = self.y(0.0) - 1.5 * self.label if place.is_all_round else self.y(place.clock_deg) - self.label / 2
        self._text(name, x, self._free(x, y, wide), layer)

    def _draw_mark(self, one: Marked) -> None:
        """A cross where the head stood, at its clock; a line all down the plan where none was said."""
        if one.z_mm is None or not self.first <= one.z_mm <= self.last:
            return
        layer, arm = "PLAN-OBSERVATIONS", self.label / 2
        y = self.y(one.clock_deg or 0.0)
        if one.clock_deg is None:
            self._line((one.z_mm, self.top), (one.z_mm, self.y(360.0)), layer, "DASHED")
        else:
            self._line((one.z_mm - arm, y - arm), (one.z_mm + arm, y + arm), layer)
            self._line((one.z_mm - arm, y + arm), (one.z_mm + arm, y - arm), layer)
        x = one.z_mm + self.label
        self._text(one.name, x, self._free(x, y - arm, len(one.name) * self.label), layer)

    def _free(self, x: float, y: float, wide: float) -> float:
        """The height nearest below at which no number stands yet, as far as the plan goes."""
        step = 1.4 * self.label
        columns = range(math.floor(x / step), math.floor((x + wide) / step) + 1)
        for row in range(math.floor(y / step), math.floor((self.top - self.height) / step), -1):
            if not any((column, row) in self.taken for column in columns):
                break
        else:
            return y  # too many to be told apart: the list has them all
        self.taken.update((column, row) for column in columns)
        return row * step if row != math.floor(y / step) else y

    def _box(self, first: float, last: float, low: float, high: float, layer: str) -> None:
        corners = [(first, self.y(low)), (last, self.y(low)), (last, self.y(high)), (first, self.y(high))]
        self.model.add_lwpolyline(corners, close=True, dxfattribs={"layer": layer})

    def _line(self, start: tuple[float, float], end: tuple[float, float], layer: str, kind: str = "BYLAYER") -> None:
        self.model.add_line(start, end, dxfattribs={"layer": layer, "linetype": kind})

    def _text(self, text: str, x: float, y: float, layer: str, align: str = "left", scale: float = 1.0) -> None:
        from ezdxf.enums import TextEntityAlignment

        how = {
            "left": TextEntityAlignment.LEFT,
            "right": TextEntityAlignment.RIGHT,
            "centre": TextEntityAlignment.CENTER,
        }
        entity = self.model.add_text(
            text[:250], height=scale * self.label, dxfattribs={"layer": layer, "style": "ANNULUS"}
        )
        entity.set_placement((x, y), align=how[align])


def _within_circle(begin: float, arc: float) -> list[tuple[float, float]]:
    """An arc as one or two that do not pass 12 o'clock, degrees in 0..360."""
    begin %= 360.0
    end = begin + arc
    return [(begin, end)] if end <= 360.0 else [(begin, 360.0), (0.0, end - 360.0)]


def _described(place: ListedPlace) -> str:
    out = place.kind
    if place.depth_mm is not None:
        out += f" {quoted(place.depth_mm, MEASURE, place.depth_k2_mm, at_least=not place.floor_seen)} (k=2)"
    out += f" at {quoted(place.z_mm, DISTANCE)}, from {span(place.z_from_mm, place.z_to_mm, DISTANCE)}"
    if place.kind == "ovality":
        out += f", long axis at clock {clock_time(place.clock_deg):%H:%M}"
    elif place.is_all_round and place.kind != "bend":
        out += ", all round"
    elif not place.is_all_round:
        out += f", clock {clock_time(place.clock_deg):%H:%M}, {digits(place.arc_deg, ARC)} degrees"
    return ", ".join(text for text in (out, place.remark, place.severity) if text)
