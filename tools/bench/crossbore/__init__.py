"""Cross bores: what a capacitive head's log says, against the truth of simulated ones."""

from pathlib import Path

from tools.bench.crossbore.claims import CLAIMS
from tools.bench.table import Table

TABLE = Table(
    __name__,
    "Cross bores: simulated logs of a capacitive head against their truth",
    {"logs": "Logs of other programs", "pipes": "The three pipes of the source, and pipes the twin draws (ch. 10)"},
    Path(__file__).parent,
    "make bench-crossbore",
    CLAIMS,
)
