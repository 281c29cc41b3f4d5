"""Butt-fusion joints: what a CT volume says, against the truth of simulated ones."""

from pathlib import Path

from tools.bench.joints.claims import CLAIMS
from tools.bench.table import Table

TABLE = Table(
    __name__,
    "Butt-fusion joints: simulated CT volumes against their truth",
    {
        "ct": "A joint's CT volume (ch. 9)",
        "greys": "One joint in many scales of grey",
        "sweeps": "Resonant probes over frequency (ch. 9)",
        "statistics": "What chance makes of strengths (ch. 9)",
    },
    Path(__file__).parent,
    "make bench-joints",
    CLAIMS,
)
