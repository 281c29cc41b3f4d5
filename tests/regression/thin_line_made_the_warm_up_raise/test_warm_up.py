"""A laser line thinner than the drawn frame's grid left no wall to warm up with: a traceback before the first scan."""

import math

import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.numeric import compiling
from annulus_pipe.reprocess.ahead import compile_all
from annulus_pipe.reprocess.warmup import warmup_frame
from annulus_pipe.rings.reconstructor import Reconstructor


def plane(ring_px: float = 84.0, middle: float = 176.0) -> Calibration:
    """A flat laser plane that a small video camera sees as a ring of so many pixels in a pipe of 300 mm."""
    cone = Cone(math.pi / 2, (0.0, 0.0, 1.0), (0.0, 0.0, 250.0 * 150.0 / ring_px))
    camera = Camera("pinhole", 352, 288, 250.0, 250.0, middle, 144.0)
    return Calibration(camera, "", (cone,), 150.0, pattern={"kind": "line"})


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("ring_px", [84.0, 20.0, 140.0])
def test_the_drawn_line_is_as_wide_as_it_must_be(ring_px: float) -> None:
    known = plane(ring_px)
    assert len(Reconstructor(known).profile(warmup_frame(known), frame=0, z_mm=0.0).points_mm) > 600


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("head", [plane(4.0), plane(84.0), plane(2000.0), plane(middle=-400.0), plane(middle=30.0)])
def test_no_ring_makes_the_warm_up_raise(head: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    ready: list[str] = []
    monkeypatch.setattr(compiling, "is_now_ready", ready.append)
    compile_all(head)
    assert ready == ["line-1"]
