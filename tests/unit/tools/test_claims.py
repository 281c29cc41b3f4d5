"""Every number that is quoted says what it rests on, and the client's page quotes none of the benchmarks'."""

import importlib
import re

import pytest

from tools.bench.table import HEADLINE_DRAWS, RESTS_ON, ROOT, Basis, Row, Table, Truth, section

WRITTEN = ("metrology", "crossbore", "joints", "thermoacoustic")
CALIBRATIONS, SEEDS = ("exact", "exact, then drifted", "own", "-"), ("set on", "held out", "-")
NUMBER = re.compile(r"\d+\.\d{2,} ?(?:mm|deg|%)")  # of two decimals and more, with its unit


def table(name: str) -> Table:
    found: Table = importlib.import_module(f"tools.bench.{name}").TABLE
    return found


def written(name: str) -> list[tuple[str, list[str], dict[str, str]]]:
    """(topic, what the row says, by column) of every row of a RESULTS.md."""
    titles = {title: topic for topic, title in table(name).topics.items()}
    out, topic, head = [], "", [""]
    for text in (ROOT / "tools/bench" / name / "RESULTS.md").read_text("utf-8").splitlines():
        cells = [cell.strip() for cell in text.split("|")[1:-1]] if text.startswith("| ") else []
        if text.startswith("## "):
            topic = titles[text[3:]]
        elif cells and cells[0] == "what":
            head = [cell or "verdict" for cell in cells]
        elif cells:
            rest = dict(zip(head[-len(RESTS_ON) :], cells[-len(RESTS_ON) :], strict=True))
            out.append((topic, cells, rest | {"source": cells[1], "verdict": cells[-len(RESTS_ON) - 1]}))
    assert out
    return out


@pytest.mark.parametrize("name", WRITTEN)
def test_every_row_says_whose_truth_whose_calibration_which_seeds_how_many_draws_and_without_what(name: str) -> None:
    for topic, cells, row in written(name):
        basis = table(name).basis(topic, cells[0])
        assert basis is not None, f"{name}, {topic}: {cells[0]!r} rests on nothing that claims.py says"
        assert [row[column] for column in RESTS_ON] == [
            str(basis.truth),
            basis.calibration,
            basis.seeds,
            str(basis.draws),
            basis.left_out,
        ], f"{name}, {topic}: {cells[0]!r}"
        assert basis.calibration in CALIBRATIONS and basis.seeds in SEEDS and basis.draws > 0 and basis.left_out


@pytest.mark.parametrize("name", WRITTEN)
def test_a_number_beside_the_sources_is_of_ten_draws_or_says_of_how_many(name: str) -> None:
    for topic, cells, row in written(name):
        beside = any(c.isdigit() for c in row["source"])
        if beside and int(row["draws"]) < HEADLINE_DRAWS:
            assert row["verdict"] != "met", f"{name}, {topic}: {cells[0]!r} met by {row['draws']} draw"


@pytest.mark.parametrize("name", WRITTEN)
def test_no_claim_is_of_rows_that_there_are_not(name: str) -> None:
    titles: dict[str, list[str]] = {}
    for topic, cells, _ in written(name):
        titles.setdefault(topic, []).append(cells[0])
    for topic, of in table(name).claims.items():
        for begin in of:
            assert any(title.startswith(begin) for title in titles.get(topic, [begin])), f"{name}, {topic}: {begin!r}"


@pytest.mark.parametrize("name", ["blind", "blind/others"])
def test_tables_that_are_drawn_blind_say_it_once_for_all_rows(name: str) -> None:
    text = " ".join((ROOT / "tools/bench" / name / "RESULTS.md").read_text("utf-8").split())
    (line,) = re.findall(r"Rests on: (.*?counted apart\.)", text)
    assert re.fullmatch(r"truth .*; calibration .*; seeds .*; draws .*; left out .*", line)


def test_a_row_with_a_numeral_of_the_source_and_one_draw_is_not_simply_met() -> None:
    one, ten = (Basis(Truth.TWIN, "exact", "set on", draws) for draws in (1, HEADLINE_DRAWS))
    rows = [Row("a", "0.3 mm", "<= 1 mm", "0.1 mm", True)] * 2 + [Row("b", "-", "<= 1 mm", "0.1 mm", True)]
    lines = section("T", rows, "", [one, ten, one])
    assert "| met, 1 draw | our twin | exact | set on | 1 | nothing |" in lines[3]
    assert "| met | our twin" in lines[4] and "| met | our twin" in lines[5]
    assert "truth" not in section("T", rows)[1]


def test_the_clients_page_quotes_no_number_of_the_benchmarks() -> None:
    """In words and templates of the report: none of the numbers that a RESULTS.md measured, and no word of a bench."""
    measured = {
        number.replace(" ", "")
        for name in WRITTEN
        for _, cells, _ in written(name)
        for cell in cells[2:]
        for number in NUMBER.findall(cell)
    }
    assert len(measured) > 100
    report = ROOT / "host/annulus_pipe/report"
    for file in sorted([*report.glob("*.py"), *report.glob("*.j2"), ROOT / "host/annulus_pipe/wall/accuracy.py"]):
        text = file.read_text("utf-8")
        quoted = {number.replace(" ", "") for number in NUMBER.findall(text)} & measured
        assert not quoted, f"{file.name} quotes {quoted}"
        if file.suffix == ".j2":
            assert not re.search(r"\bbench|off the truth|whose truth", text), file.name
    assert not (report / "bench.py").exists()
    assert "reference section" in (report / "accuracy.html.j2").read_text("utf-8")


def test_headlines_of_readme_and_manual_say_nothing_better_than_the_table() -> None:
    """What was quoted of one lucky draw, or of the twin's exact calibration as if it were a head's."""
    for file in ("README.md", "docs/manual/accuracy.md"):
        text = (ROOT / file).read_text("utf-8")
        for gone in ("0.0020 deg", "0.005 %", "1000 of 1000"):
            assert gone not in text, f"{file}: {gone}"
