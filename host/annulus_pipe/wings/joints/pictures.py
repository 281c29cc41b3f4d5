"""A joint's features and maps as files: features.json, maps.npz and pictures like Figures 9.10 and 9.49 to 9.51.

And what its dogbones' strengths have to do with them: correlate.json, correlate.png.
"""

import contextlib
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.report.names import BUMP_BLUE, FAINT, INK, LOSS_RED, UNSEEN
from annulus_pipe.report.paper import WIDTH_IN, in_style, png
from annulus_pipe.vocabulary import AnnulusError

BESIDE_MM = 12.0  # shown beside the fusion plane
MARKS = {"void": "o", "grain": "^", "gap": "_"}


@contextlib.contextmanager
def _into(folder: Path) -> Iterator[None]:
    """The folder, made if need be. AnnulusError where it or what goes into it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise AnnulusError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None


def write_joint(
    folder: Path, features: Mapping[str, Any], maps: Mapping[str, FloatArray], summary: Mapping[str, Any]
) -> list[Path]:
    """Writes all files of a joint into the folder, made if need be; their paths."""
    with _into(folder):
        content = {name: _plain(value) for name, value in features.items()} | {
            "units": "mm, degrees",
            "summary": dict(summary),
        }
        (folder / "features.json").write_text(json.dumps(content, allow_nan=False))
        np.savez_compressed(folder / "maps.npz", **{k: v.astype(np.float32) for k, v in maps.items()})  # type: ignore[arg-type]
        with in_style():
            pictures = {
                "density.png": _density(features, maps),
                "beads.png": _beads(features, maps),
                "features.png": _curves(features),
            }
            for name, figure in pictures.items():
                (folder / name).write_bytes(png(figure))
    return [folder / name for name in ("features.json", "maps.npz", *pictures)]


def write_correlation(
    folder: Path, correlation: Mapping[str, Any], curves: Mapping[str, FloatArray], chance: Mapping[str, FloatArray]
) -> list[Path]:
    """Writes correlate.json and correlate.png into the folder; their paths.

    correlation : what correlate.json holds; its `features` by name are drawn. curves : (P,) smoothed features, even
    round the pipe. chance : (N,) greatest |r| by chance.
    """
    with _into(folder):
        (folder / "correlate.json").write_text(json.dumps(_plain(correlation), allow_nan=False))
        with in_style():
            (folder / "correlate.png").write_bytes(png(_relations(correlation, curves, chance)))
    return [folder / "correlate.json", folder / "correlate.png"]


def write_scan(
    folder: Path,
    joint: Mapping[str, Any],
    microwave: Mapping[str, Any],
    features: Mapping[str, Any],
    maps: Mapping[str, FloatArray],
    laid: Mapping[str, FloatArray],
) -> list[Path]:
    """A raster laid on a joint: `microwave` in features.json, scan.npz and scan.png; their paths.

    joint : what features.json says. microwave : what becomes its `microwave`. laid : (Z, P) maps by name, on the grid
    of `maps`, `joint_..` and `material_..` of each channel.
    """
    with _into(folder):
        beside = folder / ".features.json.part"
        beside.write_text(json.dumps({**joint, "microwave": _plain(microwave)}, allow_nan=False))
        beside.replace(folder / "features.json")
        axes = {name: maps[name] for name in ("z_mm", "phi_deg")}
        np.savez_compressed(folder / "scan.npz", **{k: v.astype(np.float32) for k, v in (axes | dict(laid)).items()})  # type: ignore[arg-type]
        with in_style():
            (folder / "scan.png").write_bytes(png(_scan(microwave, features, maps, laid)))
    return [folder / name for name in ("features.json", "scan.npz", "scan.png")]


def write_clusters(folder: Path, clusters: Mapping[str, Any]) -> list[Path]:
    """clusters.json and clusters.png in the folder, made if need be; their paths. clusters : what the first holds."""
    with _into(folder):
        (folder / "clusters.json").write_text(json.dumps(_plain(clusters), allow_nan=False))
        with in_style():
            (folder / "clusters.png").write_bytes(png(_clusters(clusters)))
    return [folder / name for name in ("clusters.json", "clusters.png")]


def _clusters(clusters: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(0.75 * WIDTH_IN, 0.55 * WIDTH_IN), layout="constrained")
    axes = figure.subplots()
    values, names = np.asarray(clusters["values"], float), clusters["features"]
    y = (
        values[:, 1]
        if len(names) > 1
        else np.array([clusters["joints"].index(one) for one in clusters["joint"]], float)
    )
    for is_good, colour, word in ((True, BUMP_BLUE, "good"), (False, LOSS_RED, "bad")):
        mine = np.array([one == is_good for one in clusters["good"]])
        axes.plot(values[mine, 0], y[mine], "o", color=colour, ms=6, label=word)
    wrong = np.array([called != true for called, true in zip(clusters["called_good"], clusters["good"], strict=True)])
    axes.plot(values[wrong, 0], y[wrong], "o", mfc="none", mec=INK, ms=12, label="told wrongly by the other joints")
    axes.set(xlabel=f"{names[0]}, mean over a dogbone", ylabel=f"{names[1]}, the same" if len(names) > 1 else "joint")
    axes.set_title(
        f"Each joint told by the others: {100 * clusters['balanced']:.0f} % of good and bad alike (guessing 50), "
        f"p {clusters['p']:.3f}",
        fontsize=10,
    )
    axes.legend(fontsize=8)
    return figure


def write_transmission(folder: Path, transmission: Mapping[str, Any], curves: Mapping[str, FloatArray]) -> list[Path]:
    """transmission.json and transmission.png in the folder, made if need be; their paths.

    transmission : what transmission.json holds, `dogbone_deg` and the numbers by dogbone among it. curves : z_mm (Z,),
    and absorbance, gradient, deviation (n, Z), drawn.
    """
    with _into(folder):
        (folder / "transmission.json").write_text(json.dumps(_plain({**transmission, **curves}), allow_nan=False))
        with in_style():
            (folder / "transmission.png").write_bytes(png(_transmission(transmission, curves)))
    return [folder / name for name in ("transmission.json", "transmission.png")]


def write_strip(
    folder: Path, strip: Mapping[str, Any], z_mm: FloatArray, across_mm: FloatArray, section: Float32Array
) -> list[Path]:
    """strip.json and strip.png in the folder, made if need be; their paths.

    strip : what strip.json holds. section : (Z, R) grey of the strip's middle, along it and through its thickness, mm.
    """
    with _into(folder):
        (folder / "strip.json").write_text(json.dumps(_plain(strip), allow_nan=False))
        with in_style():
            figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
            axes = figure.subplots()
            wall = np.abs(across_mm) < 0.4 * strip["wall_mm"]
            low, high = np.percentile(section[:, wall], (1, 99))
            box = (z_mm[0], z_mm[-1], across_mm[0], across_mm[-1])
            axes.imshow(section.T, cmap="gray", origin="lower", extent=box, vmin=low - 0.5 * (high - low), vmax=high)
            for way in (-0.5, 0.5):
                if math.isfinite(strip["W_mm"]):
                    axes.axvline(strip["joint_mm"] + way * strip["W_mm"], color=LOSS_RED, lw=1.2)
            title = ", ".join(
                f"{name} not told"
                if not math.isfinite(strip[f"{name}_mm"])
                else f"{name} {strip[f'{name}_mm']:.2f} ± {2 * strip[f'{name}_sigma_mm']:.2f} mm"
                for name in ("W", "T")
            )
            axes.set_title(f"{title} (k=2)")
            axes.set(xlabel="along the strip, mm", ylabel="through it, mm")
            (folder / "strip.png").write_bytes(png(figure))
    return [folder / name for name in ("strip.json", "strip.png")]


def _transmission(transmission: Mapping[str, Any], curves: Mapping[str, FloatArray]) -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 7.5), layout="constrained")
    panels = figure.subplots(3, sharex=True)
    angles, energy = transmission["dogbone_deg"], transmission.get("energy_j")
    weak = [INK if energy is None or one > np.median(energy) else LOSS_RED for one in energy or angles]
    for axes, (name, label, most) in zip(
        panels,
        (
            ("absorbance", "absorbance over plain wall", None),
            ("gradient", "smoothed gradient, 1/mm", transmission["plain_gradient_per_mm"]),
            ("deviation", "deviation within 2 mm", transmission["plain_deviation"]),
        ),
        strict=True,
    ):
        for angle, line, colour in zip(angles, curves[name], weak, strict=True):
            axes.plot(curves["z_mm"], line, color=colour, lw=0.9)
            peak = int(np.nanargmax(np.abs(line)))
            axes.annotate(f"{angle:g}", (curves["z_mm"][peak], line[peak]), fontsize=7, color=colour)
        axes.axvspan(*transmission["joint_mm"], color=FAINT, alpha=0.15, lw=0)
        for level in () if most is None else (most, -most) if name == "gradient" else (most,):
            axes.axhline(level, color=FAINT, lw=0.8, ls=":")
        axes.set_ylabel(label)
    panels[0].set_title(
        "Light through dogbones, aligned; numbers: degrees" + ("; red: the weaker half" if energy is not None else ""),
        fontsize=10,
    )
    panels[-1].set_xlabel("along the pipe, mm; dotted: what 1 in 400 of plain wall's own exceed")
    return figure


def _scan(
    microwave: Mapping[str, Any],
    features: Mapping[str, Any],
    maps: Mapping[str, FloatArray],
    laid: Mapping[str, FloatArray],
) -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 0.6 + 2.6 * len(laid)), layout="constrained")
    middle = float(np.mean(features["zj"]))
    height = maps["z_mm"] - middle
    near = np.abs(height) <= BESIDE_MM
    panels = figure.subplots(len(laid), sharex=True, squeeze=False)[:, 0]
    for axes, (name, values) in zip(panels, laid.items(), strict=True):
        part, _, channel = name.partition("_")
        least, most = np.nanpercentile(values[near], (0.5, 99.5)) if np.isfinite(values[near]).any() else (0.0, 1.0)
        drawn = _map(axes, features, maps, values, least, most, "gray")
        figure.colorbar(drawn, ax=axes, label="mV")
        word = channel.removesuffix("_mv")
        if part == "joint":
            bead = maps["bead_out_mm"][near]
            steps = [share * float(bead.max()) for share in (0.1, 0.5, 0.9)]
            axes.contour(features["phi_deg"], height[near], bead, steps, colors=LOSS_RED, linewidths=0.8)
            axes.set_title(
                f"Probe's {word} over plain wall; red: the CT's bead, 10, 50, 90 % of its height", fontsize=10
            )
        else:
            for edge in (-0.5, 0.5):
                axes.plot(features["phi_deg"], features["zj"] - middle + edge * features["W"], color=LOSS_RED, lw=1.0)
            axes.set_title(f"Probe's {word}, the bead's share taken out; red: the CT's heat-affected zone", fontsize=10)
        axes.set_ylim(BESIDE_MM, -BESIDE_MM)
    panels[-1].set_xlabel("angle, degrees from the volume's x to its y")
    figure.suptitle(
        f"shift {microwave['shift_deg']:.1f} deg, sigma {microwave['shift_sigma_deg']:.1f}, sense {microwave['sense']}"
        + ("" if microwave["accepted"] else ": NOT ACCEPTED as of this joint"),
        fontsize=11,
    )
    return figure


def _relations(
    correlation: Mapping[str, Any], curves: Mapping[str, FloatArray], chance: Mapping[str, FloatArray]
) -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 0.6 + 2.9 * len(curves)), layout="constrained")
    rows = figure.subplots(len(curves), 2, squeeze=False, width_ratios=(2, 1))
    energy = np.array(correlation["energy_j"])
    for (along, odds), (name, curve) in zip(rows, curves.items(), strict=True):
        one = correlation["features"][name]
        along.plot(np.linspace(0, 360, len(curve), endpoint=False), curve, color=INK, lw=1.2)
        at = (one["sense"] * np.array(correlation["angle_deg"]) + one["shift_deg"]) % 360
        beside = along.twinx()
        beside.plot(at, energy, "o", color=LOSS_RED, ms=6)
        if one["r"] < 0:
            beside.invert_yaxis()
        beside.set_ylabel("strength, J" + (", downwards" if one["r"] < 0 else ""), color=LOSS_RED)
        along.set(xlim=(0, 360), xticks=range(0, 361, 45), ylabel=f"{name}, moving mean")
        along.set_title(
            f"{name}: best r {one['r']:+.2f}, shift {one['shift_deg']:+.0f} deg, "
            f"{'same sense' if one['sense'] > 0 else 'mirrored'}",
            fontsize=10,
        )
        odds.hist(chance[name], bins=40, range=(0, 1), color=FAINT)
        odds.axvline(abs(one["r"]), color=LOSS_RED, lw=1.6)
        odds.set(yticks=[])
        odds.set_title(f"p over the search {one['p']:.3f}, over all tried {one['p_all']:.3f}", fontsize=10)
    rows[-1, 0].set(xlabel="angle, degrees from the volume's x to its y")
    rows[-1, 1].set(xlabel="best |r|: by chance grey, here red")
    return figure


def _plain(value: Any) -> Any:
    """Arrays as lists; what is not told, None."""
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list):
        return [_plain(v) for v in value]
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, float):
        return round(value, 5) if math.isfinite(value) else None
    return value


def _near(features: Mapping[str, Any], maps: Mapping[str, FloatArray]) -> tuple[np.ndarray, float]:
    middle = float(np.mean(features["zj"]))
    return np.abs(maps["z_mm"] - middle) <= BESIDE_MM, middle


def _map(
    axes: Axes,
    features: Mapping[str, Any],
    maps: Mapping[str, FloatArray],
    values: FloatArray,
    low: float,
    high: float,
    colours: str,
) -> Any:
    near, middle = _near(features, maps)
    z = maps["z_mm"][near] - middle
    axes.set_facecolor(UNSEEN)
    drawn = axes.imshow(
        values[near],
        extent=(0, 360, z[-1], z[0]),
        aspect="auto",
        cmap=colours,
        vmin=low,
        vmax=high,
        interpolation="nearest",
    )
    axes.plot(features["phi_deg"], features["zj"] - middle, color=INK, lw=0.6, ls=":")
    axes.set(xlim=(0, 360), ylabel="along the axis, mm", xticks=range(0, 361, 45))
    return drawn


def _density(features: Mapping[str, Any], maps: Mapping[str, FloatArray]) -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 4.2), layout="constrained")
    axes = figure.subplots()
    middle = float(np.mean(features["zj"]))
    deepest = 100 * float(np.nanmax(1 - features["haz"], initial=0.01))
    drawn = _map(axes, features, maps, 100 * (maps["density"] - 1), -1.6 * deepest, 0.8 * deepest, "gray")
    figure.colorbar(drawn, ax=axes, label="density less plain wall's, %")
    for edge in (-0.5, 0.5):
        axes.plot(features["phi_deg"], features["zj"] - middle + edge * features["W"], color=LOSS_RED, lw=1.0)
    for flaw in features["found"]:
        axes.plot(flaw["phi_deg"], flaw["z"] - middle, MARKS[flaw["kind"]], mfc="none", mec=BUMP_BLUE, ms=11, mew=1.6)
        axes.annotate(
            flaw["kind"], (flaw["phi_deg"], flaw["z"] - middle), (9, 7), textcoords="offset points", color=BUMP_BLUE
        )
    axes.set(xlabel="angle, degrees from the volume's x to its y", ylim=(BESIDE_MM, -BESIDE_MM))
    axes.set_title("Density of the wall, mean over its inner part; red: heat-affected zone", fontsize=10)
    return figure


def _beads(features: Mapping[str, Any], maps: Mapping[str, FloatArray]) -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 6.4), layout="constrained")
    high = max(float(np.nanmax(np.concatenate([features["ho"], features["hi"]]), initial=0.1)), 0.1)
    for axes, name, word in zip(
        figure.subplots(2, sharex=True), ("bead_out_mm", "bead_in_mm"), ("outside", "inside"), strict=True
    ):
        drawn = _map(axes, features, maps, maps[name], 0.0, high, "viridis")
        axes.set_title(f"Bead {word}: height over the plain wall", fontsize=10)
        figure.colorbar(drawn, ax=axes, label="mm")
    axes.set(xlabel="angle, degrees from the volume's x to its y")
    return figure


def _curves(features: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 9.0), layout="constrained")
    phi = features["phi_deg"]
    width, thick, high, aside = figure.subplots(4, sharex=True)
    for axes, name, word in ((width, "W", "width W of the zone, mm"), (thick, "T", "thickness T of the joint, mm")):
        value, sigma = features[name], features[f"{name}_sigma"]
        axes.fill_between(phi, value - 2 * sigma, value + 2 * sigma, color=FAINT, alpha=0.3, lw=0, label="two sigma")
        axes.plot(phi, value, color=INK, lw=1.2)
        axes.set_ylabel(word)
        axes.legend(frameon=False, fontsize=8, loc="upper right")
    for name, word, colour in (("o", "outside", LOSS_RED), ("i", "inside", BUMP_BLUE)):
        high.plot(phi, features[f"h{name}"], color=colour, label=f"height {word}")
        high.plot(phi, features[f"w{name}"] / 4, color=colour, ls="--", label=f"width / 4 {word}")
        aside.plot(phi, features[f"hilo_{word.removesuffix('side')}"], color=colour, label=word)
    high.set_ylabel("bead, mm")
    aside.set(
        ylabel="hi-lo, mm",
        xlabel="angle, degrees from the volume's x to its y",
        xlim=(0, 360),
        xticks=range(0, 361, 45),
    )
    for axes in (high, aside):
        axes.legend(frameon=False, fontsize=8, ncols=4, loc="upper right")
    return figure
