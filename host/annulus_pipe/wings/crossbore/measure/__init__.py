"""Cross bores: a capacitive head's log to where the pipe was drilled through a sewer. Arrays in, arrays out.

    account = detect(on_grid(log))
    [(one.odometer_mm, one.kind, one.phi_deg) for one in account.bores]

Chapter 10 of the source, and what its section 11.2 leaves undone. Angles: atan2(y, x) with y down, 90 is the invert.
Proven on simulated logs only.
"""

from annulus_pipe.wings.crossbore.measure.detect import BORES, Account, Indication, Kind, Limits, detect, likely
from annulus_pipe.wings.crossbore.measure.grid import Grid, Log, on_grid
from annulus_pipe.wings.crossbore.measure.passage import Passage, Run
from annulus_pipe.wings.crossbore.measure.readings import Gap, Head, Why

__all__ = [
    "BORES",
    "Account",
    "Gap",
    "Grid",
    "Head",
    "Indication",
    "Kind",
    "Limits",
    "Log",
    "Passage",
    "Run",
    "Why",
    "detect",
    "likely",
    "on_grid",
]
