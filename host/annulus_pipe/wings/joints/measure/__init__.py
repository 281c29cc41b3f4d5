"""Butt-fusion joints: a CT volume to surfaces, beads, density, heat-affected zone and flaws. Arrays in, arrays out.

    joint = image(ArrayVolume(grey, (0.288, 0.288, 0.288)))
    joint.zone.width, joint.thickness_mm, joint.flaws

Chapter 9 of the source. The pipe's axis is a line; planes at right angles to it are unrolled (`unwrap`), the wall's two
surfaces found (`surface`), the machine's traces taken out of the density between them (`density`). Angles run from the
volume's x towards its y, z along the axis from where it crosses the first slice. No CT of a PE joint is public: proven
on simulated ones only.
"""

from annulus_pipe.wings.joints.measure.features import features, maps, summary
from annulus_pipe.wings.joints.measure.flaws import Flaw
from annulus_pipe.wings.joints.measure.image import JointImage, Parts, image
from annulus_pipe.wings.joints.measure.strip import StripImage, strip
from annulus_pipe.wings.joints.measure.surface import Bead
from annulus_pipe.wings.joints.measure.unwrap import ArrayVolume, Volume
from annulus_pipe.wings.joints.measure.zone import Zone

__all__ = [
    "ArrayVolume",
    "Bead",
    "Flaw",
    "JointImage",
    "Parts",
    "StripImage",
    "Volume",
    "Zone",
    "features",
    "image",
    "maps",
    "strip",
    "summary",
]
