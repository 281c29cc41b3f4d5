"""The report's pictures, as PNG bytes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray
from scipy import ndimage

from annulus.numeric.arrays import Image
from annulus.numeric.rounding import clock_face
from annulus.report.bore import draw_lane
from annulus.report.course import draw_course
from annulus.report.feature_pictures import draw_features
from annulus.report.half_view import HALF_DEG, half_view
from annulus.report.paper import (
    BUMP_BLUE,
    DEVIATION,
    DPI,
    FAINT,
    FEATURE,
    HIDDEN,
    INK,
    LOSS_RED,
    NEAR,
    UNSEEN,
    WIDTH_IN,
    badge,
    in_style,
    letter,
    mark,
    png,
    question,
    round_up,
)
from annulus.wall.defects import ALL_ROUND_DEG, Defect, Kind
from annulus.wall.grid import Wall
from annulus.wall.stations import OVALITY_NAME
from annulus.wall.survey import Survey

SHARED = "#3f8f5b"  # what several cameras saw, and what each did
LEGEND_COLUMNS = 4
OWN = ("#e0912f", "#7a5aa6", "#2f79c4", "#b3261e", "#8a6d3b", "#4b2e83", "#0b7285", "#d6336c") * 2


@dataclass(frozen=True, slots=True)
class Pictures:
    """PNG files as bytes; `deviation_rgb` is the map's colour of every cell, (Z, A, 3) uint8; `scale_mm` its ends."""

    unwrapped: bytes
    texture: bytes
    stations: bytes
    surface: tuple[tuple[str, bytes], ...]  # caption, picture
    deviation_rgb: Image
    scale_mm: float
    features: tuple[tuple[str, bytes], ...]  # letter or question mark, picture
    course: bytes | None  # of a pipe that is not one straight, even tube
    cameras: bytes | None  # which of several saw what, and how well
    lane: bytes | None = None  # of sectors that look through the wall


def draw(survey: Survey) -> Pictures:
    """Every picture of one report."""
    deviation = survey.wall.deviation_mm()
    scale = _scale(survey, deviation)
    filled = np.nan_to_num(deviation, nan=0.0)
    rgb = (DEVIATION(Normalize(-scale, scale)(filled))[..., :3] * 255).astype(np.uint8)
    rgb[~np.isfinite(deviation)] = np.round(255 * np.array(to_rgb(UNSEEN)))  # seen, but beside no circle that is known
    with in_style():
        return Pictures(
            _unwrapped(survey, deviation, scale), _texture(survey), _stations(survey), _surface(survey, rgb), rgb,
            scale, draw_features(survey), draw_course(survey),
            _cameras(survey) if len(survey.cameras) > 1 else None,
            None if survey.lane is None else draw_lane(survey.lane),
        )  # fmt: skip


def _scale(survey: Survey, deviation: NDArray[np.float32]) -> float:
    """Ends of the colour bar, mm: a round number that holds the deepest defect and never shows bare noise as colour."""
    largest = max((d.depth_mm / (2 if d.kind is Kind.OVALITY else 1) for d in survey.defects), default=0.0)
    seen = np.abs(deviation[np.isfinite(deviation)])
    usual = float(np.percentile(seen, 99)) if len(seen) else 0.0
    wanted = max(largest, usual, 10 * survey.noise_mm, 0.5)
    return round_up(wanted)


class _Axis:
    """Distance along the pipe for people: mm on short scans, m on long ones."""

    def __init__(self, wall: Wall) -> None:
        first, last = wall.extent[:2]
        self.per_mm, self.unit = (1e-3, "m") if last - first > 3000 else (1.0, "mm")
        self.limits = first * self.per_mm, last * self.per_mm
        self.label = f"distance along the pipe, {self.unit}"


def _map_figure(wall: Wall, axis: _Axis) -> tuple[Figure, Any]:
    ratio = 2 * np.pi * wall.mean_radius_mm / max(float(np.ptp(wall.z_mm)), 1.0)
    height = float(np.clip(WIDTH_IN * 0.8 * ratio, 3.6, 6.0))  # true to scale where that fits a page
    figure = Figure(figsize=(WIDTH_IN, height), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    _lay_map(axes, axis)
    axes.set_xlabel(axis.label)
    return figure, axes


def _lay_map(axes: Any, axis: _Axis) -> None:
    """Distance against clock position; what is drawn on it nowhere was not seen."""
    axes.set_facecolor(UNSEEN)
    axes.set_xlim(*axis.limits)
    axes.set_ylim(360, 0)
    axes.set_yticks(range(0, 361, 30), labels=[f"{h % 12 or 12}:00" if h % 3 == 0 else "" for h in range(13)])
    axes.set_ylabel("clock position, looking forward")
    axes.add_patch(
        Rectangle(
            (axis.limits[0], 0), axis.limits[1] - axis.limits[0], 360, fill=False, hatch="////", ec="#aab1b9", lw=0
        )
    )
    axes.grid(axis="y", color=INK, alpha=0.10, lw=0.6)


def _unwrapped(survey: Survey, deviation: NDArray[np.float32], scale: float) -> bytes:
    wall = survey.wall
    axis = _Axis(wall)
    figure, axes = _map_figure(wall, axis)
    extent = (*axis.limits, 360.0, 0.0)
    image = axes.imshow(
        np.ma.masked_invalid(deviation.T), cmap=DEVIATION, vmin=-scale, vmax=scale, extent=extent, aspect="auto",
        interpolation="nearest", zorder=2,
    )  # fmt: skip
    axes.imshow(
        np.ma.masked_equal(survey.shadowed.T, False), cmap=ListedColormap([HIDDEN]), extent=extent, aspect="auto",
        interpolation="nearest", zorder=3,
    )  # fmt: skip
    _outline(axes, survey, axis)
    bar = figure.colorbar(image, ax=axes, pad=0.015, fraction=0.035, aspect=28)
    bar.set_label("deviation of the radius, mm\n− into the pipe        outwards +")
    axes.set_title(
        f"Wall deviation from the mean circle, Ø {2 * wall.mean_radius_mm:.2f} mm   "
        "(hatched grey: not seen; dark grey: hidden by a step)",
        loc="left", fontsize=11, pad=24,
    )  # fmt: skip
    return png(figure)


def _texture(survey: Survey) -> bytes:
    axis = _Axis(survey.wall)
    figure, axes = _map_figure(survey.wall, axis)
    if survey.texture is None:
        axes.text(0.5, 0.5, f"no usable frames in {survey.light}", transform=axes.transAxes, ha="center", fontsize=13)
    else:
        axes.imshow(
            survey.texture.swapaxes(0, 1), extent=(*axis.limits, 360.0, 0.0), aspect="auto",
            interpolation="antialiased", zorder=2,
        )  # fmt: skip
    _outline(axes, survey, axis)
    axes.set_title(
        f"Wall in {survey.light}, brightness evened out   (hatched grey: not seen)", loc="left", fontsize=11, pad=24
    )
    return png(figure)


def _cameras(survey: Survey) -> bytes:
    """Which camera saw each cell, and how well those that did know its radius."""
    wall, axis = survey.wall, _Axis(survey.wall)
    figure = Figure(figsize=(WIDTH_IN, 7.0), dpi=DPI, layout="constrained")
    both = figure.subplots(2, 1, sharex=True)
    for axes in both:
        _lay_map(axes, axis)
    who = wall.seen_by(len(survey.cameras))
    names = [*(f"camera {one} alone" for one in survey.cameras), "more than one"]
    shades = [*OWN[: len(survey.cameras)], SHARED]
    extent, more = (*axis.limits, 360.0, 0.0), len(names) + 0.5
    both[0].imshow(
        np.ma.masked_equal(who.T, 0), cmap=ListedColormap(shades[: len(names)]), vmin=0.5, vmax=more, extent=extent,
        aspect="auto", interpolation="nearest", zorder=2,
    )  # fmt: skip
    both[0].imshow(
        np.ma.masked_equal(survey.shadowed.T, False), cmap=ListedColormap([HIDDEN]), extent=extent, aspect="auto",
        interpolation="nearest", zorder=3,
    )  # fmt: skip
    share = survey.seen_by_fraction()
    patches = [
        Patch(color=shade, label=f"{name}: {100 * part:.1f} %")
        for shade, name, part in zip(shades, names, share.values(), strict=False)
    ]
    none = f"none: {100 * (1 - survey.seen_fraction):.1f} %"
    patches += [Patch(color=HIDDEN, label="hidden by a step"), Patch(fc=UNSEEN, hatch="////", ec="#aab1b9", label=none)]
    columns = min(len(patches), LEGEND_COLUMNS)
    lines = -(-len(patches) // columns)
    both[0].legend(
        handles=patches, loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=columns, frameon=False, fontsize=8.5
    )
    both[0].set_title("Which camera saw the wall", loc="left", fontsize=11, pad=24 + 16 * (lines - 1))
    sigma = wall.sigma_mm
    known = sigma[np.isfinite(sigma)]
    top = round_up(float(np.percentile(known, 98))) if len(known) else 1.0
    shown = both[1].imshow(
        np.ma.masked_invalid(sigma.T), cmap="viridis_r", vmin=0, vmax=top, extent=extent, aspect="auto",
        interpolation="nearest", zorder=2,
    )  # fmt: skip
    both[1].set_title("How well a point's radius is known, one standard deviation", loc="left", fontsize=11)
    both[1].set_xlabel(axis.label)
    figure.colorbar(shown, ax=both[1], pad=0.015, fraction=0.035, aspect=28).set_label("mm")
    return png(figure)


def _outline(axes: Any, survey: Survey, axis: _Axis) -> None:
    """Draws around every defect and gives it its number in the table; features have letters."""
    mark(axes, survey, axis.per_mm)
    wall = survey.wall
    z = wall.z_mm * axis.per_mm
    span = axis.limits[1] - axis.limits[0]
    for number, defect in enumerate(survey.defects, start=1):
        first, last = (value * axis.per_mm for value in defect.z_range_mm)
        if defect.kind is Kind.OVALITY:
            axes.annotate(
                "", (first, -6), (last, -6), annotation_clip=False,
                arrowprops={"arrowstyle": "|-|", "lw": 1.2, "color": INK},
            )  # fmt: skip
            badge(axes, (first + last) / 2, -6, str(number))
            continue
        mask = (survey.detection.label == number).astype(float)
        mask = ndimage.gaussian_filter(mask, 1.0, mode=("nearest", "wrap"))  # for the eye; the table has the figures
        wide = np.concatenate([mask[:, -1:], mask, mask[:, :1]], axis=1)
        clock = np.concatenate([[-wall.clock_step_deg / 2], wall.clock_deg, [360 + wall.clock_step_deg / 2]])
        for width, colour in ((3.2, "white"), (1.3, INK)):
            axes.contour(z, clock, wide.T, levels=[0.5], colors=colour, linewidths=width, zorder=4)
        top = defect.clock_deg - min(defect.arc_deg, 350) / 2
        x = float(np.clip((first + last) / 2, axis.limits[0] + 0.015 * span, axis.limits[1] - 0.015 * span))
        y = top - 11 if 15 < top < 360 else defect.clock_deg + min(defect.arc_deg, 330) / 2 + 11
        badge(axes, x, float(np.clip(y, 11, 349)), str(number))


def _stations(survey: Survey) -> bytes:
    stations, nominal_mm = survey.stations, survey.nominal_diameter_mm
    axis = _Axis(survey.wall)
    figure = Figure(figsize=(WIDTH_IN, 5.4), dpi=DPI, layout="constrained")
    top, middle, low = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 1))
    z = stations.z_mm * axis.per_mm
    top.fill_between(
        z,
        stations.diameter_min_mm,
        stations.diameter_max_mm,
        color="#9fb8d1",
        alpha=0.6,
        lw=0,
        label="smallest to largest",
    )
    top.plot(z, stations.diameter_min_mm, color=BUMP_BLUE, lw=1.0, label="smallest")
    top.plot(z, stations.diameter_max_mm, color=LOSS_RED, lw=1.0, label="largest")
    top.plot(z, stations.diameter_mean_mm, color=INK, lw=1.8, label="mean")
    top.axhline(nominal_mm, color=FAINT, lw=0.9, ls=(0, (5, 4)), label=f"calibrated pipe {nominal_mm:.1f} mm")
    top.set_ylabel("diameter, mm")
    top.ticklabel_format(axis="y", useOffset=False)
    middle.plot(z, stations.ovality_percent, color=FAINT, lw=1.0, label="as measured, defects included")
    middle.plot(z, stations.shape_ovality_percent, color=INK, lw=1.8, label="pipe's shape, defects left out")
    limit = survey.detection.limits.ovality_percent
    middle.axhline(limit, color=LOSS_RED, lw=0.9, ls=(0, (5, 4)), label=f"listed above {limit:g} %")
    middle.set_ylabel(f"ovality, %\n({OVALITY_NAME})")
    middle.set_ylim(bottom=0)
    low.fill_between(z, 100 * stations.valid_fraction, step="mid", color="#7d94a8", alpha=0.8, lw=0)
    low.set_ylim(0, 100)
    low.set_ylabel("seen, %")
    low.set_xlabel(axis.label)
    low.set_xlim(*axis.limits)
    for axes in (top, middle, low):
        axes.grid(color=INK, alpha=0.10, lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        for defect in survey.defects:
            if defect.kind is not Kind.OVALITY:
                first, last = (value * axis.per_mm for value in defect.z_range_mm)
                axes.axvspan(first, last, color=LOSS_RED if defect.kind is Kind.LOSS else BUMP_BLUE, alpha=0.08, lw=0)
        for feature in survey.features:
            if feature.arc_deg >= ALL_ROUND_DEG:
                axes.axvspan(*(value * axis.per_mm for value in feature.z_range_mm), color=FEATURE, alpha=0.10, lw=0)
    for at, names in _named(survey, axis):
        top.text(
            at, 1.01, ", ".join(names), transform=top.get_xaxis_transform(), ha="center", va="bottom", fontsize=9,
            fontweight="bold",
        )  # fmt: skip
    for axes in (top, middle):
        axes.legend(loc="upper left", bbox_to_anchor=(1.005, 1.0), frameon=False, fontsize=8.5)
    return png(figure)


def _named(survey: Survey, axis: _Axis) -> list[tuple[float, list[str]]]:
    """Where along the pipe something has a name, and which; those close together share a place."""
    low, high = axis.limits
    all_of_them = [
        *((one.z_mm, str(i)) for i, one in enumerate(survey.defects, start=1)),
        *((one.z_mm, letter(i)) for i, one in enumerate(survey.features)),
        *((one.z_mm, question(i)) for i, one in enumerate(survey.detection.undecided)),
    ]
    groups: list[tuple[float, list[str]]] = []
    for z, name in sorted(all_of_them, key=lambda one: one[0]):
        at = float(np.clip(z * axis.per_mm, low, high))
        if groups and at - groups[-1][0] < NEAR * (high - low):
            groups[-1][1].append(name)
        else:
            groups.append((at, [name]))
    return groups


def _surface(survey: Survey, rgb: Image) -> tuple[tuple[str, bytes], ...]:
    """Both halves of the pipe; of a long scan the stretch about the deepest local defect."""
    wall = survey.wall
    local = [defect for defect in survey.defects if defect.kind is not Kind.OVALITY]
    reach = 6.0 * wall.mean_radius_mm
    middle = max(local, key=lambda d: d.depth_mm).z_mm if local else float(wall.z_mm.mean())
    if np.ptp(wall.z_mm) <= 2 * reach:
        rows = slice(0, len(wall.z_mm))
    else:
        middle = float(np.clip(middle, wall.z_mm[0] + reach, wall.z_mm[-1] - reach))
        rows = slice(*(int(k) for k in np.searchsorted(wall.z_mm, (middle - reach, middle + reach))))
    out = []
    middle_deg = _best_cut(local)
    for clock in (middle_deg, middle_deg + 180.0):
        begin, end = (clock_face(clock + offset) for offset in (-90, 90))
        out.append((f"the half around {clock_face(clock)}, from {begin} to {end}", _half(wall, rgb, rows, clock % 360)))
    return tuple(out)


def _best_cut(local: list[Defect]) -> float:
    """Middle of the first half (deg), a whole hour: the pipe is cut far from defects, at 3 and 9 where it may."""
    hours = [180.0, *(30.0 * hour for hour in range(12))]

    def room(middle: float) -> float:
        gaps = [
            abs((defect.clock_deg - cut + 180) % 360 - 180) - defect.arc_deg / 2
            for defect in local if defect.arc_deg < 180
            for cut in (middle - 90, middle + 90)
        ]  # fmt: skip
        return min(min(gaps, default=20.0), 20.0)

    return max(hours, key=room)


def _half(wall: Wall, rgb: Image, rows: slice, clock_deg: float) -> bytes:
    """One half with hours at its ends and distances along its rim."""
    view = half_view(wall, rgb, rows, clock_deg)
    height, width = view.image.shape[:2]
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(view.image, interpolation="antialiased")
    axes.set_axis_off()
    first, last = float(wall.z_mm[rows][0]), float(wall.z_mm[rows][-1])

    def at(clock: float, z: float, out: float) -> tuple[float, float]:
        t, r = np.radians(clock), wall.mean_radius_mm * out
        x, y = view.project(np.array([[r * np.sin(t), -r * np.cos(t), z]]))[0]
        return float(x), float(y)

    for offset in (-90, -45, 0, 45, 90):
        clock = (clock_deg + offset) % 360
        for z, shift in ((first, -1), (last, 1)):
            x, y = at(clock, z, 1.0)
            axes.text(
                x + 12 * shift, y, clock_face(clock), ha="right" if shift < 0 else "left", va="center", fontsize=10
            )
    step = round_up((last - first) / 6)
    rim = clock_deg + HALF_DEG  # the nearer of the two rims
    free = -np.inf  # px: where a short stretch has no room for a label at every mark
    for z in np.arange(np.ceil(first / step) * step, last + 1e-6, step):
        (x0, y0), (x1, y1) = at(rim, z, 1.0), at(rim, z, 1.06)
        axes.plot([x0, x1], [y0, y1], color=INK, lw=0.5)
        x, y = at(rim, z, 1.13)
        text = f"{z:g} mm"
        half = 0.35 * len(text) * 10 * DPI / 72
        if x - half > free:
            axes.text(x, y, text, ha="center", va="center", fontsize=10, color=FAINT)
            free = x + half
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    return png(figure)
