"""Rows of more or fewer cells than the heading passed: cut ones as readings that failed, shifted ones as others'."""

import gzip
import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.archive.catalogue.survey import read_survey
from annulus_pipe.console.shelf import _rows
from annulus_pipe.export.results import open_results
from annulus_pipe.scans.imu import read_motion
from annulus_pipe.scans.scan import read_table
from annulus_pipe.scans.video import read_chainage
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.log_file import read_bore_log
from annulus_pipe.wings.joints.strength_file import read_results, read_strengths, read_transmission
from annulus_pipe.wings.tai.design import load_transducer
from tools.bench.speed.catalogue import results

MAY = datetime(2026, 5, 4, 8)

BORE = "t_s,odometer_mm,c1_pf,c2_pf,c3_pf,cref_pf,roll_deg"
TABLES = {  # heading, a row by its number, who reads it
    "log.csv": (BORE, lambda i: f"{i}.5,{i}.25,1.5,1.5,1.5,2.5,0.5", read_bore_log),
    "log.csv.gz": (BORE, lambda i: f"{i}.5,{i}.25,1.5,1.5,1.5,2.5,0.5", read_bore_log),
    "strengths.csv": ("angle_deg,energy_j", lambda i: f"{10 * i}.5,1.5", read_strengths),
    "light.csv": ("z_mm,dogbone_0.5,dogbone_90", lambda i: f"{i}.5,1.5,2.5", read_transmission),
    "results.csv": ("joint,angle_deg,result,note", lambda i: f"a,{i}.5,good,x", read_results),
    "chainage.csv": ("frame,chainage_m", lambda i: f"{i},{i}.5", read_chainage),
    "pulse.csv": ("time_us,amplitude", lambda i: f"{i}.5,1.5", load_transducer),
    "imu.csv": (
        "index,dtheta_x_deg,dtheta_y_deg,dtheta_z_deg",
        lambda i: f"{i},0.5,0.5,0.5",
        lambda path: read_motion(path.parent, range(12)),
    ),
    "frames.csv": (
        "index,file,light,z_mm,roll_deg",
        lambda i: f"{i},0.png,led,{i}.5,0.5",
        lambda path: read_table(path.parent),
    ),
}
ROWS = 12


def written(folder: Path, name: str, rows: list[str]) -> Path:
    (folder / "0.png").touch()
    data = "\n".join([TABLES[name][0], *rows, ""]).encode()
    (folder / name).write_bytes(gzip.compress(data) if name.endswith("gz") else data)
    return folder / name


@pytest.mark.parametrize("name", TABLES)
def test_a_row_of_other_cells_is_one_line(tmp_path: Path, name: str) -> None:
    heading, row, read = TABLES[name]
    cells, rows = heading.count(",") + 1, [row(i) for i in range(ROWS)]
    read(written(tmp_path, name, rows))
    for at, wrong in (
        (ROWS - 1, rows[-1].rpartition(",")[0]),  # the file ends in a row
        (3, rows[3].replace(".5", ",5")),  # a decimal comma
        (5, rows[5] + ",0"),
    ):
        path = written(tmp_path, name, [*rows[:at], wrong, *rows[at + 1 :]])
        with pytest.raises(AnnulusError) as refused:
            read(path)
        told = str(refused.value)
        assert f"{name}: " in told and f" {at + 2}: " in told and "\n" not in told
        assert f"{wrong.count(',') + 1} cell" in told and f"expected {cells} as line 1 has" in told


def test_a_shelf_tells_nothing_of_a_table_that_is_none(tmp_path: Path) -> None:
    assert _rows(written(tmp_path, "frames.csv", ["0,0.png,led,1.5,0"])) == (1, [1.5])
    assert _rows(written(tmp_path, "frames.csv", ["0,0.png,led,1.5,0", "1,0.png,led,2"])) == (None, [])


def cut(path: Path, at: int) -> None:
    path.write_bytes(path.read_bytes()[:at])


@pytest.mark.parametrize("counted", [True, False], ids=["counted", "of before"])
def test_stations_that_are_not_all_there_are_refused(tmp_path: Path, counted: bool) -> None:
    count = 42
    folder = results(tmp_path / "r", "P", MAY, count)
    if not counted:
        told = json.loads((folder / "summary.json").read_text())
        del told["stations"]
        (folder / "summary.json").write_text(json.dumps(told))
    path = folder / "stations.csv"
    whole = path.read_bytes()
    assert read_survey(folder).row["station_count"] == len(open_results(folder).stations["z_mm"]) == count
    ends = np.flatnonzero(np.frombuffer(whole, np.uint8) == ord("\n")) + 1
    wrong = [len(whole) * 2 // 3, len(whole) - 1, len(whole) - 3, int(ends[0]), int(ends[count // 2]), int(ends[-3])]
    for at in [*wrong, *([int(ends[-2])] if counted else [])]:
        path.write_bytes(whole[:at])
        for read in (read_survey, open_results):
            with pytest.raises(AnnulusError, match=r"stations\.csv") as refused:
                read(folder)
            assert "\n" not in str(refused.value)


def test_a_text_too_long_for_exports_is_refused_by_the_catalogue(tmp_path: Path) -> None:
    folder = results(tmp_path / "r", "P", MAY, 3, job={"pipe": "P", "site": "x" * 100_000})
    for read in (read_survey, open_results):
        with pytest.raises(AnnulusError, match=r"job\.site must be a text of at most 2000"):
            read(folder)
