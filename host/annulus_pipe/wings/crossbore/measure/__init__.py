"""Cross bores: a capacitive head's log to where the pipe was drilled through a sewer. Arrays in, arrays out.

    account = detect(on_grid(log))
    [(one.odometer_mm, one.kind, one.phi_deg) for one in account.bores]

Chapter 10 of the source, and what its section 11.2 leaves undone. Angles: atan2(y, x) with y down, 90 is the invert.
Proven on simulated logs only.
"""

from annulus_pipe.wings.crossbore.measure.detect import (
    BORES,
    BoreDetections,
    BoreIndication,
    BoreKind,
    BoreLimits,
    detect,
    likely,
)
from annulus_pipe.wings.crossbore.measure.grid import Log, PipeGrid, on_grid
from annulus_pipe.wings.crossbore.measure.passage import Passage, Run
from annulus_pipe.wings.crossbore.measure.readings import CapacitiveHead, Gap, NoReadingReason

__all__ = [
    "BORES",
    "BoreDetections",
    "BoreIndication",
    "BoreKind",
    "BoreLimits",
    "CapacitiveHead",
    "Gap",
    "Log",
    "NoReadingReason",
    "Passage",
    "PipeGrid",
    "Run",
    "detect",
    "likely",
    "on_grid",
]
