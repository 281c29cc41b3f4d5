"""DIG.csv: what an excavation measured, one place a row, in millimetres and degrees as its column names say.

    name,kind,z_mm,clock_deg,depth_mm,depth_u_mm,length_mm,width_mm
    D3,loss,1204,95,1.90,0.10,16,26
    ,sound,1450,180,,,,

z_mm, clock_deg and depth_mm must be there. depth_u_mm is the expanded uncertainty (k = 2) of depth_mm. A cell that was
not measured is empty. Kind "sound" is wall that was looked at and has nothing. clock_deg counts clockwise from 12
o'clock, looking forward.
"""

import csv
import io
import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from annulus_pipe.untrusted import one_line, printable, read_file, shown
from annulus_pipe.vocabulary import AnnulusError

COLUMNS = ("name", "kind", "z_mm", "clock_deg", "depth_mm", "depth_u_mm", "length_mm", "width_mm")
REQUIRED = ("z_mm", "clock_deg", "depth_mm")
BYTES_MAX, ROWS_MAX, NAME_MAX = 1 << 20, 500, 60
LIMITS = {  # column: from to; what lies beyond was no dig's
    "z_mm": (-1e8, 1e8),
    "clock_deg": (-360.0, 360.0),
    "depth_mm": (0.0, 1e4),
    "depth_u_mm": (0.0, 1e4),
    "length_mm": (0.0, 1e6),
    "width_mm": (0.0, 1e5),
}
UNITS = {"in": "1 in is 25.4 mm", "inch": "1 in is 25.4 mm", "m": "1 m is 1000 mm", "cm": "1 cm is 10 mm"}


class DugKind(StrEnum):
    """What an excavation can find that a survey lists; ANY where the sheet leaves it open."""

    LOSS = "loss"
    BUMP = "bump"
    OVALITY = "ovality"
    SOUND = "sound"
    ANY = ""


@dataclass(frozen=True, slots=True)
class Dig:
    """One row. NaN: not measured. line : of the file."""

    line: int
    name: str
    kind: DugKind
    z_mm: float
    clock_deg: float
    depth_mm: float
    depth_u_mm: float
    length_mm: float
    width_mm: float

    @property
    def called(self) -> str:
        return self.name or f"line {self.line}"


def read_digs(path: Path) -> tuple[Dig, ...]:
    """All rows. Raises AnnulusError, one line with file, line and what was expected."""
    try:
        text = read_file(path, BYTES_MAX).decode("utf-8-sig")
        return _rows(text)
    except UnicodeDecodeError:
        raise AnnulusError(f"{path}: not a text file. Expected a table of digs with {', '.join(REQUIRED)}.") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror or error}). Expected a table of digs.") from None
    except (ValueError, csv.Error) as error:
        raise AnnulusError(f"{path}: {one_line(str(error))}.") from None


def _rows(text: str) -> tuple[Dig, ...]:
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    head = [name.strip() for name in next(reader, [])]
    _require_head(head)
    out: list[Dig] = []
    places: dict[tuple[float, float], int] = {}
    names: dict[str, int] = {}
    for row in reader:
        if not any(cell.strip() for cell in row):
            continue
        line = reader.line_num
        if len(row) != len(head):
            raise ValueError(f"line {line}: {len(row)} cells, expected {len(head)} as line 1 has")
        if len(out) == ROWS_MAX:
            raise ValueError(f"more than {ROWS_MAX} digs")
        one = _dig(line, dict(zip(head, (cell.strip() for cell in row), strict=True)))
        before = places.setdefault((one.z_mm, one.clock_deg), line)
        if before != line:
            raise ValueError(f"line {line}: the same z_mm and clock_deg as line {before}, expected one row a place")
        before = names.setdefault(one.name, line) if one.name else line
        if before != line:
            raise ValueError(f"line {line}: the name {shown(one.name)} stands in line {before} too")
        out.append(one)
    if not out:
        raise ValueError("has no digs, expected one place a row")
    return tuple(out)


def _require_head(head: list[str]) -> None:
    if len(head) == 1 and ";" in head[0]:
        raise ValueError("its cells are parted by semicolons, expected commas and decimal points")
    missing = [name for name in REQUIRED if name not in head]
    for name in head:
        if name in COLUMNS:
            continue
        stem, _, unit = name.rpartition("_")
        meant = next((one for one in COLUMNS if stem and one.rpartition("_")[0] == stem), "")
        if meant and unit in UNITS:
            raise ValueError(f"column {shown(name)}, expected {meant} ({UNITS[unit]})")
        if not missing:
            raise ValueError(f"column {shown(name)} is not known, expected {', '.join(COLUMNS)}")
    if missing:
        raise ValueError(f"has no column {missing[0]}, expected {', '.join(COLUMNS)}")
    twice = next((name for name in head if head.count(name) > 1), "")
    if twice:
        raise ValueError(f"column {twice} stands twice")


def _dig(line: int, cells: dict[str, str]) -> Dig:
    name = printable(cells.get("name", ""))
    if len(name) > NAME_MAX:
        raise ValueError(f"line {line}: a name of {len(name)} characters, expected at most {NAME_MAX}")
    kinds = [kind.value for kind in DugKind if kind]
    kind = cells.get("kind", "").lower()
    if kind and kind not in kinds:
        raise ValueError(f"line {line}: kind is {shown(kind)}, expected {', '.join(kinds[:-1])} or {kinds[-1]}")
    values = {column: _value(line, column, cells.get(column, "")) for column in LIMITS}
    for column in ("z_mm", "clock_deg"):
        if math.isnan(values[column]):
            raise ValueError(f"line {line}: {column} is empty, expected a number")
    if kind == DugKind.SOUND and values["depth_mm"] > 0.0:
        raise ValueError(f"line {line}: sound wall with a depth of {values['depth_mm']:g} mm, expected none")
    if values["depth_mm"] == 0.0:
        kind, values["depth_mm"] = DugKind.SOUND, math.nan
    values["clock_deg"] %= 360.0
    return Dig(line, name, DugKind(kind), **values)


def _value(line: int, column: str, cell: str) -> float:
    """NaN for an empty cell."""
    if not cell:
        return math.nan
    low, high = LIMITS[column]
    try:
        value = float(cell) if cell.isascii() and "_" not in cell else math.nan
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise ValueError(
            f"line {line}: {column} is {shown(cell)}, expected a number in {low:g}..{high:g}, or nothing where "
            "it was not measured"
        )
    return value
