"""A row of the metrology table: what the source reached, what was asked, what we do in the same simulation."""

from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
SCENES = ROOT.parent / "shared" / "scenes"  # not on a user's machine: such rows are left out there
PICTURES = HERE / "pictures"


@dataclass(frozen=True, slots=True)
class Row:
    """`ok` is None where nothing was asked and the number only informs."""

    what: str
    source: str  # the dissertation's number, or "-"
    target: str
    measured: str  # with unit
    ok: bool | None
