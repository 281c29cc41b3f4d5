"""Of two columns of one name an answer in JSON had the second alone; a date beyond 9999 was an internal error."""

import csv
import io
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from annulus_pipe.archive.catalogue import add
from annulus_pipe.archive.catalogue.query import _apart
from annulus_pipe.cli.app import app
from annulus_pipe.extras import need

MOMENTS = {  # SQL, and the text that stands for it
    "DATE '9999-12-31' + 1": "10000-01-01",
    "DATE '-infinity'": "-infinity",
    "TIMESTAMP 'infinity'": "infinity",
    "'0044-03-15 (BC)'::DATE": "-0043-03-15",
    "TIMESTAMP '290000-01-01'": "290000-01-01T00:00:00.000000",
    "TIMESTAMPTZ 'infinity'": "infinity",
    "INTERVAL 5000000 YEAR": "60000000 months 0 days 0 ns",
    "DATE '2026-05-04'": "2026-05-04",
    "NULL::DATE": None,
    "[DATE 'infinity', NULL]": ["infinity", None],
    "{'x': TIMESTAMP 'infinity', 'y': 1}": {"x": "infinity", "y": 1},
    "MAP {DATE 'infinity': 1}": {"infinity": 1},
}


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("catalogue") / "archive"
    add(root, [])
    return root


def asked(archive: Path, sql: str, *how: str) -> str:
    done = CliRunner().invoke(app, ["archive", "query", sql, "-a", str(archive), *how])
    assert done.exit_code == 0, (done.output, done.exception)
    return done.stdout


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("how", ["--json", "--csv", "--parquet"])
def test_every_column_has_a_name_of_its_own_and_every_moment_a_text(archive: Path, tmp_path: Path, how: str) -> None:
    moments = "".join(f", {sql} AS c{i}" for i, sql in enumerate(MOMENTS))
    sql, file = f'SELECT 1 AS a, 2 AS "A", 3 AS a_1{moments if how == "--json" else ", 4 AS b"}', tmp_path / "a.parquet"
    told = asked(archive, sql, how, *([str(file)] if how == "--parquet" else []))
    if how == "--json":
        (row,) = json.loads(told)
        assert list(row.items())[:3] == [("a", 1), ("A_1", 2), ("a_1_1", 3)]
        assert list(row.values())[3:] == list(MOMENTS.values())
    elif how == "--csv":
        assert list(csv.reader(io.StringIO(told))) == [["a", "A_1", "a_1_1", "b"], ["1", "2", "3", "4"]]
    else:
        rows = need("pyarrow.parquet").read_table(file).to_pylist()
        assert rows == [{"a": 1, "A_1": 2, "a_1_1": 3, "b": 4}]


def test_names_are_told_apart_as_in_a_table() -> None:
    assert _apart(["a", "a", "a"]) == ["a", "a_1", "a_2"] and _apart(["", ""]) == ["", "_1"]
