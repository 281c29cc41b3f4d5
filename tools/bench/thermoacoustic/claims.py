"""What the numbers of each topic rest on, see tools/bench/metrology/claims.py."""

from collections.abc import Mapping

from tools.bench.table import Basis, Truth

SOURCE, TWIN, NONE = Truth.SOURCE, Truth.TWIN, Truth.NONE
CLOSED = Basis(NONE, "-", "-", 1, "nothing; held against theory, or against itself")
PLANE = Basis(TWIN, "exact", "set on")
CLAIMS: Mapping[str, Mapping[str, Basis]] = {
    "templates": {"": CLOSED},
    "solver": {"": CLOSED},
    "imaging": {"": PLANE},
    "sound_speed": {"": PLANE},
    "microwaves": {"": CLOSED, "three shapes": PLANE, "image's": PLANE},
    "coded": {"": PLANE},
    "waveforms": {"": CLOSED},
    "single_sided": {
        "": Basis(TWIN, "-", "held out", 12),
        "sound plates": Basis(TWIN, "-", "held out", 8),
        "both solvers": CLOSED,
        "both in one plate": Basis(TWIN, "-", "held out", 6),
    },
    "wires": {"": PLANE, "2 kW": Basis(TWIN, "exact", "set on", 100)},
}
