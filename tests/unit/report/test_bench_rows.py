"""The page quotes the bench: what it says stands in the bench's own table, word for word."""

from pathlib import Path

import pytest

from annulus.report.bench import BENCH, LEFT_OPEN, TRIALS, BenchRow
from annulus.wall.accuracy import least_detection

RESULTS = Path(__file__).resolve().parents[3] / "tools/bench/metrology/RESULTS.md"
ROWS = [tuple(cell.strip() for cell in line.split(" | ")) for line in RESULTS.read_text("utf-8").splitlines()]
QUOTED = [(one.title, one.value) for kind in BENCH.values() for one in kind]
QUOTED += [(one.title, one.value) for one in TRIALS.values()]


@pytest.mark.parametrize(("title", "value"), QUOTED)
def test_a_row_that_is_quoted_is_in_the_table(title: str, value: str) -> None:
    (row,) = [cells for cells in ROWS if cells[0].removeprefix("| ") == title]
    assert any(cell == value or cell.startswith((f"{value} ", f"{value} (")) for cell in row[1:])


@pytest.mark.parametrize("one", [one for kind in LEFT_OPEN.values() for one in kind])
def test_what_is_left_open_is_in_the_table(one: BenchRow) -> None:
    (row,) = [cells for cells in ROWS if cells[0].removeprefix("| ") == one.title]
    assert one.value in row[3]


def test_a_probability_of_detection_is_the_least_that_trials_show() -> None:
    assert least_detection(3, 3) == pytest.approx(0.05 ** (1 / 3), abs=1e-9)
    assert least_detection(29, 29) > 0.90 > least_detection(28, 28)  # the textbook's 90/95
    assert least_detection(0, 5) == 0.0 and least_detection(13, 13) == pytest.approx(0.794, abs=1e-3)
    assert not least_detection(0, 0) >= 0
