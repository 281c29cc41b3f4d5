"""A defect from close by, cut across the pipe and along it: SVG, a few kB each, sharp on paper at any size."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.rounding import DISTANCE, MEASURE, clock_face, digits, quoted
from annulus_pipe.report.names import BUMP_BLUE, INK, LOSS_RED, round_up
from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.sections import DefectSection

IntArray = NDArray[np.int64]
GREY, PALE, SHADE = "#55606b", "#dde2e7", "#e6e9ec"
COLOUR = {Kind.LOSS: LOSS_RED, Kind.BUMP: BUMP_BLUE, Kind.OVALITY: "#7c5100"}
CIRCLE_PX, SWING_PX = 104.0, 44.0  # the mean circle, and what the largest departure is drawn as
WIDE_PX, HIGH_PX = 330.0, 320.0


def drawing(body: str, box: tuple[float, float, float, float], label: str, type_px: float) -> Markup:
    x, y, width, height = box
    return Markup(
        f'<svg viewBox="{x:g} {y:g} {width:g} {height:g}" role="img" aria-label="{escape(label)}" '
        f'font-family="sans-serif" font-size="{type_px:g}" fill="{INK}">{body}</svg>'
    )


def across(section: DefectSection, clock_deg: FloatArray, defect: Defect) -> tuple[Markup, float]:
    """The cross-section: departures from the mean circle about the pipe's centre, much enlarged; nominal circle, the
    pipe's own shape, k = 2. Second, how far the two rings lie from the mean circle, mm."""
    colour = COLOUR[defect.kind]
    scale = _scale(section.across, section.across_k2, section.datum)
    turn = np.radians(clock_deg)

    def at(t: FloatArray, departure: FloatArray) -> FloatArray:
        r = CIRCLE_PX + SWING_PX / scale * departure
        return np.stack([r * np.sin(t), -r * np.cos(t)], axis=-1)

    out = [_ring(departure, scale) for departure in (-scale, scale)]
    seen = np.isfinite(section.across)
    step = turn[1] - turn[0]
    for run in _runs(~seen):
        t = np.linspace(turn[run[0]] - step / 2, turn[run[0]] + (len(run) - 0.5) * step, max(len(run), 2) + 1)
        edge = np.concatenate([at(t, np.full(len(t), scale)), at(t[::-1], np.full(len(t), -scale))])
        out.append(_shape(edge, f'fill="{SHADE}"'))
    for hour in range(12):
        ends = at(np.full(2, math.radians(30.0 * hour)), np.array([scale, 1.15 * scale]))
        out.append(_line(ends, f'stroke="{GREY}" stroke-width="1"'))
    for hour in (0, 3, 6, 9):
        x, y = at(np.full(1, math.radians(30.0 * hour)), np.full(1, 1.55 * scale))[0]
        out.append(f'<text x="{x:.1f}" y="{y + 5:.1f}" text-anchor="middle">{clock_face(30.0 * hour)}</text>')
    circle = f'<circle r="{CIRCLE_PX + SWING_PX / scale * section.nominal:.1f}" fill="none" stroke="{GREY}" '
    out.append(f'{circle}stroke-width="1" stroke-dasharray="5 4"/>' if abs(section.nominal) < 1.2 * scale else "")
    out.append(_shape(at(turn, section.datum), f'fill="none" stroke="{INK}" stroke-width="0.8"'))
    for run in _runs(seen):
        line, k2 = section.across[run], np.nan_to_num(section.across_k2[run])
        t = turn[run]
        band = np.concatenate([at(t, line + k2), at(t[::-1], (line - k2)[::-1])])
        out.append(_shape(band, f'fill="{colour}" fill-opacity="0.22"'))
        out.append(_line(at(t, line), f'fill="none" stroke="{colour}" stroke-width="1.4"'))
    here = int(np.argmin(np.abs(clock_deg - section.clock_deg)))
    both = at(turn[[here, here]], np.array([section.datum[here], section.datum[here] + section.departs]))
    out.append(_line(both, f'stroke="{INK}" stroke-width="1.6"'))
    out.append(f'<circle cx="{both[1, 0]:.1f}" cy="{both[1, 1]:.1f}" r="3" fill="{INK}"/>')
    label = (
        f"Cross-section at {quoted(section.z_mm, DISTANCE)}: departure of the wall from the mean circle, up to "
        f"{quoted(scale, MEASURE)} outwards and inwards"
    )
    high, wide = CIRCLE_PX + 1.75 * SWING_PX, CIRCLE_PX + 2.0 * SWING_PX
    return drawing("".join(out), (-wide, -high, 2 * wide, 2 * high), label, 15), scale


def along(section: DefectSection, defect: Defect) -> Markup:
    """The line along the pipe through the deepest place, with k = 2 and the depth of the list."""
    colour = COLOUR[defect.kind]
    left, right, top, bottom = 62.0, 8.0, 8.0, 46.0
    z, line, k2, datum = section.along_z, section.along, np.nan_to_num(section.along_k2), section.along_datum
    depth = (
        defect.depth_mm * (-1.0 if defect.kind is Kind.BUMP else 1.0) / (2.0 if defect.kind is Kind.OVALITY else 1.0)
    )
    level = float(np.interp(section.z_mm, z, datum)) + (0.0 if defect.kind is Kind.OVALITY else depth)
    known = np.concatenate([(line - k2)[np.isfinite(line)], (line + k2)[np.isfinite(line)], [0.0, level]])
    low, high = float(known.min()), float(known.max())
    pad = 0.08 * max(high - low, 0.2)
    low, high = low - pad, high + pad
    first, last = float(z[0]), float(max(z[-1], z[0] + 1.0))

    def at(where: FloatArray, departure: FloatArray) -> FloatArray:
        x = left + (where - first) / (last - first) * (WIDE_PX - left - right)
        y = top + (high - departure) / (high - low) * (HIGH_PX - top - bottom)
        return np.stack([x, y], axis=-1)

    begin, end = np.clip(defect.z_range_mm, first, last)
    corners = np.array([begin, end, end, begin]), np.array([low, low, high, high])
    out = [_shape(at(*corners), f'fill="{SHADE}"')]
    for value in _ticks(low, high):
        (x0, y), (x1, _) = at(np.array([first, last]), np.full(2, value))
        out.append(f'<line x1="{x0:.1f}" x2="{x1:.1f}" y1="{y:.1f}" y2="{y:.1f}" stroke="{PALE}"/>')
        out.append(f'<text x="{left - 6:.0f}" y="{y + 4:.1f}" text-anchor="end">{digits(value, MEASURE)}</text>')
    for value in _ticks(first, last):
        x = at(np.array([value]), np.array([low]))[0, 0]
        foot = HIGH_PX - bottom
        out.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{foot:.1f}" y2="{foot + 4:.1f}" stroke="{GREY}"/>')
        out.append(f'<text x="{x:.1f}" y="{foot + 17:.1f}" text-anchor="middle">{digits(value, DISTANCE)}</text>')
    out.append(_line(at(z, datum), f'fill="none" stroke="{INK}" stroke-width="0.8"'))
    seen = np.isfinite(line)
    for run in _runs(seen, closed=False):
        band = np.concatenate([at(z[run], (line + k2)[run]), at(z[run][::-1], (line - k2)[run][::-1])])
        out.append(_shape(band, f'fill="{colour}" fill-opacity="0.22"'))
        out.append(_line(at(z[run], line[run]), f'fill="none" stroke="{colour}" stroke-width="1.4"'))
    if defect.kind is not Kind.OVALITY:
        out.append(_line(at(np.array([begin, end]), np.full(2, level)), f'stroke="{INK}" stroke-dasharray="5 4"'))
    x, y = at(np.array([section.z_mm]), np.array([float(np.interp(section.z_mm, z[seen], line[seen]))]))[0]
    out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{INK}"/>')
    out.append(
        f'<text x="{WIDE_PX - right:.0f}" y="{HIGH_PX - 6:.0f}" text-anchor="end" fill="{GREY}">distance, m</text>'
        f'<text x="12" y="{(HIGH_PX - bottom) / 2:.0f}" text-anchor="middle" fill="{GREY}" '
        f'transform="rotate(-90 12 {(HIGH_PX - bottom) / 2:.0f})">departure, mm</text>'
    )
    label = (
        f"Line along the pipe at clock {clock_face(section.clock_deg)}: departure of the wall from the mean circle, "
        f"from {quoted(first, DISTANCE)} to {quoted(last, DISTANCE)}"
    )
    return drawing("".join(out), (0, 0, WIDE_PX, HIGH_PX), label, 13)


def _scale(line: FloatArray, k2: FloatArray, datum: FloatArray) -> float:
    known = np.isfinite(line)
    most = max(float(np.abs(line[known]).max(initial=0.0)), float(np.abs(datum).max()))
    wide = float(np.nan_to_num(k2[known]).max(initial=0.0))
    return round_up(max(most + min(wide, most), 0.2))


def _ring(departure: float, scale: float) -> str:
    radius = CIRCLE_PX + SWING_PX / scale * departure
    return f'<circle r="{radius:.1f}" fill="none" stroke="{PALE}" stroke-width="1"/>'


def _runs(mask: BoolArray, *, closed: bool = True) -> Iterator[IntArray]:
    """Indices of what lies side by side; round the clock where `closed`."""
    n = len(mask)
    if mask.all():
        yield np.append(np.arange(n), 0) if closed else np.arange(n)
        return
    start = int(np.argmin(mask)) if closed else 0
    order = (np.arange(n) + start) % n
    inside = np.flatnonzero(mask[order])
    if len(inside):
        for run in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1):
            yield order[run]


def _ticks(low: float, high: float) -> Sequence[float]:
    wanted = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(wanted))
    step = power * next(k for k in (1, 2, 5, 10) if k * power >= wanted)
    return [step * k for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _points(line: FloatArray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in line)


def _line(line: FloatArray, style: str) -> str:
    return f'<polyline points="{_points(line)}" {style}/>'


def _shape(line: FloatArray, style: str) -> str:
    return f'<polygon points="{_points(line)}" {style}/>'
