"""What the numbers of each topic rest on, see tools/bench/metrology/claims.py."""

from collections.abc import Mapping

from tools.bench.table import Basis, Truth

TIME = Basis(Truth.NONE, "-", "-")
CLAIMS: Mapping[str, Mapping[str, Basis]] = {
    "ct": {"": Basis(Truth.OTHER, "exact", "set on"), "CPU": TIME, "memory": TIME, "512^3": TIME},
    "greys": {"": Basis(Truth.SECOND, "exact", "held out", 4)},
    "sweeps": {"": Basis(Truth.SECOND, "-", "held out", 400)},
    "statistics": {"": Basis(Truth.TWIN, "-", "held out", 1000)},
}
