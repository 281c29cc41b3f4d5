"""Blind draws of the other methods: `python -m tools.bench blind --of joints --seed N [--pipes K] [--jobs 2]`.

A kind is a module with one verb, `measured(seed, folder)`: it draws something with a known truth from the seed, by code
that shares no line with the method's twin, the bench's other drawers or the solver, runs what a user would run on it,
and says what came of it (`tally.Case`). Even and odd seeds as for the pipes: see `tools.bench.blind`.
"""

KINDS = {
    "joints": "CT volumes of butt-fusion joints, of any grey scale",
    "crossbore": "logs of other capacitive heads through other ground",
    "calibration": "photographs of chessboards through lenses of other families",
    "stereo": "one flash of two cameras, other baselines, lenses and walls",
    "fringe": "plates under slides that a lens distorts, from the reference plate on",
}
