"""What the numbers of each topic rest on, see tools/bench/metrology/claims.py."""

from collections.abc import Mapping

from tools.bench.table import Basis, Truth

CLAIMS: Mapping[str, Mapping[str, Basis]] = {
    "logs": {
        "": Basis(Truth.OTHER, "exact", "set on"),
        "a1: from start": Basis(Truth.NONE, "-", "-"),
        "a2: from start": Basis(Truth.NONE, "-", "-"),
    },
    "pipes": {
        "pipe": Basis(Truth.TWIN, "exact", "set on", 1000),
        "twin": Basis(Truth.TWIN, "exact", "held out", 60),
        "another drawer": Basis(Truth.SECOND, "exact", "held out", 10),
    },
}
