"""Promises of the benchmarks' runner: one table, whatever its topics do."""

import importlib
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from tools.bench.__main__ import TABLES, main
from tools.bench.table import Row, Table


def breaks() -> list[Row]:
    raise ValueError("no | such\n  lens")


@pytest.fixture
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Table:
    good = SimpleNamespace(rows=lambda: [Row("width", "2", "<= 3", "1 mm", True)], NOTE="\nAs told.\n")
    theory = SimpleNamespace(rows=lambda: [Row("gain", "-", "-", "2 dB", theory="3 dB")])
    for name, module in (("good", good), ("bad", SimpleNamespace(rows=breaks)), ("theory", theory)):
        monkeypatch.setitem(sys.modules, f"made_up.{name}", module)
    package = ModuleType("made_up")
    package.__path__ = []
    monkeypatch.setitem(sys.modules, "made_up", package)
    topics = {"good": "Good", "bad": "Bad", "missing": "Missing", "theory": "Theory"}
    return Table("made_up", "All of it", topics, tmp_path, "make all-of-it")


def test_a_topic_that_breaks_costs_only_its_own_rows(table: Table, capsys: pytest.CaptureFixture[str]) -> None:
    """While it runs, or already while it is imported."""
    assert table.run() == 1
    text = (table.folder / "RESULTS.md").read_text()
    assert "| width | 2 | <= 3 | 1 mm | met |" in text
    assert "| bad broke | - | runs | ValueError: no / such lens | **missed** |" in text
    assert "| missing broke | - | runs | ModuleNotFoundError: No module named 'made_up.missing' | **missed** |" in text
    assert "| gain | - | 3 dB | - | 2 dB |  |" in text and "| what | source | theory | asked |" in text
    assert text.startswith("# All of it\nMade by `make all-of-it` at ") and ", Python 3." in text and "load" in text
    assert "## Good\nAs told.\n\n| what | source | asked | this project |  |\n|---|---|---|---|---|\n" in text
    assert "2 rows miss their target" in capsys.readouterr().out


def test_topics_named_are_printed_and_not_written(table: Table, capsys: pytest.CaptureFixture[str]) -> None:
    assert table.run(["theory", "good"]) == 0
    assert not (table.folder / "RESULTS.md").exists()
    said = capsys.readouterr().out
    assert said.index("## Theory") < said.index("## Good") and "every target met" in said


def test_a_row_that_misses_is_status_1(table: Table, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "made_up.good", SimpleNamespace(rows=lambda: [Row("a", "-", "-", "b", False)]))
    assert table.run(["good"]) == 1


def test_help_lists_tables_and_topics_and_is_no_failure(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0 and "Tables: metrology, " in capsys.readouterr().out
    assert main(["speed", "--help"]) == 0
    said = capsys.readouterr().out
    assert "  codecs " in said and said.endswith("Example: python -m tools.bench speed rings\n")


def test_names_that_there_are_not(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == main(["metrologie"]) == main(["metrology", "colors"]) == 2
    assert "there are autocalibration, " in capsys.readouterr().err


@pytest.mark.parametrize("name", TABLES)
def test_every_topic_is_there(name: str) -> None:
    """Imported, not run: a rename in the house breaks here and not after twenty minutes of benchmarks."""
    table = importlib.import_module(f"tools.bench.{name}").TABLE
    for topic in table.topics:
        assert callable(importlib.import_module(f"tools.bench.{name}.{topic}").rows)
