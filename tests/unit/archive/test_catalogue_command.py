"""`annulus archive`, as people type it."""

import csv
import io
import json
import re
from datetime import datetime
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from annulus_pipe.archive.catalogue.columns import (
    DEFECTS,
    FEATURES,
    JOINT_MEASURES,
    STATIONS,
    SUPERSEDED,
    SURVEYS,
    VIEWS,
)
from annulus_pipe.archive.catalogue.questions import QUESTIONS
from annulus_pipe.cli.app import app
from annulus_pipe.extras import need
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.speed.catalogue import results
from tools.manual.pages import DOCS

MAY = datetime(2026, 5, 4, 8)
PAGE = (DOCS / "manual/archive.md").read_text(encoding="utf-8")


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    for i, pipe in enumerate(("P-1", "=HYPERLINK(1)", "[bold]P[/bold]\\")):
        results(tmp_path / f"{i}", pipe, MAY.replace(minute=i), 5, i)
    done = run("add", *[str(tmp_path / f"{i}") for i in range(3)], "--archive", str(tmp_path / "archive"))
    assert done.exit_code == 0 and done.stdout.count("added ") == 3
    return tmp_path / "archive"


def run(*words: str) -> Result:
    return CliRunner().invoke(app, ["archive", *words])


def refused(*words: str) -> str:
    done = run(*words)
    assert done.exit_code != 0 and isinstance(done.exception, AnnulusError), (done.stdout, done.exception)
    return str(done.exception)


def test_adding_says_what_became_of_each(archive: Path, tmp_path: Path) -> None:
    again = results(tmp_path / "again", "P-1", MAY, 5, 9, created="2026-06-01T00:00:00+00:00")
    done = run("add", str(again), str(tmp_path / "1"), str(tmp_path / "nothing"), "-a", str(archive), "--json")
    assert done.exit_code == 1
    told = json.loads(done.stdout)
    assert [one["new"] for one in told["added"]] == [True, False] and len(told["added"][0]["supersedes"]) == 1
    assert [one["results"] for one in told["refused"]] == [str(tmp_path / "nothing")]
    said = run("add", str(tmp_path / "0"), "-a", str(archive)).stdout
    assert "was there" in said and "superseded by" in said


def test_the_list_has_units_and_says_what_it_does_not_show(archive: Path, tmp_path: Path) -> None:
    again = results(tmp_path / "again", "P-1", MAY, 5, 9, created="2026-06-01T00:00:00+00:00")
    assert run("add", str(again), "-a", str(archive)).exit_code == 0
    said = run("list", "-a", str(archive)).stdout
    assert "0.025 m" in said and " mm" in said and " %" in said and "and 1 superseded: --all shows them" in said
    assert "superseded by" in run("list", "-a", str(archive), "--all").stdout
    (row,) = json.loads(run("list", "-a", str(archive), "--pipe", "P-1", "--json").stdout)["surveys"]
    assert row["pipe"] == "P-1" and row["date"] == "2026-05-04" and row["begun_utc"] == "2026-05-04T08:00:00+00:00"
    assert json.loads(run("list", "-a", str(archive), "--since", "2026-05-05", "--json").stdout)["surveys"] == []
    assert run("list", "-a", str(archive), "--check").exit_code == 0


def test_answers_in_every_form_are_the_same(archive: Path, tmp_path: Path) -> None:
    ask = ["SELECT pipe, date, z_mm, NULL AS nothing, 1.0 / 0 AS much FROM stations ORDER BY ALL", "-a", str(archive)]
    told = json.loads(run("query", *ask, "--json").stdout)
    assert len(told) == 15 and told[0] | {"pipe": ""} == {
        "pipe": "",
        "date": "2026-05-04",
        "z_mm": 0.0,
        "nothing": None,
        "much": None,
    }
    table = list(csv.DictReader(io.StringIO(run("query", *ask, "--csv").stdout)))
    assert {row["pipe"] for row in table} == {"P-1", "'=HYPERLINK(1)", "[bold]P[/bold]\\"}
    assert [float(row["z_mm"]) for row in table] == [row["z_mm"] for row in told]
    file = tmp_path / "answer.parquet"
    assert run("query", *ask, "--parquet", str(file)).exit_code == 0
    found = need("pyarrow.parquet").read_table(file)
    assert found["pipe"].to_pylist() == [row["pipe"] for row in told]
    assert run("query", *ask).stdout.splitlines()[-1] == "15 rows"
    many = run("query", "SELECT range FROM range(1000)", "-a", str(archive)).stdout.splitlines()
    assert len(many) == 202 and "--csv prints all" in many[-1]


@pytest.mark.deep(
    gate="tests/unit/archive/test_catalogue_command.py::test_the_list_has_units_and_says_what_it_does_not_show"
)
def test_questions_are_kept_shown_and_asked(archive: Path) -> None:
    listed = run("query", "--named", "list").stdout
    for name in QUESTIONS:
        assert name in listed
        assert run("query", "--named", name, "-a", str(archive)).exit_code == 0
        shown = run("query", "--named", name, "--show").stdout
        asked = run("query", shown, "-a", str(archive), "--json")
        assert asked.exit_code == 0
        assert json.loads(asked.stdout) == json.loads(
            run("query", "--named", name, "-a", str(archive), "--json").stdout
        )


def test_wrong_words_are_one_line(archive: Path, tmp_path: Path) -> None:
    a = ("-a", str(archive))
    assert "no catalogue" in refused("list", "-a", str(tmp_path / "nowhere"))
    assert "no catalogue" in refused("query", "SELECT 1", "-a", str(tmp_path))
    assert "YYYY-MM-DD" in refused("list", *a, "--since", "last year")
    assert "expected one of worst-ovality" in refused("query", *a, "--named", "best")
    assert "one of them" in refused("query", *a)
    assert "one of them" in refused("query", *a, "SELECT 1", "--named", "year-on-year")
    assert "one of them" in refused("query", *a, "SELECT 1", "--json", "--csv")
    assert "--named" in refused("query", *a, "SELECT 1", "--show")
    assert "cannot be written" in refused("query", *a, "SELECT 1 AS a", "--parquet", str(tmp_path / "no/such/file"))
    assert "expected NAME=TEXT" in refused("add", str(tmp_path / "0"), *a, "--job", "colour=red")
    assert "no such survey" in refused("add", str(tmp_path / "0"), *a, "--replaces", "P-9")
    assert "cannot replace one" in refused("add", str(tmp_path / "0"), str(tmp_path / "1"), *a, "--replaces", "P-1")
    assert run("query", "SELECT 1", *a, "--seconds", "0").exit_code == 2
    assert not list(tmp_path.rglob("*.part"))


def test_damage_is_told_and_the_rest_listed(archive: Path) -> None:
    next((archive / "surveys").glob("*/stations.parquet")).write_bytes(b"PAR1")
    done = run("list", "-a", str(archive))
    assert done.exit_code == 0 and "3 surveys" in done.stdout and "stations.parquet: damaged" in done.stderr
    assert run("list", "-a", str(archive), "--check").exit_code == 1


def test_the_manual_names_every_column_view_and_question() -> None:
    def named(section: str) -> list[str]:
        text = PAGE.partition(f"### {section}\n")[2].partition("\n#")[0]
        return re.findall(r"^\| `(\w+)` \|", text, re.M)

    assert named("surveys") == [one.name for one in (*SURVEYS, SUPERSEDED)]
    assert named("stations") == [one.name for one in STATIONS]
    assert named("defects and undecided") == [one.name for one in DEFECTS if one.name != "sure"]
    assert named("features and joints") == [*(one.name for one in FEATURES), *JOINT_MEASURES]
    for name in (*VIEWS, *QUESTIONS):
        assert f"| `{name}` |" in PAGE
