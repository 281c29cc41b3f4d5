"""What a pipe calibration leaves over, as a picture: errors round each ring, poses, held-out frames."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from annulus_pipe.calibrate.pipe import PipeCalibration, leans
from annulus_pipe.rings.calibration.observations import azimuths
from annulus_pipe.vocabulary import AnnulusError

SHADES = ("#1f4e79", "#2e86ab", "#3fb6a8", "#8fbf4d", "#e0a030", "#d1495b", "#8d3b72", "#555555")


def draw_pipe(result: PipeCalibration, path: Path) -> None:
    """A PNG: each slit's error round the cone's axis, ring by ring; where the head leant; what held-out frames say."""
    solution, seen = result.solution, result.seen
    rings = len(solution.rings)
    figure = Figure(figsize=(13, 7.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    errors, poses, bars = figure.subplot_mosaic(
        [["errors", "poses"], ["errors", "bars"]], width_ratios=[2.2, 1]
    ).values()
    turn = 360.0 * azimuths(seen, solution.rings, solution.poses, solution.radius_mm)
    most = 4.0 * float(np.nanmax(solution.sigma_px)) + 1e-6
    for k in range(rings):
        mine = np.flatnonzero((seen.ring == k) & (solution.weight > 0))
        shade = SHADES[k % len(SHADES)]
        errors.plot(turn[mine], solution.error_px[mine] + 2 * most * k, ".", ms=1.2, color=shade, alpha=0.5)
        errors.axhline(2 * most * k, color="k", lw=0.5)
    errors.set_yticks([2 * most * k for k in range(rings)], [f"ring {k + 1}" for k in range(rings)])
    errors.set_xlim(0, 360)
    errors.set_xlabel("direction about the cone's axis, degrees")
    errors.set_title(f"Where slits are seen less where they should be ({most:.2f} px up to half way to the next ring)")
    lean = leans(solution.poses)
    poses.axhline(0, color="0.8", lw=0.8)
    poses.axvline(0, color="0.8", lw=0.8)
    poses.plot(lean[:, 0], lean[:, 1], "o", color=SHADES[0])
    for index, (x, y) in zip(result.frames, lean, strict=True):
        poses.annotate(str(index), (x, y), textcoords="offset points", xytext=(4, 4), fontsize=7)
    reach = max(15.0, float(np.abs(lean).max()) * 1.15)
    poses.set_xlim(-reach, reach)
    poses.set_ylim(reach, -reach)
    poses.set_aspect("equal")
    poses.set_title("How the head leant, degrees (right, down)")
    held = [(name, one) for name, one in (("cones", result.held_out), ("corrected", result.held_out_corrected)) if one]
    width = 0.8 / max(len(held), 1)
    for i, (name, one) in enumerate(held):
        values = [result.held_mm(one, seen.ring[:: result.held_every] == k) for k in range(rings)]
        place = np.arange(1, rings + 1) + width * (i - (len(held) - 1) / 2)
        bars.bar(place, values, width, label=name, color=SHADES[4 * i])
    if held:
        bars.set_xticks(range(1, rings + 1))
        bars.legend()
    else:
        bars.text(0.5, 0.5, "nothing held out: too few frames show a ring", ha="center", transform=bars.transAxes)
        bars.set_axis_off()
    bars.set_xlabel("ring")
    bars.set_title("Radius error in frames held out, mm rms")
    try:
        figure.savefig(path)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be written ({error.strerror}).") from None
