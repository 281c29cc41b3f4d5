"""The pipe's course: where a station's outline lies in space."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from annulus_pipe.export.results import Results
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.storage.results_folder import MM_MAX
from annulus_pipe.untrusted import mapping, number, numbers, one_line
from annulus_pipe.vocabulary import AnnulusError


def outline(radius_mm: FloatArray, clock_deg: FloatArray, z_mm: float) -> FloatArray:
    """(A, 3) pipe coordinates of a station's wall: x right, y down, chainage; NaN where not seen."""
    t = np.radians(clock_deg)
    return np.stack([radius_mm * np.sin(t), -radius_mm * np.cos(t), np.full(len(t), z_mm)], axis=1)


def line(results: Results) -> FloatArray:
    """(N, 3) points of the centre line in space, mm."""
    return np.array(results.course["line_mm"], dtype=np.float64)[:, 1:]


class Space:
    """From pipe coordinates to space, as centreline.json says. Raises AnnulusError for pieces that are none."""

    def __init__(self, results: Results) -> None:
        self._line = None
        if pieces := results.course["pieces"]:
            from annulus_pipe.wall.centreline import Centreline

            try:
                self._line = Centreline([_piece(mapping(one, "a piece"), i) for i, one in enumerate(pieces)])
            except ValueError as error:
                path = results.folder / "centreline.json"
                raise AnnulusError(
                    f"{path}: {one_line(str(error))}. Expected results of `annulus reconstruct`."
                ) from None

    def __call__(self, points: FloatArray) -> FloatArray:
        return points if self._line is None else self._line.to_space(points)


def _piece(found: Mapping[str, Any], index: int) -> Any:
    from annulus_pipe.wall.centreline import Piece

    def two(name: str, most: float) -> Sequence[float]:
        return numbers(found.get(name), f"pieces[{index}].{name}", (2,), most)

    offset, turn, curvature = two("offset_mm", MM_MAX), two("turn_deg", 360.0), two("curvature_per_m", 1e4)
    return Piece(
        number(found.get("start_mm"), f"pieces[{index}].start_mm", MM_MAX),
        number(found.get("radius_mm"), f"pieces[{index}].radius_mm", MM_MAX),
        (offset[0], offset[1]),
        (float(np.radians(turn[0])), float(np.radians(turn[1]))),
        (1e-3 * curvature[0], 1e-3 * curvature[1]),
    )
