"""DIG.csv, as people write it, and as they should not."""

import csv
import io
import math
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from annulus_pipe.qualification.digs import COLUMNS, LIMITS, Dig, DugKind, read_digs
from annulus_pipe.vocabulary import AnnulusError

HEAD = ",".join(COLUMNS)


def read(folder: Path, text: str | bytes) -> tuple[Dig, ...]:
    path = folder / "digs.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return read_digs(path)


def test_a_dig_is_read_as_it_was_written(tmp_path: Path) -> None:
    digs = read(tmp_path, f"\ufeff{HEAD}\r\nD3, Loss ,1204,-95,1.90,0.10,16,26\r\n\r\n,sound,1450,180,,,,\r\n")
    assert digs[0] == Dig(2, "D3", DugKind.LOSS, 1204.0, 265.0, 1.9, 0.1, 16.0, 26.0)
    assert (digs[1].kind, digs[1].called) == (DugKind.SOUND, "line 4") and math.isnan(digs[1].depth_mm)


def test_three_columns_are_enough(tmp_path: Path) -> None:
    (dig,) = read(tmp_path, "depth_mm,z_mm,clock_deg\n1.5,100,0\n")
    assert dig.kind is DugKind.ANY and dig.depth_mm == 1.5 and math.isnan(dig.depth_u_mm)


def test_a_depth_of_nothing_is_sound_wall(tmp_path: Path) -> None:
    (dig,) = read(tmp_path, "kind,z_mm,clock_deg,depth_mm\nloss,100,0,0\n")
    assert dig.kind is DugKind.SOUND and math.isnan(dig.depth_mm)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "has no column z_mm, expected name, kind"),
        (HEAD, "has no digs"),
        ("z_mm;clock_deg;depth_mm\n1;2;3", "parted by semicolons"),
        ("z_mm,clock_deg,depth_in\n1,2,3", "column 'depth_in', expected depth_mm .1 in is 25.4 mm"),
        ("z_m,clock_deg,depth_mm\n1,2,3", "column 'z_m', expected z_mm .1 m is 1000 mm"),
        ("z_mm,clock_deg,depth_mm,colour\n1,2,3,red", "column 'colour' is not known"),
        ("z_mm,clock_deg,depth_mm,depth_mm\n1,2,3,4", "column depth_mm stands twice"),
        ("z_mm,clock_deg,depth_mm\n1,2,nan", "line 2: depth_mm is 'nan', expected a number in 0"),
        ("z_mm,clock_deg,depth_mm\n1,2,-1", "line 2: depth_mm is '-1'"),
        ("z_mm,clock_deg,depth_mm\n1,2,1_0", "line 2: depth_mm is '1_0'"),
        ("z_mm,clock_deg,depth_mm\n,2,1", "line 2: z_mm is empty"),
        ("z_mm,clock_deg,depth_mm\n1,400,1", "line 2: clock_deg is '400'"),
        ("z_mm,clock_deg,depth_mm\n1,2,3,4", "line 2: 4 cells, expected 3"),
        ("z_mm,clock_deg,depth_mm\n1,2,3\n1,2,3.1", "line 3: the same z_mm and clock_deg as line 2"),
        ("name,z_mm,clock_deg,depth_mm\nA,1,2,3\nA,4,2,3.1", "line 3: the name 'A' stands in line 2 too"),
        ("kind,z_mm,clock_deg,depth_mm\ndent,1,2,3", "line 2: kind is 'dent', expected loss, bump, ovality or sound"),
        ("kind,z_mm,clock_deg,depth_mm\nsound,1,2,3", "line 2: sound wall with a depth of 3 mm"),
        (b"\xff\xfe\x00z", "not a text file"),
        ('z_mm,clock_deg,depth_mm\n1,2,"3', "unexpected end of data"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path: Path, text: str | bytes, why: str) -> None:
    with pytest.raises(AnnulusError, match=why) as error:
        read(tmp_path, text)
    assert str(error.value).startswith(f"{tmp_path}/digs.csv: ") and "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.csv"):
        with pytest.raises(AnnulusError, match="Expected a table of digs"):
            read_digs(path)


def cells(column: str) -> st.SearchStrategy[float]:
    low, high = LIMITS[column]
    known = st.floats(max(low, 0.001 if column == "depth_mm" else low), high)
    return known if column in ("z_mm", "clock_deg") else known | st.just(math.nan)


ROWS = st.fixed_dictionaries(
    {column: cells(column) for column in LIMITS} | {"kind": st.sampled_from(["loss", "", "bump"])}
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=st.lists(ROWS, min_size=1, max_size=8, unique_by=lambda row: (row["z_mm"], row["clock_deg"] % 360.0)))
def test_every_table_comes_back_number_for_number(tmp_path: Path, rows: list[dict[str, float]]) -> None:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows([{k: "" if v != v else repr(v) if k != "kind" else v for k, v in row.items()} for row in rows])
    for row, dig in zip(rows, read(tmp_path, text.getvalue()), strict=True):
        for column in LIMITS:
            expected = row[column] % 360.0 if column == "clock_deg" else row[column]
            assert getattr(dig, column) == pytest.approx(expected, abs=0, nan_ok=True)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    text=st.binary(max_size=200) | st.text(max_size=200).map(lambda body: f"z_mm,clock_deg,depth_mm\n{body}".encode())
)
def test_nothing_but_one_line_comes_of_any_bytes(tmp_path: Path, text: bytes) -> None:
    try:
        read(tmp_path, text)
    except AnnulusError as error:
        assert "\n" not in str(error)
