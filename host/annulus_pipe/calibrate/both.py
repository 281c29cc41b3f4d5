"""`annulus calibrate camera --second`: both cameras of a head, and where the second stands, from a target before both.

It is a second way to what `annulus calibrate pipe` finds with the rings (Alzuhiri 2022, Eq. 5.12), independent of
projector and pipe: its scale comes from the target's squares, theirs from the pipe's radius. `disagreement` compares.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.calibrate.camera import CameraCalibration
from annulus_pipe.geometry.calibration import camera_to_dict
from annulus_pipe.geometry.seen_by_both import Moment, PlacedCamera, place_second
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import transform
from annulus_pipe.rings.calibration.bundle import Solution, turned_by
from annulus_pipe.storage.calibration_file import update_calibration
from annulus_pipe.vocabulary import AnnulusError

AGREES = 3.0  # sigma, of the worst of six numbers


@dataclass(frozen=True, slots=True)
class BothCameras:
    """Cameras, and the second one's place. moments: names of the photographs of each moment at which both show all that
    is needed of the target."""

    cameras: tuple[CameraCalibration, CameraCalibration]
    placed: PlacedCamera
    moments: tuple[tuple[str, str], ...]

    @property
    def left_out(self) -> tuple[tuple[str, str], ...]:
        """Moments that contradict the others."""
        return tuple(names for names, used in zip(self.moments, self.placed.used, strict=True) if not used)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, degrees and mm."""
        sigma = np.sqrt(np.diag(self.placed.covariance))
        return {
            "turned_deg": float(np.degrees(transform.Rotation.from_matrix(self.placed.rotation).magnitude())),
            "turned_sigma_deg": float(np.degrees(sigma[:3].max())),
            "centre_mm": self.placed.centre_mm.tolist(),
            "centre_sigma_mm": sigma[3:].tolist(),
            "moments": [
                {"files": list(names), "rms_px": float(rms), "used": bool(used)}
                for names, rms, used in zip(self.moments, self.placed.rms_px, self.placed.used, strict=True)
            ],
        }


def pair_files(first: Sequence[Path], second: Sequence[Path]) -> list[tuple[int, int]]:
    """Photographs of one moment: those of one name, or, where no two have one, by their order in each list.

    Raises AnnulusError, one line, where neither can be."""
    where = {file.name: i for i, file in enumerate(second)}
    if {file.resolve() for file in first} & {file.resolve() for file in second}:
        raise AnnulusError("the same photographs are given for both cameras, expected those of each in a folder")
    named = [(i, where[file.name]) for i, file in enumerate(first) if file.name in where]
    if named:
        return named
    if len(first) != len(second):
        raise AnnulusError(
            f"{len(first)} photographs by the first camera and {len(second)} by the second, none of one name: expected "
            "files named alike where they are of one moment, or as many of each, in the same order"
        )
    return [(i, i) for i in range(len(first))]


def join_cameras(first: CameraCalibration, second: CameraCalibration, pairs: Sequence[tuple[int, int]]) -> BothCameras:
    """Where the second camera stands, from the moments at which both show the target's own corners, or all of it.

    Raises AnnulusError, one line, where they are too few, do not agree, or are of two targets."""
    corners = {(one.target.columns, one.target.rows) for one in (first, second)}
    if len(corners) > 1:
        raise AnnulusError(
            f"the first camera shows a {first.target}, the second a {second.target}: expected one target"
        )
    whole = first.target.columns * first.target.rows
    places = [np.cumsum([not p.rejected for p in one.photographs]) - 1 for one in (first, second)]
    moments, names = [], []
    for i, j in pairs:
        a, b = first.photographs[i], second.photographs[j]
        alike = a.own_origin and b.own_origin
        if not (a.rejected or b.rejected) and (alike or a.corners == b.corners == whole):
            moments.append(Moment(int(places[0][i]), int(places[1][j]), alike))
            names.append((a.file, b.file))
    return BothCameras((first, second), place_second(first.intrinsics, second.intrinsics, moments), tuple(names))


def save_both(result: BothCameras, path: Path) -> bool:
    """Write `cameras`, and `target_placement`: where the second stands, to be compared with. True when rings
    measured with other cameras stand beside them."""
    turn = result.placed.rotation.T
    still = {"rotation": np.eye(3).tolist(), "translation_mm": [0.0, 0.0, 0.0]}
    stands = {"rotation": turn.tolist(), "translation_mm": (-turn @ result.placed.centre_mm).tolist()}
    cameras = [
        {"id": number, **camera_to_dict(one.camera), **place}
        for number, (one, place) in enumerate(zip(result.cameras, (still, stands), strict=True))
    ]
    details = [{key: value for key, value in one.to_dict().items() if key != "camera"} for one in result.cameras]
    target = {"camera": 1, **stands, "covariance": result.placed.covariance.tolist()}
    made = {"by": "annulus calibrate camera", "cameras": details, **result.to_dict()}
    kept = update_calibration(path, {"cameras": cameras, "target_placement": target}, {"cameras": made})
    return "rings" in kept


@dataclass(frozen=True, slots=True)
class TargetPlacement:
    """Where a target said that a camera stands, in the first one's frame."""

    camera: int
    rotation: FloatArray  # (3, 3)
    centre_mm: FloatArray  # (3,)
    covariance: FloatArray  # (6, 6), see geometry.seen_by_both.PlacedCamera


def placement_from_dict(data: object) -> TargetPlacement | None:
    """Of a parsed calibration; None where it has none. Raises ValueError naming the key that is wrong."""
    target = data.get("target_placement") if isinstance(data, Mapping) else None
    if target is None:
        return None
    if not isinstance(target, Mapping):
        raise ValueError('"target_placement" must be an object')
    rows = {"rotation": (3, 1.001), "covariance": (6, 1e6)}
    matrices = {}
    for key, (size, most) in rows.items():
        value = target.get(key)
        if not isinstance(value, list) or len(value) != size:
            raise ValueError(f'"target_placement.{key}" must be {size} rows of {size} numbers')
        matrices[key] = np.array([untrusted.numbers(row, f'"target_placement.{key}"', (size,), most) for row in value])
    turn, cover = matrices["rotation"], matrices["covariance"]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-5 or np.linalg.det(turn) < 0:
        raise ValueError('"target_placement.rotation" is no rotation')
    if np.abs(cover - cover.T).max() > 1e-9 * np.abs(cover).max() or np.diag(cover).min() <= 0:
        raise ValueError('"target_placement.covariance" is none')
    moved = np.array(untrusted.numbers(target.get("translation_mm"), '"target_placement.translation_mm"', (3,), 1e4))
    number = untrusted.whole(target.get("camera"), '"target_placement.camera"', 0, 255)
    return TargetPlacement(number, turn.T, -turn.T @ moved, cover)


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Between a target and the rings about where a camera stands."""

    camera: int
    turned_deg: float
    moved_mm: float
    sigmas: float  # of the worst of three turns and three coordinates, in standard deviations of both together

    @property
    def agrees(self) -> bool:
        return self.sigmas <= AGREES


def disagreement(target: TargetPlacement, camera: int, number: int, solution: Solution) -> Disagreement | None:
    """Against the `number`-th camera after the first, whose id is `camera`; None where the target was not before it."""
    if target.camera != camera:
        return None
    placed = solution.cameras[number]
    own = solution.camera_covariance[6 * number : 6 * number + 6, 6 * number : 6 * number + 6]
    to_turn = np.eye(6)
    to_turn[:3, :3] = turned_by(transform.Rotation.from_matrix(placed.rotation).as_rotvec())
    turn = transform.Rotation.from_matrix(placed.rotation @ target.rotation.T).as_rotvec()
    off = np.concatenate([turn, placed.centre_mm - target.centre_mm])
    sigma = np.sqrt(np.diag(to_turn @ own @ to_turn.T + target.covariance))
    return Disagreement(
        camera,
        float(np.degrees(np.linalg.norm(turn))),
        float(np.linalg.norm(off[3:])),
        float(np.abs(off / sigma).max()),
    )
