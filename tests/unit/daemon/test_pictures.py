"""Promises of what viewers see of a frame: the slits lie where the picture has them, the light of rows is the rows'."""

import math
from itertools import pairwise

import cv2
import numpy as np
import pytest

from annulus_pipe.daemon.pictures import BANDS, SUBPIXELS, preview, row_light, rows, slits
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray, Image
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import Label
from tests.unit.rings.drawn import calibration, draw

REACH_PX = 9  # of a look across a slit that is 8 px wide


def header(encoding: str, width: int, height: int) -> FrameHeader:
    return FrameHeader(5, None, 0, Label.PROJECTOR, "", None, None, None, 2.0, encoding, width, height)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_slits_lie_on_the_dark_lines_of_the_picture(model: str) -> None:
    cal = calibration(model)
    image = draw(cal, Pose(0.02, -0.015, 2.0, -1.5))
    found = slits(Reconstructor(cal).profile(image, frame=5, z_mm=0.0), cal)
    assert found is not None and found[0] == {"index": 5, "camera": 0}
    n = len(found[1]) // 5
    at = np.frombuffer(found[1], "<i2", 2 * n).reshape(n, 2) / SUBPIXELS * 2.0 + 0.5  # of the whole picture
    ring = np.frombuffer(found[1], np.uint8, offset=4 * n)
    assert set(ring) == set(range(5)) and n > 2000
    off = across(image, at, np.array([cal.camera.cx, cal.camera.cy]))
    assert np.isfinite(off).mean() > 0.9
    assert np.nanpercentile(np.abs(off), 99) < 0.6 and all(np.nanmedian(np.abs(off[ring == k])) < 0.3 for k in range(5))


def across(image: Image, at: FloatArray, centre: FloatArray) -> FloatArray:
    """(N,) px, how far from places the middle of the dark line there lies, outwards: between the places at which the
    light has fallen to half of what it is on each side; NaN where there is none."""
    step = np.arange(-REACH_PX, REACH_PX + 0.01, 0.25)
    out = (at - centre) / np.linalg.norm(at - centre, axis=1, keepdims=True)
    where = (at[:, None] + step[None, :, None] * out[:, None]).astype(np.float32)
    light = cv2.remap(np.ascontiguousarray(image.max(axis=2)), where, None, cv2.INTER_LINEAR).astype(float)
    middle = len(step) // 2
    found = np.full(len(at), math.nan)
    for i, line in enumerate(light):
        low = line[middle - 8 : middle + 9].min()
        inner, outer = (line[:middle].max() + low) / 2, (line[middle:].max() + low) / 2
        inside, outside = np.flatnonzero(line[:middle] > inner), np.flatnonzero(line[middle:] > outer)
        if len(inside) and len(outside):
            found[i] = (step[inside[-1]] + step[middle + outside[0]]) / 2
    return found


@pytest.mark.deep(gate="tests/unit/daemon/test_pictures.py::test_slits_lie_on_the_dark_lines_of_the_picture")
def test_a_frame_without_the_pipe_has_no_slits() -> None:
    cal = calibration()
    nothing = np.zeros((cal.camera.height, cal.camera.width, 3), np.uint8)
    assert slits(Reconstructor(cal).profile(nothing, frame=5, z_mm=0.0), cal) is None


@pytest.mark.parametrize("encoding", ["bayer_rggb8", "bgr8", "mono8"])
def test_a_preview_is_the_picture_of_half_the_size_and_says_when(encoding: str) -> None:
    shape = (96, 128, 3) if encoding == "bgr8" else (96, 128)
    image = np.full(shape, 40, np.uint8)
    image[48:] = 200
    body, jpeg = preview(header(encoding, 128, 96), image)
    small = np.asarray(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE), float)
    assert small.shape == (48, 64) and body["preview"] == {"width": 64, "height": 48} and body["index"] == 5
    assert abs(small[:20].mean() - 40) < 3 and abs(small[28:].mean() - 200) < 3
    assert body["published"] > 1.7e9


def test_the_light_of_rows_is_the_mean_of_bands_and_what_is_saturated_is_said() -> None:
    image = np.repeat(np.arange(0, 240, dtype=np.uint8)[:, None], 320, axis=1)
    light, saturated = row_light(image)
    assert len(light) == BANDS and saturated == 0.0
    edges = np.linspace(0, 240, BANDS + 1).astype(int)
    assert np.allclose(light, [np.arange(a, b).mean() for a, b in pairwise(edges)])
    image[:60] = 255
    body, part = rows(header("bayer_rggb8", 320, 240), image)
    assert body["saturated"] == 0.25 and body["label"] == "projector" and len(part) == 4 * BANDS
    assert np.frombuffer(part, "<f4")[:15].min() == 255.0
