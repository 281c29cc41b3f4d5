"""Probability of detection: does a stated a90/95 lie above the true a90 as often as it says?"""

from pathlib import Path

from tools.bench.table import Table

TABLE = Table(
    __name__,
    "Probability of detection: coverage of a90/95 in simulated studies",
    {"hit_miss": "By hits and misses (ASTM E2862)", "signal_response": "By reported depths (ASTM E3023)"},
    Path(__file__).parent,
)
