"""What viewers see of a frame, made of it only while somebody looks: a JPEG of half the size, the light of its rows,
and where its slits were decoded.

All of it is made in the publisher's process: what strangers cost, they cost there.
"""

import time
from typing import Any

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import Float32Array, Image
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.wall.profile import Profile

BANDS = 64  # of rows, whose light is told
COLUMN_STEP = 7  # every seventh column: odd, so that all colours of a mosaic have their share
SATURATED = 250  # of 255
SUBPIXELS = 8  # of a pixel of the picture of half the size
ON_PICTURE = 16_000  # pixels that 16 bits hold


def preview(header: FrameHeader, image: Image) -> tuple[dict[str, Any], bytes]:
    """Body and JPEG of topic preview/<camera>."""
    from annulus_pipe.record import viewers

    sides = {"width": header.width // 2, "height": header.height // 2}
    return {**header.to_dict(), "preview": sides, "published": time.time()}, viewers.preview(
        image.reshape(header.shape), header.encoding
    ).tobytes()


def rows(header: FrameHeader, image: Image) -> tuple[dict[str, Any], bytes]:
    """Body and light of topic rows/<camera>: float32, the mean of BANDS bands of rows, 0..255, first row first."""
    light, saturated = row_light(image.reshape(header.shape))
    body = {"index": header.index, "camera": header.camera, "label": header.label.value}
    return {**body, "edge": header.edge, "slot": header.slot, "saturated": saturated}, light.tobytes()


def row_light(image: Image) -> tuple[Float32Array, float]:
    """(BANDS,) mean light of bands of rows, 0..255, of an image (H, W) or (H, W, 3); what part of it is saturated."""
    some = image[:, ::COLUMN_STEP]
    lines = some.reshape(len(image), -1).mean(axis=1, dtype=np.float32)
    edges = np.linspace(0, len(lines), BANDS + 1).astype(int)
    bands = np.add.reduceat(lines, edges[:-1]) / np.maximum(np.diff(edges), 1)
    return bands.astype("<f4"), round(float(np.count_nonzero(some >= SATURATED) / some.size), 5)


def slits(profile: Profile, calibration: Calibration) -> tuple[dict[str, Any], bytes] | None:
    """Body and points of topic slits/<camera>: int16 x y of each point, 1/SUBPIXELS pixel of the picture of half the
    size, then uint8 ring of each. None where the pipe was not found.

    The points on the wall are seen again through pose and camera: what lies beside its slit in the picture is measured
    wrong, or calibrated wrong.
    """
    camera = calibration.camera
    if profile.pose is None or camera.mirror is not None:
        return None
    mine = profile.seen_by == calibration.cameras[0].id if calibration.others else slice(None)
    at = camera.project(profile.pose.to_camera(profile.points_mm[mine].astype(np.float64), profile.z_mm))
    ring = profile.ring[mine]
    half = (at - 0.5) / 2  # a pixel of it is made of four, whose middle is at .5
    seen = np.isfinite(half).all(axis=1) & (np.abs(half) * SUBPIXELS < ON_PICTURE).all(axis=1)
    places = np.rint(half[seen] * SUBPIXELS).astype("<i2")
    return {"index": profile.frame, "camera": profile.camera}, places.tobytes() + ring[seen].tobytes()
