"""What other programs show of a recording, in the schemas they know: said beside our own topics, never read by us.

Viewers measure in metres. Frames of reference: "pipe" is the pipe's, x right, y down, z along it; "camera" (of further
cameras "camera/1" ..) is the camera's, which stands where its label says the head was: at z, turned by its roll. How
the head leans and what it is off the axis is known with a profile only, whose points are in the pipe's frame already.
A preview's frame is "preview", because it has half the pixels: there its calibration has half the numbers.
"""

import math
from collections.abc import Hashable, Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.schema import build_file_descriptor_set

from annulus_pipe.numeric.arrays import FloatArray, Image
from annulus_pipe.record.codec import is_mosaic
from annulus_pipe.record.container import ChannelForm
from annulus_pipe.record.frames import DROPS_TOPIC

PREVIEW_TOPIC, POINTS_TOPIC, TRANSFORMS_TOPIC, LOG_TOPIC = "/preview", "/points", "/tf", "/log"
CALIBRATION_TOPIC, PREVIEW_CALIBRATION_TOPIC = "/calibration", "/preview_calibration"
PIPE, HEAD, PREVIEW = "pipe", "camera", "preview"  # frames of reference
PREVIEW_QUALITY = 80  # of a JPEG: 32 kB of 1664x1232 for 1.7 ms
WARNINGS = frozenset(
    {"disk", "ledger", "scan", "ending", "link", "lamps", "camera_died", "publisher_flooded", "odometer"}
)  # events that say that something went otherwise than it should

_Said = tuple[str, Any]  # a topic and what is said on it
_POINT = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)])
_M_MM = 1e-3


RAW, JPEG = RawImage, CompressedImage  # what pictures are


@cache
def _form(message: Hashable) -> ChannelForm:
    kind: Any = message
    return ChannelForm(kind.DESCRIPTOR.full_name, "protobuf", build_file_descriptor_set(kind).SerializeToString())


def form(message: Any) -> ChannelForm:
    """Of a protobuf message's class, as a file describes it."""
    return _form(message)


def stamp(utc_ns: int) -> Timestamp:
    seconds, nanoseconds = divmod(utc_ns, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanoseconds)


def of_camera(camera: int, name: str = HEAD) -> str:
    """A camera's frame of reference."""
    return f"{name}/{camera}" if camera else name


def of_note(topic: str, body: Mapping[str, Any], utc_ns: int) -> Iterator[_Said]:
    """What viewers are told of a note; nothing where it has nothing for them, or is no note of ours."""
    if topic == "/event" and isinstance(kind := body.get("kind"), str) and isinstance(text := body.get("text"), str):
        level = Log.Level.WARNING if kind in WARNINGS else Log.Level.INFO
        yield LOG_TOPIC, Log(timestamp=stamp(utc_ns), level=level, name=kind, message=text)
    elif topic == DROPS_TOPIC and isinstance(new := body.get("new"), Mapping):
        text = ", ".join(f"{count} {kind}" for kind, count in new.items())
        yield LOG_TOPIC, Log(timestamp=stamp(utc_ns), level=Log.Level.WARNING, name="drops", message=text)
    elif topic == "/mark" and isinstance(text := body.get("text"), str):
        yield LOG_TOPIC, Log(timestamp=stamp(utc_ns), level=Log.Level.INFO, name="mark", message=text)
    elif topic == "/profile" and (cloud := _cloud(body, utc_ns)) is not None:
        yield POINTS_TOPIC, cloud


def of_label(label: Mapping[str, Any], utc_ns: int) -> Iterator[_Said]:
    """Where the head is, by a frame's label."""
    z, roll = label.get("z_mm"), label.get("roll_deg")
    if isinstance(z, int | float) and math.isfinite(z):
        turned = math.radians(roll) if isinstance(roll, int | float) and math.isfinite(roll) else 0.0
        transforms = FrameTransforms()
        place = transforms.transforms.add(timestamp=stamp(utc_ns), parent_frame_id=PIPE, child_frame_id=HEAD)
        place.translation.z = _M_MM * z
        place.rotation.z, place.rotation.w = math.sin(turned / 2), math.cos(turned / 2)
        yield TRANSFORMS_TOPIC, transforms


def of_calibration(calibration: Mapping[str, Any], utc_ns: int) -> Iterator[_Said]:
    """The cameras of a calibration's file, where viewers have a model for them."""
    cameras = calibration.get("cameras") or [calibration.get("camera")]
    for number, camera in enumerate(cameras if isinstance(cameras, list) else []):
        if not isinstance(camera, Mapping):
            continue
        try:
            whose = int(camera.get("id", 0))
            yield f"{CALIBRATION_TOPIC}/{whose}", _intrinsics(camera, of_camera(whose), utc_ns, 1)
            yield f"{PREVIEW_CALIBRATION_TOPIC}/{whose}", _intrinsics(camera, of_camera(whose, PREVIEW), utc_ns, 2)
            yield TRANSFORMS_TOPIC, _mounted(camera, whose, number, utc_ns)
        except (KeyError, TypeError, ValueError):  # a mirror's, or none
            continue


def preview(image: Image, encoding: str) -> Image:
    """(N,) uint8, a JPEG of half the size, straight from the mosaic: no pixel is made up."""
    import cv2  # not by whom imports this: a recorder has to be up at once

    if is_mosaic(encoding):
        height, width = (side // 2 * 2 for side in image.shape[:2])
        order = encoding.removeprefix("bayer_")[:4]
        at = (divmod(order.index(colour), 2) for colour in "bgr")
        small = cv2.merge([np.ascontiguousarray(image[y:height:2, x:width:2]) for y, x in at])
    else:
        small = np.ascontiguousarray(image[::2, ::2])
    return np.asarray(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, PREVIEW_QUALITY])[1])


def jpeg_message(data: bytes, frame_id: str, utc_ns: int) -> CompressedImage:
    return CompressedImage(timestamp=stamp(utc_ns), frame_id=frame_id, data=data, format="jpeg")


def raw_message(width: int, height: int, encoding: str, step: int, frame_id: str, utc_ns: int) -> RawImage:
    """Without its pixels."""
    return RawImage(
        timestamp=stamp(utc_ns), frame_id=frame_id, width=width, height=height, encoding=encoding, step=step
    )


def _cloud(body: Mapping[str, Any], utc_ns: int) -> PointCloud | None:
    """A profile's points; None where it has none."""
    points, colours = body.get("points"), body.get("colour")
    if not isinstance(points, bytes) or not isinstance(colours, bytes) or not points:
        return None
    if len(points) % 12 or len(colours) * 4 != len(points):
        return None
    out = np.empty(len(points) // 12, _POINT)
    out["xyz"] = _M_MM * np.frombuffer(points, "<f4").reshape(-1, 3)
    out["rgba"][:, :3], out["rgba"][:, 3] = np.frombuffer(colours, np.uint8).reshape(-1, 3), 255
    cloud = PointCloud(timestamp=stamp(utc_ns), frame_id=PIPE, point_stride=_POINT.itemsize, data=out.tobytes())
    cloud.pose.orientation.w = 1.0
    for i, name in enumerate(("x", "y", "z")):
        cloud.fields.add(name=name, offset=4 * i, type=PackedElementField.NumericType.FLOAT32)
    for i, name in enumerate(("red", "green", "blue", "alpha")):
        cloud.fields.add(name=name, offset=12 + i, type=PackedElementField.NumericType.UINT8)
    return cloud


def _intrinsics(camera: Mapping[str, Any], frame_id: str, utc_ns: int, smaller: int) -> CameraCalibration:
    """`smaller`: of a picture that has so many times fewer pixels a side, made of the first of each."""
    model, distortion = camera["model"], [float(one) for one in camera.get("distortion", ())]
    if model not in ("pinhole", "fisheye"):
        raise ValueError(f"a {model} has no model there")
    (fx, fy), (cx, cy) = ((float(camera[a]), float(camera[b])) for a, b in (("fx", "fy"), ("cx", "cy")))
    if smaller > 1:  # the middle of 2x2 pixels is half a pixel beside the first one's
        fx, fy, cx, cy = fx / smaller, fy / smaller, (cx + 0.5) / smaller - 0.5, (cy + 0.5) / smaller - 0.5
    wanted = 4 if model == "fisheye" else 5 if len(distortion) <= 5 else 8
    named = {4: "kannala_brandt", 5: "plumb_bob", 8: "rational_polynomial"}[wanted]
    return CameraCalibration(
        timestamp=stamp(utc_ns),
        frame_id=frame_id,
        width=int(camera["width"]) // smaller,
        height=int(camera["height"]) // smaller,
        distortion_model=named,
        D=(distortion + wanted * [0.0])[:wanted],
        K=[fx, 0, cx, 0, fy, cy, 0, 0, 1],
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
    )


def _mounted(camera: Mapping[str, Any], whose: int, number: int, utc_ns: int) -> FrameTransforms:
    """Where a camera stands on the head, and its preview where it stands."""
    transforms = FrameTransforms()
    same = transforms.transforms.add(
        timestamp=stamp(utc_ns), parent_frame_id=of_camera(whose), child_frame_id=of_camera(whose, PREVIEW)
    )
    same.rotation.w = 1.0
    if of_camera(whose) != HEAD:
        turn = np.array(camera.get("rotation", np.eye(3)), float).reshape(3, 3)
        shift = np.array(camera.get("translation_mm", (0.0, 0.0, 0.0)), float).reshape(3)
        place = transforms.transforms.add(
            timestamp=stamp(utc_ns), parent_frame_id=HEAD, child_frame_id=of_camera(whose)
        )
        place.translation.x, place.translation.y, place.translation.z = -_M_MM * turn.T @ shift
        place.rotation.x, place.rotation.y, place.rotation.z, place.rotation.w = _quaternion(turn.T)
    return transforms


def _quaternion(turn: FloatArray) -> FloatArray:
    """(4,) x, y, z, w of a rotation (3, 3): the eigenvector of Bar-Itzhack's matrix, whatever the angle."""
    (a, b, c), (d, e, f), (g, h, i) = turn
    matrix = np.array(
        [
            [a - e - i, d + b, g + c, h - f],
            [d + b, e - a - i, h + f, c - g],
            [g + c, h + f, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    return np.asarray(np.linalg.eigh(matrix)[1][:, -1])
