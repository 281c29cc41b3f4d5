"""The wall map's rows that belong to each station of stations.csv."""

from collections.abc import Iterator

import numpy as np

from annulus_pipe.export.results import Results
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.robust import nan_median
from annulus_pipe.vocabulary import AnnulusError

ALONE_MM = 5.0  # length of a station that has no neighbour


def radii_of_stations(results: Results, every: int = 1) -> Iterator[tuple[float, FloatArray]]:
    """Distance of every n-th station, mm, and (A,) the wall's distance from the axis there: the median of what was seen
    of each column of the map in the station's rows, NaN where nothing was."""
    wall, stations = results.wall, results.stations["z_mm"]
    if not len(stations):
        raise AnnulusError(f"{results.folder / 'stations.csv'}: has no station. Expected results of a pipe.")
    half = float(np.median(np.diff(stations))) / 2 if len(stations) > 1 else ALONE_MM / 2
    ends = stations + half
    begins = np.maximum(stations - half, np.append(-np.inf, ends[:-1]))  # the last station may be short
    first, last = np.searchsorted(wall.z_mm, (begins - 1e-6, ends - 1e-6))
    for i in range(0, len(stations), every):
        yield float(stations[i]), nan_median(wall.radii_mm(slice(first[i], last[i])))
