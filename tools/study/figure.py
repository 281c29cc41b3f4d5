"""What a figure of the study comes down to: numbers, and a drawing that is made only when somebody wants it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
DPI = 110


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """`numbers` carry their unit in their name. `draw` fills a matplotlib figure of `size_in` inches."""

    numbers: Mapping[str, float]
    draw: Callable[[Any], None]
    size_in: tuple[float, float] = (11.0, 4.0)

    def save(self, path: Path) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=self.size_in, layout="constrained")
        self.draw(figure)
        figure.savefig(path, dpi=DPI)


def show_map(
    axes: Any,
    values: FloatArray,
    x_mm: FloatArray,
    y_mm: FloatArray,
    title: str,
    limits: tuple[float, float],
    colours: str = "gray",
) -> Any:
    """An image [y, x] with mm axes, y downwards as in the solver."""
    dx, dy = 0.5 * float(x_mm[1] - x_mm[0]), 0.5 * float(y_mm[1] - y_mm[0])
    shown = axes.imshow(
        values,
        extent=(x_mm[0] - dx, x_mm[-1] + dx, y_mm[-1] + dy, y_mm[0] - dy),
        cmap=colours,
        vmin=limits[0],
        vmax=limits[1],
        interpolation="nearest",
    )
    axes.set(xlabel="x, mm", ylabel="y, mm", aspect="equal")
    axes.set_title(title, fontsize=9)
    return shown


def show_trace(axes: Any, times_us: FloatArray, values: FloatArray, title: str, **style: Any) -> None:
    axes.plot(times_us, values, lw=0.8, **style)
    axes.set(xlabel="time, us")
    axes.set_title(title, fontsize=9)


def profile(values: FloatArray, at_mm: FloatArray, where_mm: float, axis: int) -> FloatArray:
    """The line of an image [y, x] nearest to `where_mm`: axis 0 a row, 1 a column."""
    return np.asarray(np.take(values, int(np.argmin(np.abs(at_mm - where_mm))), axis=axis))
