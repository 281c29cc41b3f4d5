"""What the numbers of each topic rest on: whose truth, whose calibration, which seeds, how many draws, without what.

Rows are named by how their titles begin. tests/unit/tools/test_claims.py holds every row of RESULTS.md to having one.
"""

from collections.abc import Mapping

from tools.bench.table import Basis, Truth

SOURCE, TWIN, OTHER, REAL = Truth.SOURCE, Truth.TWIN, Truth.OTHER, Truth.REAL
TIME = Basis(Truth.NONE, "-", "-")
EDGES = "1.5 mm about edges"
CLAIMS: Mapping[str, Mapping[str, Basis]] = {
    "autocalibration": {
        "": Basis(SOURCE, "own", "set on", 10),
        "16 poses": Basis(SOURCE, "own", "set on", 6),
        "the same": Basis(SOURCE, "own", "set on", 6),
        "noise anew": Basis(SOURCE, "own", "set on", 6),
        "one ring at a time, the source's own": Basis(SOURCE, "own", "set on"),
        "all rings together, the source's own": Basis(SOURCE, "own", "set on"),
        "4 frames": Basis(SOURCE, "own", "set on"),
        "the same with noise": Basis(SOURCE, "own", "set on"),
        "solve": TIME,
        "time against": TIME,
    },
    "fine_tuning": {"": Basis(SOURCE, "own", "set on", 5), "perfect rings": Basis(SOURCE, "exact", "set on", 5)},
    "calibrate_scene": {"": Basis(OTHER, "own", "set on"), "8 frames: rings": TIME, "the same with JPEG": TIME},
    "intrinsics": {
        "13 real": Basis(REAL, "own", "set on", 1, "nothing; the residual is the fit's own, no truth beside it"),
        "drawn photographs": Basis(TWIN, "own", "set on", 1, "3 spoilt photographs of 12, by the product"),
        "rings on 9": Basis(TWIN, "own", "set on"),
    },
    "stabilisation": {"": Basis(SOURCE, "-", "set on", 200)},
    "few_rings": {"": Basis(TWIN, "exact", "set on")},
    "uncertainty": {
        "": Basis(TWIN, "exact", "set on", 1, EDGES),
        "true radii within k=2: pipe-a": Basis(OTHER, "exact", "set on", 1, EDGES),
        "true radii within k=2: twin, demo, another seed": Basis(TWIN, "exact", "held out", 1, EDGES),
    },
    "light": {"": Basis(OTHER, "exact", "set on")},
    "diameter": {
        "": Basis(TWIN, "exact", "set on", 20, "the calibration's error; ends of the pipe that not all rings pass"),
        "Radius of points": Basis(TWIN, "exact", "set on"),
    },
    "absolute": {"": Basis(TWIN, "exact, then drifted", "held out", 200)},
    "colour": {"": Basis(TWIN, "exact", "set on")},
    "artefacts": {
        "": Basis(TWIN, "exact", "set on"),
        "clean pipe": Basis(TWIN, "exact", "set on", 1, "20 rows at either end of the map"),
        "a wall corrugated": Basis(TWIN, "exact", "set on", 1, "20 rows at either end of the map"),
        "distorted slide": Basis(TWIN, "own", "set on"),
        "the same, said by": Basis(TWIN, "own", "set on"),
    },
    "back": {"": Basis(TWIN, "exact", "held out", 3)},
    "mirror": {
        "": Basis(TWIN, "exact", "set on"),
        "the same, rings calibrated": Basis(TWIN, "own", "set on"),
        "calibrated by itself": Basis(TWIN, "own", "set on"),
        "the pipe's radius": Basis(TWIN, "own", "set on"),
    },
    "stereo": {
        "Table 5.1": Basis(SOURCE, "exact", "set on", 60),
        "Head of tables": Basis(TWIN, "exact", "set on", 1, "defects: a clean pipe"),
        "stereo-calib-a": Basis(OTHER, "own", "set on"),
        "stereo-a": Basis(OTHER, "own", "set on"),
        "Time": TIME,
        "stereo-calib-a: adjustment": TIME,
    },
    "fringe": {
        "": Basis(OTHER, "own", "set on"),
        "Oscillation": Basis(SOURCE, "exact", "-"),
        "the same, ours": Basis(SOURCE, "exact", "-"),
        "no noise": Basis(SOURCE, "exact", "-"),
        "SNR": Basis(SOURCE, "exact", "set on"),
        "Steps off": Basis(SOURCE, "exact", "set on", 8),
        "told wrongly": Basis(SOURCE, "exact", "set on"),
        "the same: rms": Basis(SOURCE, "exact", "set on"),
        "16 flashes": TIME,
        "24 frames": TIME,
        "k = 2 covers": Basis(OTHER, "own", "set on", 1, "the median; 2 mm about things"),
        "the scan: radius": Basis(OTHER, "own", "set on", 1, "what its scorer aligns; before it in brackets"),
        "Model A, one camera": Basis(TWIN, "exact", "set on", 1, EDGES),
        "Model B": Basis(TWIN, "exact", "set on", 1, EDGES),
        "Model C": Basis(TWIN, "exact", "set on", 1, EDGES),
        "defects listed": Basis(TWIN, "exact", "set on", 1, EDGES),
    },
    "fringe_plate": {
        "": Basis(OTHER, "exact", "set on"),
        "10^6": Basis(TWIN, "exact", "set on"),
        "the same pixels": TIME,
    },
    "pattern": {"": Basis(TWIN, "exact", "set on")},
    "speed": {"": TIME},
}
