"""1080 radii a station, opened by pandas."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
from results_folder import RADIUS_MM, ROWS, Z_STEP_MM, radius_map

from annulus_pipe.export.radii import ANGLES_DEG, at_angles

Written = Callable[[str], Path]


def test_a_row_a_station_and_1080_radii_clockwise_from_noon(written: Written, folder: Path) -> None:
    path = written("radii")
    table = pandas.read_csv(path)
    stations = pandas.read_csv(folder / "stations.csv")
    assert list(table["z_mm"]) == list(stations["z_mm"])
    assert list(table.columns[:4]) == ["z_mm", "r_000.00", "r_000.33", "r_000.67"] and len(table.columns) == 1081
    assert table.columns[-1] == "r_359.67"
    notch = table.loc[:, "r_086.00":"r_094.00"]
    assert (notch == RADIUS_MM + 3.0).all(axis=None)
    about = json.loads(path.with_name("radii.json").read_text())
    assert (about["map_step_deg"], about["radii"], about["unit"]) == (1.0, 1080, "mm")


def test_radii_are_those_of_the_map_and_empty_where_it_has_none(written: Written) -> None:
    table = pandas.read_csv(written("radii")).iloc[:, 1:].to_numpy()
    truth = radius_map()
    between = (ANGLES_DEG > 176.5) & (ANGLES_DEG < 183.5)
    assert np.isnan(table[:, between]).all()
    beside = (ANGLES_DEG > 175.5) & (ANGLES_DEG < 184.5)
    assert np.isnan(table[:, beside]).all()  # one neighbour is not two
    assert np.isfinite(table[:5, ~beside]).all()
    opening = np.flatnonzero((ANGLES_DEG > 265) & (ANGLES_DEG < 275))
    stations = slice(300 * len(table) // ROWS, 320 * len(table) // ROWS)
    assert np.isnan(table[stations, opening[0] : opening[-1]]).all()  # the map says only: beyond
    for row in (0, 20):
        known = np.isfinite(truth[row]) & (truth[row] < RADIUS_MM + 32)
        away = at_angles(np.where(known, truth[row], np.nan), np.arange(360) + 0.5)
        assert np.nanmax(np.abs(table[row] - away)) < 0.00051


def test_radii_between_columns_lie_on_the_line_from_one_to_the_next() -> None:
    columns = np.arange(360) + 0.5
    radius = RADIUS_MM + np.cos(np.radians(columns))
    assert np.abs(at_angles(radius, columns) - RADIUS_MM - np.cos(np.radians(ANGLES_DEG))).max() < 4e-5
    radius[10] = np.nan
    empty = ANGLES_DEG[np.isnan(at_angles(radius, columns))]
    assert empty.min() > 9.5 and empty.max() < 11.5 and len(empty) == 6


def test_a_map_as_fine_as_the_radii_is_given_as_it_is() -> None:
    radius = np.random.default_rng(1).uniform(70, 80, 1080)
    radius[7] = np.nan
    assert np.array_equal(at_angles(radius, ANGLES_DEG), radius, equal_nan=True)


def test_packed_radii_are_the_same(written: Written) -> None:
    plain, packed = pandas.read_csv(written("radii")), pandas.read_csv(written("radii-gz"))
    pandas.testing.assert_frame_equal(plain, packed)


def test_a_station_has_its_own_rows_only(written: Written, folder: Path) -> None:
    """The last one may be shorter than the others."""
    stations = pandas.read_csv(folder / "stations.csv")
    stations = stations.iloc[:-1].copy()
    z = 100.0 + Z_STEP_MM * (ROWS - 10 + np.arange(4) + 0.5)
    stations.loc[len(stations)] = [z.mean(), 151.0, 155.0, 152.4, 1.2, 0.0, 0.98, 0.1]
    stations.to_csv(folder / "stations.csv", index=False)
    with np.load(folder / "wall.npz") as file:
        held = dict(file)
    held["deviation_um"][ROWS - 10 : ROWS - 6, :90] = 500
    held["deviation_um"][ROWS - 20 : ROWS - 10, :90] = -500
    np.savez_compressed(folder / "wall.npz", **held)
    table = pandas.read_csv(written("radii"))
    assert (table["r_010.00"].iloc[-2:] == [RADIUS_MM - 0.5, RADIUS_MM + 0.5]).all()
