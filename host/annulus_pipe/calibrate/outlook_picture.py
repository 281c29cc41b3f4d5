"""Where each camera of a head knows the wall, and all of them together, as a picture for several pipes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from annulus_pipe.stereo.outlook import COVERED, Outlook
from annulus_pipe.vocabulary import AnnulusError

SHADES = ("#9aa5b1", "#c9a227", "#6b8e6b", "#8d3b72")


def draw_outlook(pipes: Sequence[Outlook], cameras: Sequence[int], path: Path) -> None:
    """A PNG: sigma of the radius round the projector, the worst ring's, a panel a pipe."""
    figure = Figure(figsize=(4.6 * len(pipes), 4.6), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(pipes), squeeze=False)[0]
    for axes, pipe in zip(panels, pipes, strict=True):
        turn = np.arange(pipe.sigma_mm.shape[2]) * (360.0 / pipe.sigma_mm.shape[2])
        limit = COVERED * pipe.radius_mm
        for number, (camera, sigma) in enumerate(zip(cameras, pipe.sigma_mm, strict=False)):
            worst = np.minimum(sigma.max(axis=0), 100 * limit)
            axes.semilogy(turn, worst, color=SHADES[number % 4], label=f"camera {camera} alone")
        axes.semilogy(turn, np.minimum(pipe.worst_mm, 100 * limit), color="#1f4e79", lw=2, label="together")
        axes.axhline(limit, color="#d1495b", lw=1, ls="--", label=f"{100 * COVERED:g} % of the radius")
        axes.set_xlim(0, 360)
        axes.set_xlabel("direction round the projector, degrees")
        axes.set_title(f"{2 * pipe.radius_mm:g} mm: {'covered' if pipe.is_covered else 'not covered'}")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("sigma of the radius, worst ring, mm")
    panels[0].legend(fontsize=8)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be written ({error.strerror}).") from None
