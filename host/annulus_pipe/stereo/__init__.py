"""Two cameras beside one projector: 360 degrees of pipe without a rod or a glass tube in view (Alzuhiri 2022, ch. 5).

`StereoReconstructor` takes the frames of one flash to one `Profile` in the first camera's frame. A view (`view`) finds
and names the slits of one camera with `rings`; `merge` says where on its cone each ring met the wall, from all views.
"""

from annulus_pipe.stereo.reconstructor import CAMERA_MISSING, TWO_WALLS, StereoReconstructor
from annulus_pipe.stereo.swapped import swapped

__all__ = ["CAMERA_MISSING", "TWO_WALLS", "StereoReconstructor", "swapped"]
