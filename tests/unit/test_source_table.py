"""The source's table: it is the file's, its rows are whole, their numbers are measured, and their commands run."""

import importlib
import re
import shlex
from pathlib import Path

import pytest

from tools import bench, source
from tools.bench.table import ROOT
from tools.manual import commands
from tools.source import Entry, entries, inputs, parts
from tools.source.run import Workplace, amiss, lines
from tools.study import chosen

CHEAP = ("annulus timing", "annulus burst design --code barker13", "annulus bore detect tests")  # 3 s of processor
DECIMAL = re.compile(r"\d+\.\d+")
ROWS = entries()
NAMES = [f"{row.section}: {row.what}"[:70] for row in ROWS]


def typed(part: str) -> None:
    """Raises what a shell or the program would say to it, before anything is done."""
    match shlex.split(part):
        case ["annulus", *_]:
            commands.parse(part)
        case ["python", "-m", "tools.study", *words]:
            chosen([word for word in words[: words.index("-o")]])
        case ["python", "-m", "tools.bench", table, *topics]:
            assert topics and set(topics) <= importlib.import_module(f"{bench.__name__}.{table}").TABLE.topics.keys()
        case ["python", "-m", "tools.source", "inputs", kind, _]:
            assert kind in inputs.KINDS
        case ["python", "-m", "tools.hardware", _]:
            pass
        case ["mkdir", "-p", _] | ["cp", _, _]:
            pass
        case _:
            raise ValueError(f"{part!r}: no command of this project")


def test_the_page_has_the_table_of_the_file() -> None:
    assert source.written() == source.table(), "python -m tools.source writes it"


def test_all_chapters_are_there_and_a_section_is_a_row_or_more() -> None:
    sections = " ".join(row.section for row in ROWS)
    for chapter in range(2, 12):
        assert f"§{chapter}." in sections
    assert len(ROWS) > 90 and "A.1" in sections and "A.2" in sections
    assert len({(row.section, row.what) for row in ROWS}) == len(ROWS)


@pytest.mark.parametrize("row", ROWS, ids=NAMES)
def test_a_row_is_whole_and_claims_no_more_than_it_shows(row: Entry) -> None:
    assert row.section and row.what and row.source and row.state in source.STATES
    assert all((ROOT / place).exists() or (ROOT / source.PACKAGE / place).exists() for place in row.where)
    if row.state == "works":
        assert row.command and row.where and row.ours != "-"
    else:
        assert len(row.why) > 10
    assert row.why or not row.missed, f"misses a target of ours, and does not say so: {row.missed}"
    assert row.whose != "-" or row.ours == "-"
    assert row.bench or row.truth in {*source.TRUTHS, "-"}


@pytest.mark.parametrize("row", ROWS, ids=NAMES)
def test_a_number_is_a_benchmarks_or_printed_by_the_command(row: Entry) -> None:
    used = {int(match[1]) for match in source.QUOTED.finditer(row.ours)}
    assert used == set(range(1, len(row.bench) + 1))
    known = " ".join([*row.prints, row.section, row.what, row.source, row.command, *row.bench])
    own = set(DECIMAL.findall(row.ours)) - set(DECIMAL.findall(known))
    assert not own, f"whence? {row.ours}"
    assert row.command or not row.prints


@pytest.mark.parametrize("line", [row.command for row in ROWS if row.command])
def test_a_rows_command_can_be_typed(line: str) -> None:
    for part in parts(line):
        typed(part)


@pytest.mark.parametrize(
    "wrong",
    [
        "annulus timing --fps 25 --exposure 1 --readout-us 1",
        "annulus joint scann --twin",
        "annulus twin scan --frames many -o build/x",
        "python -m tools.study 9.1 -o build/x",
        "python -m tools.bench metrology nothing",
        "make demo",
    ],
)
def test_a_command_that_cannot_is_found(wrong: str) -> None:
    with pytest.raises(Exception, match=r"No such|valid integer|nothing|expected|no command"):
        typed(wrong)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Workplace:
    return Workplace(tmp_path_factory.mktemp("source") / "checkout")


@pytest.mark.parametrize("line", [line for line in lines() if line.startswith(CHEAP)])
def test_cheap_lines_run_and_print_their_numbers(line: str, place: Workplace) -> None:
    assert not amiss(*place.done(line), lines()[line])


@pytest.mark.deep(gate="tests/unit/test_source_table.py::test_cheap_lines_run_and_print_their_numbers")
@pytest.mark.parametrize("line", [line for line in lines() if not line.startswith(CHEAP)])
def test_every_line_runs_and_prints_its_numbers(line: str, place: Workplace) -> None:
    assert not amiss(*place.done(line), lines()[line])


def test_a_line_that_fails_or_prints_other_numbers_is_found(place: Workplace) -> None:
    row = next(row for row in ROWS if row.prints)
    assert amiss(*place.done("true && false && echo never"), [row]) == ["status 1: nothing printed"]
    assert amiss(0, "other numbers", [row]) == [f"{row.section}: does not print {one!r}" for one in row.prints]


def test_a_bench_row_that_there_is_not_is_found() -> None:
    for name in ("metrology/mirror: no such row", "metrology/nowhere: mirror sensor", "metrology/mirror: "):
        with pytest.raises(ValueError, match=r"begins \d+ rows"):
            source.benched(name)


def test_writing_twice_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "source.md"
    page.write_text(f"# Title\n\n{source.BEGIN}\nold\n{source.END}\n\nfoot\n", encoding="utf-8")
    monkeypatch.setattr(source, "PAGE", page)
    source.write()
    once = page.read_text(encoding="utf-8")
    source.write()
    assert page.read_text(encoding="utf-8") == once
    assert once.startswith("# Title") and once.endswith("foot\n") and source.written() == source.table()
