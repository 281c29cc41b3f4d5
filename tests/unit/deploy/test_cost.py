"""What a season costs: the manual's tables are what the program prints, and its sums are those of the manual."""

from pathlib import Path

import pytest

from tools.deploy.cost import Prices, Season, bill, hours, main, quantities, ratios

PAGE = (Path(__file__).parents[3] / "docs/manual/cluster.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("table", [quantities, hours, ratios], ids=lambda one: one.__name__)
def test_the_manual_has_the_tables_as_they_come_out(table: object) -> None:
    assert callable(table) and table(Season()) in PAGE


def test_the_seasons_numbers_are_those_that_were_measured() -> None:
    season = Season()
    assert (season.gb, season.core_hours) == (50_000, 54)
    assert season.core_s_a_gb == pytest.approx(3.888) and "A GB is worth 3.9 seconds of a core" in PAGE
    assert season.core_mb_s == pytest.approx(257, abs=0.5) and "257 MB of scan a second" in PAGE
    assert season.core_mb_s > 3 * 77  # .. more than three heads make
    assert Season(scans=1, core_hours=54 / 500).core_mb_s == pytest.approx(season.core_mb_s)


def test_a_bill_is_quantities_times_prices() -> None:
    cost = dict(bill(Season(), Prices(core_hour=2.0, gb_month=0.5, gb_out=0.25, request=1e-6)))
    assert cost["computing it once"] == pytest.approx(108)
    assert cost["kept for a year"] == pytest.approx(50_000 * 12 * 0.5)
    assert cost["once, data goes to the work"] - cost["once, work goes to the data"] == pytest.approx(12_500)
    assert cost["reading it once"] == pytest.approx(50_000 / 0.012 * 1e-6 + 2500e-6)


def test_the_slower_of_cores_and_line_decides() -> None:
    season = Season()
    assert season.hours(1, 100) == (pytest.approx(54), "cores")
    assert season.hours(64, 1) == (pytest.approx(50e12 * 8 / 1e9 / 3600), "line")
    paid = 16 * season.hours(16, 10)[0]
    assert f"{paid:.0f} P in place of 54 P" in PAGE
    assert season.hours(4, 10) == (pytest.approx(13.5), "cores") and "13.5 h: 54 P" in PAGE


def test_ratios_are_where_two_ways_cost_the_same() -> None:
    season, core = Season(), 3.0
    same = core * season.core_hours / season.gb
    cost = dict(bill(season, Prices(core, same, same, 0.0)))
    assert cost["sent out of where it lies"] == pytest.approx(cost["computing it once"])
    assert cost["kept for a month"] == pytest.approx(cost["computing it once"])


def test_prices_go_together(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--core-hour", "1", "--gb-month", "1", "--gb-out", "1", "--request", "0"])
    assert "once, data goes to the work" in capsys.readouterr().out
    for wrong in (["--core-hour", "1"], ["--scans", "0"], ["--core-hours", "nan"]):
        with pytest.raises(SystemExit, match="2"):
            main(wrong)
    assert "the four prices go together" in capsys.readouterr().err
