"""Two surveys of one pipe: what has grown, against the truth of drawn pairs."""

from pathlib import Path

from tools.bench.table import Table

TABLE = Table(
    __name__,
    "Surveys over the years: growth between two wall maps against its truth",
    {"growth": "Two wall maps of one pipe"},
    Path(__file__).parent,
)
