"""What a head with several cameras would know of a pipe, before anything is built: sigma by direction."""

from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.stereo.points import to_pipe
from annulus_pipe.stereo.reconstructor import generators, usual_pose
from annulus_pipe.stereo.view import view_of
from annulus_pipe.vocabulary import AnnulusError

EDGE_PX = 0.04  # sigma of a slit's place in a good picture: what stereo-a's were measured to be
COVERED = 0.003  # of the radius: no direction of a covered pipe is known worse than this, standard deviation


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """Of one pipe. sigma_mm (C + 1, K, P): of the radius, each camera alone and, last, all together; infinite where a
    ring is not seen or its ray is tangent. ahead_mm (K,): where each ring lands."""

    radius_mm: float
    sigma_mm: FloatArray
    ahead_mm: FloatArray

    @property
    def worst_mm(self) -> FloatArray:
        """(P,) of the ring that is known worst in each direction, all cameras together."""
        return np.asarray(self.sigma_mm[-1].max(axis=0))

    @property
    def is_covered(self) -> bool:
        """Whether every ring is known well enough all round."""
        return bool(self.worst_mm.max() <= COVERED * self.radius_mm)


def outlook(calibration: Calibration, radius_mm: float, directions: int = 360, edge_px: float = EDGE_PX) -> Outlook:
    """What the head would know of a clean pipe with its middle on the axis, whatever pipe it was calibrated in.

    Raises AnnulusError where the head does not fit the pipe: a camera or the projector outside of it."""
    pose = usual_pose(calibration)
    places = [-np.array(c.rotation).T @ np.array(c.translation_mm) for c in calibration.cameras]
    places += [np.array(ring.vertex_mm) for ring in calibration.rings]
    if max(float(np.hypot(*(p - pose.translation)[:2])) for p in places) >= radius_mm:
        raise AnnulusError(f"the head does not fit a pipe of {2 * radius_mm:g} mm: a part of it lies outside")
    cones, ways = generators(calibration, directions)
    vertices = cones[:, :3]
    start = to_pipe(vertices, pose, ways, radius_mm)
    points = vertices[:, None] + start[..., None] * ways
    outwards = np.abs((_away(points, pose) * ways[..., :2]).sum(axis=-1))
    known = np.zeros(start.shape)
    alone = []
    in_pipe = replace(calibration, pipe_radius_mm=radius_mm)
    for of in calibration.cameras:
        try:
            view = view_of(in_pipe, of, pose, 720)
        except AnnulusError:  # this camera sees none of a ring
            alone.append(np.full(start.shape, np.inf))
            continue
        e = view.expect(cones, ways, start, pose)
        lines = e.course.shape[1]
        slope = np.stack([np.gradient(row) for row in e.course])
        own = np.take_along_axis(slope, np.nan_to_num(e.line).astype(np.intp) % lines, axis=1)
        pixels = view.grid.pixels(np.nan_to_num(e.line.ravel()).astype(np.int64) % lines, e.place.ravel())
        size = np.array([of.camera.width - 1.0, of.camera.height - 1.0])
        seen = ((pixels >= 0) & (pixels <= size)).all(axis=1).reshape(start.shape)
        gain = np.where(seen, np.abs(e.place_by_mm - own * e.line_by_mm), 0.0)
        with np.errstate(divide="ignore"):
            alone.append(edge_px / np.nan_to_num(gain) * outwards)
        known += (np.nan_to_num(gain) / edge_px) ** 2
    with np.errstate(divide="ignore"):
        together = outwards / np.sqrt(known)
    return Outlook(radius_mm, np.stack([*alone, together]), points[..., 2].mean(axis=1))


def _away(points: FloatArray, pose: Pose) -> FloatArray:
    """(.., 2) unit vectors from the pipe's axis; the head does not lean."""
    off = points[..., :2] - pose.translation[:2]
    return np.asarray(off / np.linalg.norm(off, axis=-1, keepdims=True))
