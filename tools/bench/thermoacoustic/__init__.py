"""Thermoacoustics: codes, sound, images, microwaves and speed of sound, beside the source and beside theory."""

import sys
from pathlib import Path

from tools.bench.table import Table
from tools.bench.thermoacoustic.claims import CLAIMS
from tools.study.figure import Figure

TABLE = Table(
    __name__,
    "Thermoacoustics: the source's numbers, what theory allows, and ours",
    {
        "templates": "Codes and templates (§8.2)",
        "solver": "Sound: the solver (§7.6)",
        "imaging": "Images from 50 angles (§8.3)",
        "sound_speed": "Speed of sound, bad receivers",
        "microwaves": "Microwaves: where the power stays (§7.8.2)",
        "coded": "Coded against single, same noise (Tables 8.1 to 8.3)",
        "waveforms": "Codes beside chirps and stepped frequencies (§7.4)",
        "single_sided": "Glass-fibre plates from one side, through air (chapter 11)",
        "wires": "Two wires in agar, resolution (Fig. 8.13, 8.14)",
    },
    Path(__file__).parent,
    "make bench-thermoacoustic",
    CLAIMS,
)


def keep(name: str, figure: Figure) -> dict[str, float]:
    """Writes the figure's picture; its numbers."""
    figure.save(TABLE.pictures / f"{name}.png")
    print(f"{name}: {', '.join(f'{key} {value:.4g}' for key, value in figure.numbers.items())}", file=sys.stderr)
    return dict(figure.numbers)
