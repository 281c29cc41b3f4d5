"""What a camera calibration is worth, as a picture: rays, residuals, photographs."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from annulus_pipe.calibrate.camera import CameraCalibration
from annulus_pipe.vocabulary import AnnulusError

ARROW = 100.0  # times too long, so that residuals are seen


def draw_camera(result: CameraCalibration, path: Path) -> None:
    """A PNG: how well each pixel's ray is known, where targets were, and what every photograph left over."""
    camera, fit = result.camera, result.intrinsics
    figure = Figure(figsize=(13, 7.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    known, left, bars = figure.subplot_mosaic([["known", "left"], ["bars", "bars"]], height_ratios=[3, 1.3]).values()
    x, y, sigma = result.sigma_map()
    known.set_facecolor("0.75")
    top = float(min(np.nanpercentile(sigma, 98), 6 * np.nanmedian(sigma)))
    shade = known.pcolormesh(x, y, sigma, vmin=0, vmax=max(top, 1e-6), cmap="viridis_r", shading="nearest")
    if np.nanmax(sigma) > np.nanmin(sigma):
        lines = known.contour(x, y, np.ma.masked_invalid(sigma), levels=6, colors="k", linewidths=0.5)
        known.clabel(lines, fontsize=7)
    for pixels in fit.seen:
        known.plot(*pixels.T, ".", ms=1.5, color="white", alpha=0.6)
    figure.colorbar(shade, ax=known, label="px, one standard deviation")
    known.set_title("How well each pixel's ray is known (white: corners; grey: no target was there)")
    for pixels, off in zip(fit.seen, fit.residuals, strict=True):
        left.quiver(*pixels.T, *off.T, angles="xy", scale_units="xy", scale=1 / ARROW, width=0.0015)
    left.set_title(f"Residuals, {ARROW:.0f} times enlarged; rms {fit.rms_px:.3f} px")
    for axes in (known, left):
        axes.set_xlim(-0.5, camera.width - 0.5)
        axes.set_ylim(camera.height - 0.5, -0.5)
        axes.set_aspect("equal")
    shown = [p for p in result.photographs if np.isfinite(p.rms_px)]
    bars.bar(
        range(len(shown)), [p.rms_px for p in shown], color=["tab:red" if p.rejected else "tab:blue" for p in shown]
    )
    bars.set_ylim(0, 4 * max(float(np.median([p.rms_px for p in shown])), 1e-3))
    bars.set_xticks(range(len(shown)), [p.file for p in shown], rotation=60, ha="right", fontsize=7)
    bars.set_ylabel("rms, px")
    bars.set_title(f"Photographs (red: left out), {result.target}", fontsize=9)
    try:
        figure.savefig(path)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be written ({error.strerror}).") from None
