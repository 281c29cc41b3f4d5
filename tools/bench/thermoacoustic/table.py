"""A row of the thermoacoustic table: what the source reached, what theory gives, what we do."""

import sys
from dataclasses import dataclass
from pathlib import Path

from annulus.tai.study.figure import Figure

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
PICTURES = HERE / "pictures"


@dataclass(frozen=True, slots=True)
class Row:
    """`ok` is None where nothing was asked and the number only informs."""

    what: str
    source: str  # the dissertation's number, or "-"
    theory: str  # what can be reached at all, or is exact; or "-"
    target: str
    measured: str  # with unit
    ok: bool | None = None


def keep(name: str, plate: Figure) -> dict[str, float]:
    """Writes the plate's picture into PICTURES; its numbers."""
    PICTURES.mkdir(exist_ok=True)
    plate.save(PICTURES / f"{name}.png")
    print(f"{name}: {', '.join(f'{key} {value:.4g}' for key, value in plate.numbers.items())}", file=sys.stderr)
    return dict(plate.numbers)
