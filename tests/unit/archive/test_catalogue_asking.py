"""Questions to a catalogue: what they answer, what they cannot do, and what is left when files are damaged."""

import csv
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from annulus_pipe.archive.catalogue import Added, add, listed
from annulus_pipe.archive.catalogue.columns import JOINT_MEASURES, TABLES, VIEWS
from annulus_pipe.archive.catalogue.pieces import pack
from annulus_pipe.archive.catalogue.query import Catalogue, open_catalogue
from annulus_pipe.archive.catalogue.questions import QUESTIONS
from annulus_pipe.archive.catalogue.store import pack_folders, survey_folder
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.speed.catalogue import results

MAY = datetime(2026, 5, 4, 8)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("season")
    made = [results(folder / f"{i}", f"P-{i // 2}", MAY.replace(year=2025 + i % 2, minute=i), 20, i) for i in range(6)]
    add(folder / "archive", made)
    return folder / "archive"


def ask(catalogue: Catalogue, sql: str, seconds: float = 30.0) -> list[tuple[Any, ...]]:
    with catalogue.asked(sql, seconds) as answer:
        return list(answer.rows())


def stations_of(folder: Path) -> dict[str, np.ndarray]:
    with (folder / "stations.csv").open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("table", ["joints", *(name for name in TABLES if name != "joints")])
def test_every_view_has_the_columns_it_is_said_to_have(archive: Path, table: str) -> None:
    kinds = {
        "text": "VARCHAR",
        "number": "DOUBLE",
        "whole": "BIGINT",
        "yes": "BOOLEAN",
        "date": "DATE",
        "time": "TIMESTAMP",
        "measures": "MAP(VARCHAR, DOUBLE)",
    }
    with open_catalogue(archive) as catalogue:
        told = {row[0]: row[1] for row in ask(catalogue, f"DESCRIBE {table}")}
        columns = TABLES.get(table, ())
        assert set(told.items()) >= {(c.name, kinds[c.kind]) for c in columns if (table, c.name) != ("defects", "sure")}
        assert table in ("joints", "defects") or len(told) == len(columns)
        assert table != "joints" or set(told) >= set(JOINT_MEASURES)
        counts = ", ".join(f"(SELECT count(*) FROM {view})" for view in VIEWS)  # a question is a process
        ask(catalogue, f"SELECT {counts}")


def test_an_empty_catalogue_answers_with_no_rows(tmp_path: Path) -> None:
    add(tmp_path / "archive", [])
    with open_catalogue(tmp_path / "archive") as catalogue:
        counts = ", ".join(f"(SELECT count(*) FROM {view})" for view in VIEWS)  # a question is a process
        assert {count for row in ask(catalogue, f"SELECT {counts}") for count in row} == {0}
        for question in list(QUESTIONS.values())[:1]:
            assert ask(catalogue, question.sql) == []


def test_worst_ovality_is_that_of_the_files(archive: Path) -> None:
    with open_catalogue(archive) as catalogue:
        found = {row[0]: row for row in ask(catalogue, QUESTIONS["worst-ovality"].sql)}
    assert set(found) == {"P-0", "P-1", "P-2"}
    for pipe, (_, date, _, z, worst) in found.items():
        both = [stations_of(archive.parent / f"{2 * int(pipe[2:]) + i}") for i in range(2)]
        year = int(np.argmax([one["shape_ovality_f1216_percent"].max() for one in both]))
        at = int(np.argmax(both[year]["shape_ovality_f1216_percent"]))
        assert (date.year, z, worst) == (
            2025 + year,
            both[year]["z_mm"][at],
            both[year]["shape_ovality_f1216_percent"][at],
        )


def test_year_on_year_holds_each_station_against_the_nearest_of_the_year_before(tmp_path: Path) -> None:
    draw, folders = np.random.default_rng(1), []
    for year, shift in ((2024, 0.0), (2025, 1.7), (2026, 0.0)):
        folder = results(tmp_path / f"{year}", "P", MAY.replace(year=year), 50, year)
        table = np.loadtxt(folder / "stations.csv", delimiter=",", skiprows=1)
        table[:, 0] = np.cumsum(draw.uniform(2, 9, 50)) + shift
        head = (folder / "stations.csv").read_text().splitlines()[0]
        np.savetxt(folder / "stations.csv", table, "%.4f", ",", header=head, comments="")
        folders.append(folder)
    add(tmp_path / "archive", folders)
    with open_catalogue(tmp_path / "archive") as catalogue:
        (row,) = ask(catalogue, QUESTIONS["year-on-year"].sql)
    now, old = stations_of(folders[2]), stations_of(folders[1])
    near = np.argmin(np.abs(now["z_mm"][:, None] - old["z_mm"]), axis=1)
    fit = np.abs(now["z_mm"] - old["z_mm"][near]) <= 10
    change = np.where(fit, now["shape_ovality_f1216_percent"] - old["shape_ovality_f1216_percent"][near], 0)
    wider = np.where(fit, now["diameter_mean_mm"] - old["diameter_mean_mm"][near], 0)
    most, widest = int(np.argmax(np.abs(change))), int(np.argmax(np.abs(wider)))
    assert row[0] == "P" and row[1].year == 2026 and row[3].year == 2025 and row[5] == int(fit.sum())
    assert row[6:8] == (pytest.approx(change[most]), now["z_mm"][most])
    assert row[8:] == (pytest.approx(wider[widest]), pytest.approx(0.06 * 2**0.5), now["z_mm"][widest])


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("sql", "told"),
    [
        ("", "0 characters"),
        ("-- nothing", "expected one SELECT"),
        ("x" * 200_000, "characters of SQL"),
        ("selec 1", "syntax error"),
        ("SELECT nothing FROM surveys", "nothing"),
        ("SELECT 1; SELECT 2", "expected one SELECT"),
        ("DROP VIEW surveys", "expected a SELECT"),
        ("INSERT INTO all_surveys SELECT * FROM all_surveys", "expected a SELECT"),
        ("SET enable_external_access = true", "expected a SELECT"),
        ("ATTACH '/etc/x.db'", "expected a SELECT"),
        ("COPY (SELECT 1) TO '{file}'", "expected a SELECT"),
        ("EXPLAIN ANALYZE COPY (SELECT 1) TO '{file}'", "expected a SELECT"),
        ("INSTALL httpfs", "expected a SELECT"),
        ("WITH x AS (COPY (SELECT 1 AS survey) TO '{file}' (FORMAT parquet, USE_TMP_FILE false)) SELECT 1", "query: "),
        ("SELECT * FROM (WITH x AS (COPY (SELECT 1) TO '{file}') SELECT 1)", "query: "),
        ("SELECT (WITH x AS (COPY (SELECT 1) TO '{file}') SELECT 1)", "query: "),
        ("WITH x AS (DELETE FROM all_surveys RETURNING *) SELECT * FROM x", "query: "),
        ("SELECT * FROM query('SELECT 1')", "asks the function query"),
        ("SELECT * FROM read_text('/etc/passwd')", "asks the function read_text"),
        ("SELECT * FROM read_parquet('{file}')", "asks the function read_parquet"),
        ("SELECT * FROM arrow_scan(1, 2, 3)", "asks the function arrow_scan"),
        ("SELECT * FROM glob('/*')", "asks the function glob"),
        ("SELECT * FROM '/etc/passwd'", "/etc/passwd"),
        ("SELECT * FROM 'https://127.0.0.1/x.parquet'", "query: "),
        ("SELECT * FROM sql", "sql"),
        ("SELECT 'a'::INT", "Could not convert"),
        ("SELECT " + "(" * 5000 + "1" + ")" * 5000, "query: "),
        ("SELECT '\udc80'", "query: "),
    ],
)
def test_a_question_reads_the_catalogue_and_does_nothing_else(archive: Path, sql: str, told: str) -> None:
    file = next((archive / "surveys").glob("*/stations.parquet"))
    before = file.read_bytes()
    with open_catalogue(archive) as catalogue:
        with pytest.raises(AnnulusError, match=f"(?i){told}") as caught:
            ask(catalogue, sql.replace("{file}", str(file)))
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 600
        assert ask(catalogue, "SELECT count(*) FROM surveys") == [(6,)]
    assert file.read_bytes() == before


def test_time_and_memory_are_bounded(archive: Path) -> None:
    began = time.monotonic()
    with open_catalogue(archive, memory_mb=100) as catalogue:
        with pytest.raises(AnnulusError, match=r"longer than 0\.5 s"):
            ask(catalogue, "SELECT count(*) FROM range(1000000000000)", seconds=0.5)
        with pytest.raises(AnnulusError, match="more than 100 MB"):
            ask(catalogue, "SELECT list(range) FROM range(100000000)")
        assert ask(catalogue, "SELECT count(*) FROM stations") == [(120,)]
    assert time.monotonic() - began < 60


def season(folder: Path) -> tuple[Path, list[str]]:
    made = [results(folder / f"{i}", f"P-{i}", MAY.replace(minute=i), 20, i) for i in range(6)]
    done = add(folder / "archive", made)
    return folder / "archive", [str(one.row["survey"]) for one in done if isinstance(one, Added)]


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-20])


def emptied(file: Path) -> None:
    file.write_bytes(b"")


def gone(file: Path) -> None:
    file.unlink()


def scrambled(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[4 : len(data) // 2] = bytes(len(data) // 2 - 4)
    file.write_bytes(data)


def no_foot(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[-60:-8] = b"\xff" * 52
    file.write_bytes(data)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("harm", [cut, emptied, gone, scrambled, no_foot])
@pytest.mark.parametrize("table", ["surveys", "stations", "features"])
def test_a_damaged_file_costs_its_own_rows_and_is_told(tmp_path: Path, table: str, harm: Any) -> None:
    archive, surveys = season(tmp_path)
    file = survey_folder(archive, surveys[2]) / f"{table}.parquet"
    harm(file)
    left = 5 if table == "surveys" else 6
    rows, _, _ = listed(archive)
    assert len(rows) == left
    with open_catalogue(archive) as catalogue:
        whole = {name: 5 if table in ("surveys", name) else 6 for name in ("stations", "features")}
        assert len(ask(catalogue, "SELECT * FROM features")) == whole["features"]
        assert len(ask(catalogue, "SELECT * FROM stations")) == 20 * whole["stations"]
        assert len(ask(catalogue, "SELECT * FROM surveys")) == left
        (damage,) = [one for one in catalogue.damage if one.path == file]
        assert damage.lost


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("harm", [cut, gone, scrambled, no_foot])
@pytest.mark.parametrize("table", ["surveys", "stations"])
def test_a_damaged_pack_costs_nothing_and_is_told(tmp_path: Path, table: str, harm: Any) -> None:
    archive, _ = season(tmp_path)
    pack(archive, at=3)
    ((_, folder),) = pack_folders(archive)
    harm(folder / f"{table}.parquet")
    with open_catalogue(archive) as catalogue:
        assert len(ask(catalogue, "SELECT * FROM stations")) == 120
        assert len(ask(catalogue, "SELECT * FROM surveys")) == 6
        (damage,) = catalogue.damage
        assert damage.path.name == f"{table}.parquet" and not damage.lost
