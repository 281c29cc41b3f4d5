"""What one projector frame says about the wall: the value that travels from workers to recorder, viewer and report."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe import untrusted
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray

POINTS_MAX = 64 * 4096  # more than any pattern times any polar grid; bounds what a stranger can make us hold


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """All points of one frame, in the pipe frame (x right, y down, z along the pipe, mm).

    `pose` is None when the pipe could not be found; such a profile has no points. `ring` counts from 0, innermost
    first; `direction` is the index of the polar direction; `colour` is the wall's colour beside the slit, RGB.
    `residual_mm` is the robust sigma of the points about the fitted cylinder; NaN without a pose. `rejected` counts
    every slit that was seen and not used, by reason; `timing_ms` the stages. `sigma_mm` is the standard deviation of
    each point's radius from the pipe's axis; NaN where nobody said. `ring_sigma_mm` (K, 2) are the parts of it that
    a ring's points have in common: how far its edges seem drawn, and what no other frame can show, such as what the
    calibration leaves; empty where nobody said. `seen_by` is the camera that saw each point; of a head with several it
    is their number where more than one did. `slit_rad` (K,) is half of the angle of light between the edges of each
    ring's slit, radians, 0 of a ring not seen; empty where nobody said.
    """

    frame: int
    z_mm: float
    pose: Pose | None
    points_mm: NDArray[np.float32]  # (N, 3)
    colour: NDArray[np.uint8]  # (N, 3)
    ring: NDArray[np.uint8]  # (N,)
    direction: NDArray[np.uint16]  # (N,)
    residual_mm: float = math.nan
    rejected: Mapping[str, int] = field(default_factory=dict)
    timing_ms: Mapping[str, float] = field(default_factory=dict)
    sigma_mm: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))  # (N,)
    lean_sigma_deg: float = math.nan  # how well the pose knows the head's lean; large with one ring
    camera: int = 0  # the frame's, see FrameHeader
    ring_sigma_mm: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    seen_by: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))  # (N,)
    slit_rad: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))  # (K,)

    def __post_init__(self) -> None:
        if len(self.seen_by) != len(self.ring):
            object.__setattr__(self, "seen_by", np.full(len(self.ring), self.camera, np.uint8))
        if len(self.sigma_mm) != len(self.ring):
            if len(self.sigma_mm):
                raise ValueError(f"a profile of {len(self.ring)} points has {len(self.sigma_mm)} sigmas")
            object.__setattr__(self, "sigma_mm", np.full(len(self.ring), np.nan, np.float32))

    def without(self, lost: BoolArray, reason: str) -> "Profile":
        """The same less some of its points (N,), counted in `rejected`."""
        kept = ~lost
        rejected = {**self.rejected, reason: self.rejected.get(reason, 0) + int(np.count_nonzero(lost))}
        return replace(
            self,
            points_mm=self.points_mm[kept],
            colour=self.colour[kept],
            ring=self.ring[kept],
            direction=self.direction[kept],
            sigma_mm=self.sigma_mm[kept],
            rejected=rejected,
            seen_by=self.seen_by[kept],
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain types and bytes (little-endian, row by row), as msgpack carries them."""
        p = self.pose
        return {
            "frame": self.frame,
            "camera": self.camera,
            "z_mm": self.z_mm,
            "pose": None if p is None else [p.rx, p.ry, p.tx, p.ty, *([] if p.roll is None else [p.roll])],
            "points": self.points_mm.astype("<f4").tobytes(),
            "colour": self.colour.tobytes(),
            "ring": self.ring.tobytes(),
            "direction": self.direction.astype("<u2").tobytes(),
            "sigma": self.sigma_mm.astype("<f4").tobytes(),
            **({"seen_by": self.seen_by.tobytes()} if (self.seen_by != self.camera).any() else {}),
            "ring_sigma": self.ring_sigma_mm.astype("<f4").tobytes(),
            **({"slit": self.slit_rad.astype("<f4").tobytes()} if len(self.slit_rad) else {}),
            "residual_mm": self.residual_mm,
            "lean_sigma_deg": self.lean_sigma_deg,
            "rejected": dict(self.rejected),
            "timing_ms": dict(self.timing_ms),
        }

    @classmethod
    def from_dict(cls, data: object) -> "Profile":
        """Inverse of `to_dict`. Raises ValueError naming what is wrong; never trusts a length or a type."""
        if not isinstance(data, Mapping):
            raise ValueError("a profile must be a mapping")
        ring = _array(data, "ring", "u1", 1)[:, 0]
        if len(ring) > POINTS_MAX:
            raise ValueError(f"a profile of {len(ring)} points, expected at most {POINTS_MAX}")
        points = _array(data, "points", "<f4", 3)
        colour = _array(data, "colour", "u1", 3)
        direction = _array(data, "direction", "<u2", 1)[:, 0]
        # recordings made before there was a sigma have none
        sigma = _array(data, "sigma", "<f4", 1)[:, 0] if "sigma" in data else np.full(len(ring), np.nan, np.float32)
        of_rings = _array(data, "ring_sigma", "<f4", 2) if "ring_sigma" in data else np.zeros((0, 2), np.float32)
        slit = _array(data, "slit", "<f4", 1)[:, 0] if "slit" in data else np.zeros(0, np.float32)
        seen_by = _array(data, "seen_by", "u1", 1)[:, 0] if "seen_by" in data else np.zeros(len(ring), np.uint8)
        if not len(seen_by) == len(sigma) == len(points) == len(colour) == len(direction) == len(ring):
            raise ValueError("a profile's arrays must be of one length")
        if not np.isfinite(points).all():
            raise ValueError("a profile's points must be finite")
        if len(of_rings) > 256 or not (of_rings >= 0).all() or np.isinf(of_rings).any():
            raise ValueError("a profile's ring_sigma must be two lengths a ring")
        if len(slit) > 256 or not ((slit >= 0) & (slit < math.pi)).all():
            raise ValueError("a profile's slit must be an angle a ring")
        if (sigma < 0).any() or np.isinf(sigma).any():
            raise ValueError("a profile's sigma must be a length or NaN")
        frame = untrusted.whole(data.get("frame"), "a profile's frame", 0, 2**63 - 1)
        pose = _pose(data.get("pose"))
        if pose is None and len(ring):
            raise ValueError("a profile without a pose has no points")
        return cls(
            frame,
            _finite(data.get("z_mm"), "z_mm"),
            pose,
            points.astype(np.float32),
            colour,
            ring,
            direction.astype(np.uint16),
            math.nan if pose is None else _finite(data.get("residual_mm"), "residual_mm"),
            {name: int(value) for name, value in _named(data, "rejected").items()},
            _named(data, "timing_ms"),
            sigma.astype(np.float32),
            math.nan if pose is None or "lean_sigma_deg" not in data else _lean_sigma(data["lean_sigma_deg"]),
            untrusted.whole(data.get("camera", 0), "a profile's camera", 0, 255),
            of_rings.astype(np.float32),
            seen_by if "seen_by" in data else np.zeros(0, np.uint8),
            slit.astype(np.float32),
        )


def _array(data: Mapping[Any, Any], key: str, kind: str, columns: int) -> NDArray[Any]:
    value = data.get(key)
    dtype = np.dtype(kind)
    if not isinstance(value, bytes) or len(value) % (dtype.itemsize * columns):
        raise ValueError(f"a profile's {key} must be bytes, a multiple of {dtype.itemsize * columns} long")
    return np.frombuffer(value, dtype).reshape(-1, columns)


def _finite(value: object, name: str) -> float:
    return untrusted.number(value, f"a profile's {name}")


def _lean_sigma(value: object) -> float:
    if isinstance(value, float) and math.isnan(value):  # nobody said
        return value
    if _finite(value, "lean_sigma_deg") < 0:
        raise ValueError(f"a profile's lean_sigma_deg is {value!r}, expected a number not below zero")
    return _finite(value, "lean_sigma_deg")


def _pose(value: object) -> Pose | None:
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) not in (4, 5):
        raise ValueError("a profile's pose must be four numbers, five with the roll, or null")
    return Pose(*(_finite(v, "pose") for v in value))


def _named(data: Mapping[Any, Any], key: str) -> dict[str, float]:
    value = data.get(key, {})
    if not isinstance(value, Mapping) or len(value) > 64 or not all(isinstance(k, str) for k in value):
        raise ValueError(f"a profile's {key} must map names to numbers")
    return {k: _finite(v, f"{key}.{k}") for k, v in value.items()}
