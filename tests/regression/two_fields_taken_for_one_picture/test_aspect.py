"""Pixels that are not square made a round ring oval by 12 %: the whole way, from the container to the diameters."""

import math
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.scans.video import import_video
from annulus_pipe.wall.survey import survey

STORED, SQUARE, FRAMES = (352, 288), (396, 288), 8  # of pixels 9:8 wide
PARENTS = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd")
CONTENT = {b"stsd": 16}  # bytes from a box's start to the boxes in it, 8 elsewhere


def video(path: Path) -> Path:
    """A round ring as a camera of 9:8 pixels has it, without loss, and without a word about pixels."""
    v, u = np.mgrid[0 : STORED[1], 0 : STORED[0]]
    radius = np.hypot((u + 0.5) * 9 / 8 - 0.5 - 198, v - 144)
    light = 200 * np.exp(-0.5 * ((radius - 100) / 1.3) ** 2)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"FFV1"), 25, STORED)
    for i in range(FRAMES):
        noise = np.random.default_rng(i).normal(4, 2, (*radius.shape, 3))
        writer.write(np.clip(light[..., None] * (0.3, 0.1, 1.0) + noise, 0, 255).astype(np.uint8))
    writer.release()
    return path


def with_pixels(file: Path, wide: int, high: int) -> Path:
    """The same MP4 with a `pasp` box in its picture's description, ISO 14496-12, 12.1.4.2. Its index comes last, so no
    place of a picture moves."""
    data = bytearray(file.read_bytes())
    above: list[int] = []
    at = 0
    for name in PARENTS:
        while data[at + 4 : at + 8] != name:
            at += struct.unpack_from(">I", data, at)[0]
        above.append(at)
        at += CONTENT.get(name, 8)
    above.append(at)  # the description itself, of the first kind of picture
    end = at + struct.unpack_from(">I", data, at)[0]
    assert data.find(b"mdat") < above[0]
    data[end:end] = struct.pack(">I4sII", 16, b"pasp", wide, high)
    for start in above:
        struct.pack_into(">I", data, start, struct.unpack_from(">I", data, start)[0] + 16)
    out = file.with_name(f"{wide}-{high}.mp4")
    out.write_bytes(data)
    return out


def oval_percent(file: Path, size: tuple[int, int], scan: Path) -> float:
    """(Dmax - Dmin) / Dmean of the video's pipe, by a calibration of square pixels; the median over the stations."""
    import_video(file, scan, speed_mm_s=250.0)
    camera = Camera("pinhole", *size, 250.0, 250.0, size[0] / 2, 144.0)
    plane = Cone(math.pi / 2, (0.0, 0.0, 1.0), (0.0, 0.0, 375.0))
    head = Calibration(camera, "", (plane,), 150.0, pattern={"kind": "line"})
    known = Reconstructor(head)
    profiles = []
    for frame in open_scan(scan).frames:
        image = cv2.imread(str(scan / f"frames/{frame.index:06d}.png"))
        profiles.append(known.profile(image, frame=frame.index, z_mm=float(frame.z_mm or 0.0)))
    found = survey(profiles, head).stations
    spread = (found.diameter_max_mm - found.diameter_min_mm) / found.diameter_mean_mm
    return 100.0 * float(np.median(spread))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("pixels", [(9, 8), (18, 16), (1125, 1000)])
def test_a_round_ring_of_wide_pixels_is_round(pixels: tuple[int, int], tmp_path: Path) -> None:
    plain = video(tmp_path / "plain.mp4")
    assert oval_percent(with_pixels(plain, *pixels), SQUARE, tmp_path / "square") < 0.3
    # a container that says nothing: nobody can know
    assert oval_percent(plain, STORED, tmp_path / "stored") == pytest.approx(11.8, abs=0.5)
