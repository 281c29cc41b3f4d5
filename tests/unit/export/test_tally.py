"""The anomaly list, opened by pandas and openpyxl."""

import json
from collections.abc import Callable
from datetime import time
from pathlib import Path
from typing import Any

import ezdxf
import openpyxl
import pandas
import pytest

from annulus_pipe.export.tally import clock_time

Written = Callable[[str], Path]
POF_2016 = [
    "Log distance [m]",
    "Latitude",
    "Longitude",
    "Altitude [m]",
    "Feature type",
    "Feature identification",
    "Comment / Cluster ID",
    "Girth weld Nr",
    "Joint manufacturing type",
    "Joint / component length [m]",
    "Internal diameter [mm]",
    "Nominal thickness [mm]",
    "Measured/reference thickness [mm]",
    "Ovality [%]",
    "Bend Y/N",
    "Abs. dist. to upstream weld [m]",
    "Clock position seam weld / anomaly [hh:mm]",
    "Surface location",
    "Inward/outward",
    "Depth / height [mm]",
    "Size (length x width) [mm]",
    "Mean depth [mm]",
    "Max. depth [mm]",
    "Length [mm]",
    "Width [mm]",
    "Anomaly dimension classification",
    "ERF (metal losses)",
    "Reference table for performance",
    "Comments",
]


@pytest.fixture
def table(written: Written) -> Any:
    return pandas.read_csv(written("pof-csv"))


def line(table: Any, name: str) -> Any:
    return table[table["No."] == name].iloc[0]


def test_the_columns_are_the_forums_in_its_order_and_ours_stand_after_them(table: Any) -> None:
    assert list(table.columns[:29]) == POF_2016
    assert list(table.columns[29:31]) == ["No.", "Depth k=2 [mm]"]


def test_every_defect_undecided_place_and_feature_has_one_line_in_order_of_distance(table: Any, folder: Path) -> None:
    data = json.loads((folder / "summary.json").read_text())
    assert len(table) == sum(len(data[name]) for name in ("defects", "undecided", "features"))
    assert table["Log distance [m]"].is_monotonic_increasing
    for i, one in enumerate(data["defects"]):
        row = line(table, f"D{i + 1}")
        assert row["Log distance [m]"] == pytest.approx(one["z_mm"] / 1000, abs=5.1e-4)
        found = row["Max. depth [mm]"] if one["kind"] == "loss" else row["Depth / height [mm]"]
        assert found == pytest.approx(one["depth_mm"], abs=5.1e-3)
        assert row["Length [mm]"] == pytest.approx(one["length_mm"], abs=0.51)
    assert line(table, "U1")["Comment / Cluster ID"].startswith("undecided")


def test_what_a_plastic_pipes_inspector_does_not_know_stays_empty(table: Any) -> None:
    assert list(table["Feature type"][table["Feature identification"] == "Joint"]) == ["Weld", "Joint"]
    for name in (
        "Latitude",
        "Nominal thickness [mm]",
        "ERF (metal losses)",
        "Anomaly dimension classification",
        "Mean depth [mm]",
        "Joint manufacturing type",
    ):
        assert table[name].isna().all()


def test_joints_are_counted_and_distances_are_to_the_one_before(table: Any) -> None:
    first, last, loss = line(table, "F1"), line(table, "F5"), line(table, "D1")
    assert (first["Girth weld Nr"], last["Girth weld Nr"]) == (1, 2)
    assert first["Joint / component length [m]"] == 0.170 and pandas.isna(last["Joint / component length [m]"])
    assert loss["Abs. dist. to upstream weld [m]"] == pytest.approx(0.026, abs=6e-4)  # 25.5 mm
    assert pandas.isna(first["Abs. dist. to upstream weld [m]"])
    assert (line(table, "D3")["Bend Y/N"], loss["Bend Y/N"]) == ("Y", "N")


def test_clock_positions_are_hours_and_minutes_from_noon_at_nought(table: Any) -> None:
    column = "Clock position seam weld / anomaly [hh:mm]"
    assert [line(table, name)[column] for name in ("D1", "D3", "U1")] == ["03:20", "11:00", "00:10"]
    assert pandas.isna(line(table, "F1")[column])  # all round
    assert (line(table, "D3")["Clock from [hh:mm]"], line(table, "D3")["Clock to [hh:mm]"]) == ("09:40", "00:20")
    assert (clock_time(359.9), clock_time(0.0), clock_time(180.0)) == (time(0, 0), time(0, 0), time(6, 0))


def test_an_uncertainty_is_rounded_up_and_a_half_goes_up(table: Any) -> None:
    assert line(table, "D1")["Depth k=2 [mm]"] == 0.11 and pandas.isna(line(table, "D2")["Depth k=2 [mm]"])
    assert line(table, "D3")["Log distance [m]"] == 0.246  # 245.5 mm
    assert line(table, "D2")["Depth is at least"] == "Y"


def test_job_and_severity_come_from_the_summary(table: Any, written: Written) -> None:
    assert line(table, "D1")["Severity"] == "major" and pandas.isna(line(table, "D2")["Severity"])
    about = {row[0].value: row[1].value for row in openpyxl.load_workbook(written("xlsx"))["Source"].rows}
    assert about["Job: Pipe"] == "P-12" and about["Job: operator.name"] == "A. B."
    assert about["Recording: controller.serial"] == "@77"
    assert "edition 2016, appendix 6" in about["Column order"] and about["Warning"] == "one frame is dark"


def test_the_workbook_holds_numbers_as_numbers_with_their_formats(written: Written, folder: Path) -> None:
    sheet = openpyxl.load_workbook(written("xlsx"))["Pipe tally"]
    head = [cell.value for cell in sheet[1]]
    assert head[:29] == POF_2016 and sheet.freeze_panes == "A2" and sheet.auto_filter.ref.startswith("A1:")
    rows = {row[head.index("No.")].value: row for row in sheet.iter_rows(min_row=2)}
    loss = json.loads((folder / "summary.json").read_text())["defects"][0]
    where, deep = rows["D1"][0], rows["D1"][head.index("Max. depth [mm]")]
    assert (where.value, where.number_format) == (pytest.approx(loss["z_mm"] / 1000, abs=1e-12), "0.000")
    assert (deep.value, deep.number_format) == (pytest.approx(loss["depth_mm"], abs=1e-12), "0.00")
    clock = rows["D1"][head.index("Clock position seam weld / anomaly [hh:mm]")]
    assert (clock.value, clock.number_format) == (time(3, 20), "hh:mm")


def test_the_workbooks_stations_are_those_of_the_results(written: Written, folder: Path) -> None:
    ours = pandas.read_csv(folder / "stations.csv")
    theirs = pandas.read_excel(written("xlsx"), sheet_name="Stations")
    assert len(theirs) == len(ours)
    assert (1000 * theirs["Distance [m]"] - ours["z_mm"]).abs().max() < 1e-9
    assert (theirs["Mean diameter [mm]"] - ours["diameter_mean_mm"]).abs().max() < 1e-9
    assert theirs["Mean diameter [mm]"].isna().sum() == 1  # a station that says nothing


def test_what_the_operator_marked_has_a_sheet_and_a_cross_in_the_plan(written: Written) -> None:
    rows = list(openpyxl.load_workbook(written("xlsx"))["Observations"].iter_rows(min_row=2, values_only=True))
    assert rows[0] == ("M1", 0.151, time(3, 0), "=1+1 weeps", "2026-05-04T09:02:00+00:00")
    assert rows[1] == ("M2", None, None, None, None)
    plan = [one for one in ezdxf.readfile(written("dxf")).modelspace() if one.dxf.layer == "PLAN-OBSERVATIONS"]
    assert sorted(one.dxftype() for one in plan) == ["LINE", "LINE", "TEXT"]
    assert [one.dxf.start.x + one.dxf.end.x for one in plan if one.dxftype() == "LINE"] == pytest.approx([302.0] * 2)


def test_no_text_becomes_a_formula(written: Written) -> None:
    book = openpyxl.load_workbook(written("xlsx"))
    kinds = {cell.data_type for sheet in book for row in sheet.rows for cell in row}
    assert "f" not in kinds
    texts = [cell.value for cell in book["Source"]["B"]]
    assert '=HYPERLINK("x")' in texts  # as it was written
    comments = pandas.read_csv(written("pof-csv"))["Comments"].dropna()
    assert {text for text in comments if text[:1] in "=+-@"} == set()
    assert any(text.startswith("'-butt fusion; height 2.50 ± 0.13 mm") for text in comments)
