"""Where the pipe is, seen from the camera."""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import transform


def rotation_x(angle: float) -> FloatArray:
    """Right-handed rotation about x by `angle` radians, (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle: float) -> FloatArray:
    """Right-handed rotation about y by `angle` radians, (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle: float) -> FloatArray:
    """Right-handed rotation about z by `angle` radians, (3, 3); clockwise looking forward, as y points down."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotations(rx: FloatArray, ry: FloatArray, roll: FloatArray) -> FloatArray:
    """(N, 3, 3) of many poses, Rx(rx) Ry(ry) Rz(-roll)."""
    (ca, sa), (cb, sb), (cr, sr) = ((np.cos(a), np.sin(a)) for a in (rx, ry, -roll))
    rows = [
        cb * cr,
        -cb * sr,
        sb,
        ca * sr + sa * sb * cr,
        ca * cr - sa * sb * sr,
        -sa * cb,
        sa * sr - ca * sb * cr,
        sa * cr + ca * sb * sr,
        ca * cb,
    ]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def composed(turns: FloatArray) -> FloatArray:
    """(3,) rotation vector, radians, of turns (N, 3) one after the other, each about the axes as the last left them."""
    whole = transform.Rotation.identity()
    for turn in transform.Rotation.from_rotvec(np.reshape(turns, (-1, 3))):
        whole = whole * turn
    return np.asarray(whole.as_rotvec())


@dataclass(frozen=True, slots=True)
class Pose:
    """The pipe in the camera frame: `camera = R pipe + T`, R = Rx(rx) Ry(ry) Rz(-roll), T = (tx, ty, 0).

    Angles in radians, lengths in mm. Roll about the pipe axis and a shift along it cannot be seen in a round pipe
    (Alzuhiri 2022, §4.3.2). The shift is zero here; the roll comes from another sensor, or is None and taken for zero:
    it is how far the head is turned clockwise, looking forward, from where image up is 12 o'clock. The pipe frame's
    z = 0 is the station of the camera.
    """

    rx: float = 0.0
    ry: float = 0.0
    tx: float = 0.0
    ty: float = 0.0
    roll: float | None = None

    @property
    def rotation(self) -> FloatArray:
        (ca, sa), (cb, sb) = ((math.cos(a), math.sin(a)) for a in (self.rx, self.ry))
        turned = np.array([[cb, 0.0, sb], [sa * sb, ca, -sa * cb], [-ca * sb, sa, ca * cb]])
        return turned if self.roll is None else turned @ rotation_z(-self.roll)

    @property
    def translation(self) -> FloatArray:
        return np.array([self.tx, self.ty, 0.0])

    def to_pipe(self, points: FloatArray, z_mm: float = 0.0) -> FloatArray:
        """(N, 3) mm in the camera frame -> pipe frame, the camera standing at station `z_mm`."""
        out = (points - self.translation) @ self.rotation
        out[..., 2] += z_mm
        return out

    def to_camera(self, points: FloatArray, z_mm: float = 0.0) -> FloatArray:
        """(N, 3) mm in the pipe frame -> camera frame; inverse of `to_pipe`."""
        return np.asarray((points - np.array([0.0, 0.0, z_mm])) @ self.rotation.T + self.translation)


def pose_of(axis: FloatArray, through_mm: FloatArray) -> Pose:
    """The pose of a pipe along `axis` through a point, in the same frame."""
    at = through_mm - through_mm[2] / axis[2] * axis
    ry = float(np.arcsin(axis[0]))
    return Pose(float(np.arctan2(-axis[1], axis[2])), ry, float(at[0]), float(at[1]))
