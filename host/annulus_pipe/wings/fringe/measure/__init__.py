"""A static slide of fringes, and the head's own motion as the phase shifter (Alzuhiri 2022, ch. 6).

A wall's point keeps its place while the slide's light moves over it: N >= 3 frames and where they were taken say its
phase, DC, AC and height. Point and light move through the image by amounts that depend on that height, so all are found
together, along the point's own track (`track`). Carried by: positions are true, the wall's albedo is a point's own,
grey levels are linear in light. A wrong position shows as a misfit that follows the texture: `steps` finds positions
from the frames. `noise` says what misfit is usual, `texture` takes out what albedo and blur do to the phase, `merge`
joins cameras, `stereo_phase` takes the phase two cameras agree on, whatever the slide, `stream` takes a scan as it
comes, `source` is the source's own method.

In a pipe (§6.8.2, Model A): `measure_pipe` makes a map of the radius, its head found from the scan itself (`placement`,
`bore`), `find_scratches` the defects of it, and `calibrate_pipe` the projector from a clean pipe; `ring_slide` says how
to draw the rings.
"""

from annulus_pipe.wings.fringe.measure.calibration import LENS as lens_names
from annulus_pipe.wings.fringe.measure.calibration import NAMES as plate_names
from annulus_pipe.wings.fringe.measure.calibration import PlateCalibration, ReferencePlate, calibrate_plate
from annulus_pipe.wings.fringe.measure.clean import CleanPipeFit, calibrate_pipe
from annulus_pipe.wings.fringe.measure.edges import edged
from annulus_pipe.wings.fringe.measure.head import FringeHead, SlideLamp, lamps_to_list, projector_to_dict
from annulus_pipe.wings.fringe.measure.heights import FringeView, Heights, Points, heights, spline
from annulus_pipe.wings.fringe.measure.merge import merged
from annulus_pipe.wings.fringe.measure.noise import noise_of
from annulus_pipe.wings.fringe.measure.order import told_elsewhere
from annulus_pipe.wings.fringe.measure.pipe import PipeMap, measure_pipe
from annulus_pipe.wings.fringe.measure.placement import Eye, Shots
from annulus_pipe.wings.fringe.measure.projector import FringeProjector
from annulus_pipe.wings.fringe.measure.scratches import find_scratches
from annulus_pipe.wings.fringe.measure.slide import RingSlide, ring_slide
from annulus_pipe.wings.fringe.measure.steps import Steps, find_steps
from annulus_pipe.wings.fringe.measure.stereo_phase import slide_seen, stereo_heights
from annulus_pipe.wings.fringe.measure.stream import stream
from annulus_pipe.wings.fringe.measure.texture import untextured
from annulus_pipe.wings.fringe.measure.transfer import Transfer, light_of, transfers

__all__ = [
    "CleanPipeFit",
    "Eye",
    "FringeHead",
    "FringeProjector",
    "FringeView",
    "Heights",
    "PipeMap",
    "PlateCalibration",
    "Points",
    "ReferencePlate",
    "RingSlide",
    "Shots",
    "SlideLamp",
    "Steps",
    "Transfer",
    "calibrate_pipe",
    "calibrate_plate",
    "edged",
    "find_scratches",
    "find_steps",
    "heights",
    "lamps_to_list",
    "lens_names",
    "light_of",
    "measure_pipe",
    "merged",
    "noise_of",
    "plate_names",
    "projector_to_dict",
    "ring_slide",
    "slide_seen",
    "spline",
    "stereo_heights",
    "stream",
    "told_elsewhere",
    "transfers",
    "untextured",
]
