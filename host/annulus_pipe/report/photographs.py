"""A defect from close by, as a camera saw it, or its place on the map of colour: JPEG, its outline drawn in."""

import base64
import math

import cv2
import numpy as np

from annulus_pipe.numeric.arrays import FloatArray, Image
from annulus_pipe.numeric.rounding import clock_face
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.photograph import Photograph
from annulus_pipe.wall.survey import Survey

JPEG_QUALITY = 85
MAP_PX = 420  # the longer side of a part of the map of colour


def photograph(shown: Photograph) -> str:
    """A photograph with the outline and the clock's ticks drawn in, as the address of a JPEG."""
    picture = shown.image_bgr.copy()
    for line in shown.view.outline:
        _draw(picture, line[np.isfinite(line).all(axis=1)], closed=True)
    height, width = picture.shape[:2]
    for clock, ends in shown.view.ticks:
        if (ends >= 0).all() and (ends < (width, height)).all():
            _draw(picture, ends, closed=False)
            way = ends[1] - ends[0]
            where = ends[1] + 16.0 * way / max(float(np.hypot(*way)), 1.0)
            _word(picture, clock_face(clock), where)
    return _jpeg(picture)


def part_of_map(survey: Survey, index: int) -> str | None:
    """The place on the map of colour with its outline, distance to the right, clock downwards; None without a map."""
    wall, defect = survey.wall, survey.defects[index]
    if survey.texture is None or defect.kind is Kind.OVALITY:
        return None
    reach = 0.5 * max(defect.length_mm, 0.3 * wall.mean_radius_mm)
    first, last = np.searchsorted(wall.z_mm, (defect.z_range_mm[0] - reach, defect.z_range_mm[1] + reach))
    half = min(defect.arc_deg / 2 + math.degrees(reach / wall.mean_radius_mm), 180.0)
    count = min(max(round(2 * half / wall.clock_step_deg), 2), len(wall.clock_deg))
    start = round((defect.clock_deg - half) / wall.clock_step_deg)
    columns = np.arange(start, start + count) % len(wall.clock_deg)
    part = survey.texture[first:last][:, columns].swapaxes(0, 1)
    mask = (survey.detection.label[first:last][:, columns] == index + 1).T.astype(np.uint8)
    if not part.size or not (part[..., 3] > 0).any():
        return None
    high, wide = count * math.radians(wall.clock_step_deg) * wall.mean_radius_mm, (last - first) * wall.z_step_mm
    scale = MAP_PX / max(high, wide)
    size = max(1, round(wide * scale)), max(1, round(high * scale))
    grey = np.where(part[..., 3:] > 0, part[..., 2::-1], np.uint8(201))
    picture = cv2.resize(np.ascontiguousarray(grey), size, interpolation=cv2.INTER_LINEAR)
    outline, _ = cv2.findContours(
        (cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5).astype(np.uint8),
        cv2.RETR_EXTERNAL,
        cv2.CHAIN_APPROX_NONE,
    )
    for line in outline:
        _draw(picture, line[:, 0].astype(np.float64), closed=True)
    return _jpeg(picture)


def _draw(picture: Image, line: FloatArray, *, closed: bool) -> None:
    """Light on dark, to be seen on either."""
    points = np.rint(np.clip(line, -4096, 8192) * 16).astype(np.int32)
    for colour, width in (((28, 32, 40), 3), ((90, 230, 255), 1)):
        cv2.polylines(picture, [points], closed, colour, width, cv2.LINE_AA, shift=4)


def _word(picture: Image, text: str, where: FloatArray) -> None:
    (wide, high), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.4, 1)
    at = (
        int(np.clip(where[0] - wide / 2, 2, max(picture.shape[1] - wide - 2, 2))),
        int(np.clip(where[1] + high / 2, high + 2, picture.shape[0] - 3)),
    )
    for colour, width in (((28, 32, 40), 3), ((255, 255, 255), 1)):
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, width, cv2.LINE_AA)


def _jpeg(picture: Image) -> str:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")
