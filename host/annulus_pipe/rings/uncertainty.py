"""How far each point may be off in radius: what the frame itself shows, and what calibration and pose leave open."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.rings.polar import PolarGrid, ring_pixels
from annulus_pipe.rings.triangulate import RingOptics, meet_rings
from annulus_pipe.wall.pose import Fit

# All by topic uncertainty (93 to 97 % of true radii inside k = 2, over- and underexposed, blurred, noisy);
# UNKNOWN_PX by few_rings.
STEPS = 72  # directions the calibration's share is worked out in
LAG = 4  # directions; neighbouring lines share pixels, these do not
RING_POINTS = 20  # with fewer a ring does not count as seen
LEAST = 40  # values a ring's scatter is learnt from; with fewer a tenth of a pixel is taken
UNKNOWN_PX = 0.1
BIAS_PX = 0.0115  # an edge's place in a demosaiced image is within a fiftieth of a pixel, evenly: 0.02 / sqrt 3 ..
CLIPPED_PX = 0.04  # .. and within 0.07 where the light beside it is more than the camera can tell: half an edge is cut
DRAWN_PX = 0.5  # no edge is drawn out of the pixel it lies in: a ring farther off lies on another wall, a groove
BLUR_LEAST = 0.5  # of the ring's usual edge, what a sharper edge counts for at least ..
BLUR_MOST = 4.0  # .. and a softer one at most


def point_sigma(
    ring: NDArray[np.int64],
    direction: NDArray[np.int64],
    points_mm: FloatArray,
    edge_blur: FloatArray,
    width_off_px: FloatArray,
    clipped: NDArray[np.bool_],
    optics: RingOptics,
    calibrated_mm: FloatArray,
    fit: Fit,
    bias_px: float = BIAS_PX,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Standard deviation of each point's radius from the pipe's axis, (N,) mm; and of it, (K, 2), what all points of a
    ring have in common: how far its edges seem drawn, and what no other frame can show: `bias_px`, and what the
    calibration leaves, the mean round the ring.

    Parameters
    ----------
    ring, direction : (N,). points_mm : (N, 3) camera frame. edge_blur : (N,) of the slit's two edges, see `Slits`.
    width_off_px : (N,) by how much the slit's width differs from its ring's around there.
    clipped : (N,) whether a stripe beside the slit is over-exposed.
    calibrated_mm : (K, J) what the calibration leaves open, from `calibrated`.
    bias_px : what every place may be off alike, at least.

    Notes
    -----
    The sum of squares of, per point:
    - the slit's place. Its scatter is measured in this frame, ring by ring, from third differences of the radius along
      the ring (a slope and a bend of the wall fall out; noise, demosaicing and JPEG stay in), as a median, so that
      defects do not count. Within a ring it goes as the edges' blur: the place of the steepest slope is off by the
      noise over the curvature of the slope there.
    - a bias, which no scatter shows. Rings see one wall: how far their median radii lie apart, in pixels, is how far
      edges are drawn in this frame (by glare, demosaicing, saturation), and at least what no camera is free of.
    - a slit wider or narrower than its ring is there has an edge that is not its own: its middle is off by anything
      from nothing (both edges) to half of that (one), evenly.
    - the pose, by its covariance, and the calibration, by its own.
    """
    size = len(ring)
    slits = KeptSlits(
        np.arange(size),
        ring,
        direction,
        np.array(points_mm.T, np.float64, order="C"),
        np.array(edge_blur, np.float64),
        np.zeros(size),
        np.array(width_off_px, np.float64),
        clipped,
    )
    errors = PointErrors(slits, optics, calibrated_mm, bias_px)
    return errors.sigma(fit, size), errors.of_rings()


class KeptSlits(NamedTuple):
    """Slits that became points: kept (N,), which of all slits they are; ring, direction, edge_blur, width and
    width_off_px of all slits; points (3, N) mm, camera frame, and clipped (N,) of the kept."""

    kept: IntArray
    ring: IntArray
    direction: IntArray
    points: FloatArray
    edge_blur: FloatArray
    width: FloatArray
    width_off_px: FloatArray
    clipped: BoolArray


class PointErrors:
    """`point_sigma` in memory that is used again for each frame. usual_width (K,) : each ring's median, px, 0 of
    fewer than RING_POINTS."""

    def __init__(self, slits: KeptSlits, optics: RingOptics, calibrated_mm: FloatArray, bias_px: float) -> None:
        (rings, directions), most = calibrated_mm.shape, len(slits.kept)
        self.bias_px = bias_px
        self._mm_per_px, self._calibrated_mean = optics.mm_per_px, calibrated_mm.mean(axis=1)
        self._rotation, self._shift, self._covariance = np.empty((3, 3)), np.empty(3), np.empty((4, 4))
        self._out, self._drawn = np.empty(most, np.float32), np.zeros(rings)
        limits = np.array([LEAST, UNKNOWN_PX, CLIPPED_PX, DRAWN_PX, BLUR_LEAST, BLUR_MOST, SIGMA_OF_MAD, LAG])
        room = np.empty((rings, directions)), np.empty((rings, 5)), np.empty(max(most, directions, rings) + 1)
        pose, known = (self._rotation, self._shift, self._covariance), (optics.mm_per_px, np.array(calibrated_mm))
        self.usual_width = np.zeros(rings)
        written = *room, np.empty(most), self._out, self._drawn, self.usual_width
        self._sigma = _sigma.held(*slits, *pose, *known, ..., limits, RING_POINTS, ..., *written)

    def sigma(self, fit: Fit, size: int) -> NDArray[np.float32]:
        """(size,) of the first that were kept."""
        self._rotation[:], self._shift[:] = fit.pose.rotation, fit.pose.translation
        self._covariance[:] = fit.covariance
        self._sigma(self.bias_px, size)
        return self._out[:size].copy()

    def of_rings(self) -> NDArray[np.float32]:
        """(K, 2), see `point_sigma`."""
        out = np.empty((len(self._drawn), 2), np.float32)
        out[:, 0] = self._drawn
        out[:, 1] = np.hypot(self.bias_px * self._mm_per_px, self._calibrated_mean)
        return out


def calibrated(calibration: Calibration, grid: PolarGrid, optics: RingOptics) -> FloatArray:
    """(K, J) mm: what the covariance of the calibration leaves open of a point's radius on a clean pipe; 0 without one.

    A ring that is off also moves the pose, which takes back most of what all rings have in common. So each ring is
    moved by a little in each of its six numbers, the pose is fitted to what that does to the points of all rings, and
    the rest is the derivative that the covariance is carried through.
    """
    rings, directions = len(optics.cones), len(grid.cosine)
    if calibration.covariance is None:
        return np.zeros((rings, directions))
    turn = np.arctan2(grid.sine, grid.cosine)
    coarse = 2 * np.pi * np.arange(STEPS) / STEPS
    change = np.zeros((rings, STEPS, 6 * rings))
    pull = np.zeros((rings, STEPS, 4))
    for k, cone in enumerate(calibration.rings):
        pixels = ring_pixels(calibration.camera, cone, Pose(), calibration.pipe_radius_mm, STEPS)
        origins, ways = calibration.camera.lines(np.nan_to_num(pixels))
        at = meet_rings(origins, ways, optics.cones[k : k + 1])[:, 0]
        radius = np.hypot(at[:, 0], at[:, 1])
        place = np.arctan2(*(pixels - grid.centre).T[::-1])
        cosine, sine = at[:, 0] / radius, at[:, 1] / radius
        values = [sine * at[:, 2], -cosine * at[:, 2], -cosine, -sine]
        for number, step in enumerate((1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3)):
            moved = optics.cones[k].copy()
            moved[(6, 3, 4, 0, 1, 2)[number]] += step
            moved[3:6] /= np.linalg.norm(moved[3:6])
            there = meet_rings(origins, ways, moved[None])[:, 0]
            values.append((np.hypot(there[:, 0], there[:, 1]) - radius) / step)
        good = np.isfinite(pixels).all(axis=1) & np.isfinite(np.sum(values, axis=0))
        if good.sum() < 3:
            continue
        order = np.argsort(place[good])
        table = [np.interp(coarse, place[good][order], value[good][order], period=2 * np.pi) for value in values]
        pull[k] = np.stack(table[:4], axis=1)
        change[k, :, 6 * k : 6 * k + 6] = np.stack(table[4:], axis=1)
    weight = 1.0 / np.maximum(optics.mm_per_px, 1e-6)[:, None, None]
    design, moved_by = (pull * weight).reshape(-1, 4), (change * weight).reshape(-1, 6 * rings)
    taken = np.linalg.lstsq(design, moved_by, rcond=1e-9)[0]
    left = change - pull @ taken
    square = np.einsum("kip,pq,kiq->ki", left, np.array(calibration.covariance), left)
    sigma = np.sqrt(np.maximum(square, 0.0))
    return np.stack([np.interp(turn, coarse, row, period=2 * np.pi) for row in sigma])


_sigma = door(
    "rings_sigma",
    "i8[n] kept",
    "i8[s] ring",
    "i8[s] direction",
    "f8[3,n] points",
    "f8[s] blur",
    "f8[s] width",
    "f8[s] wider",
    "b1[n] clipped",
    "f8[3,3] rotation",
    "f8[3] shift",
    "f8[4,4] covariance",
    "f8[k] mm_per_px",
    "f8[k,j] calibrated",
    "f8 bias",
    "f8[l] limits",
    "i8 fewest",
    "i8 size",
    "f8[k,j]! table",
    "f8[k,5]! rings",
    "f8[w]! work",
    "f8[o]! pose",
    "f4[o]! out",
    "f8[k]! drawn",
    "f8[k]! usual_width",
)
