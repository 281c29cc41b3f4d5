"""How far each point may be off in radius: what the frame itself shows, and what calibration and pose leave open."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.numeric.jit import around, jit, middle
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.rings.polar import PolarGrid, ring_pixels
from annulus_pipe.rings.triangulate import RingOptics, meet_rings
from annulus_pipe.wall.pose import Fit

# All by topic uncertainty (93 to 97 % of true radii inside k = 2, over- and underexposed, blurred, noisy);
# UNKNOWN_PX by few_rings.
STEPS = 72  # directions the calibration's share is worked out in
LAG = 4  # directions; neighbouring lines share pixels, these do not
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
    out, drawn = np.empty(len(ring), np.float32), np.empty(len(calibrated_mm))
    slits = _Slits(ring, direction, points_mm, edge_blur, width_off_px, clipped)
    pose = _Placed(fit.pose.rotation, fit.pose.translation, fit.covariance)
    _combine(slits, pose, optics.mm_per_px, calibrated_mm, bias_px, out, drawn)
    fixed = np.hypot(bias_px * optics.mm_per_px, calibrated_mm.mean(axis=1))
    return out, np.stack([drawn, fixed], axis=1).astype(np.float32)


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


class _Slits(NamedTuple):
    """The points, (N,) each, as `point_sigma` takes them."""

    ring: IntArray
    direction: IntArray
    points: FloatArray  # (N, 3) mm, camera frame
    edge_blur: FloatArray
    width_off: FloatArray  # px
    clipped: BoolArray


class _Placed(NamedTuple):
    """The sensor in the pipe, and how well that is known."""

    rotation: FloatArray  # (3, 3)
    shift: FloatArray  # (3,) mm
    covariance: FloatArray  # (4, 4) of rx, ry, tx, ty


@jit
def _combine(slits, placed, mm_per_px, calibrated, least, out, drawn):  # type: ignore[no-untyped-def]
    """Written: `out` (N,) and `drawn` (K,), the sigmas of `point_sigma`, mm. least : px, of every place's bias."""
    ring, direction, points = slits.ring, slits.direction, slits.points
    edge_blur, width_off, clipped = slits.edge_blur, slits.width_off, slits.clipped
    rotation, shift, covariance = placed.rotation, placed.shift, placed.covariance
    rings, directions = calibrated.shape
    radius = np.zeros((rings, directions))  # 0: no point
    pose = np.empty(len(ring))
    pull = np.empty(4)
    for n in range(len(ring)):
        x, y, z = points[n, 0] - shift[0], points[n, 1] - shift[1], points[n, 2]
        u = x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0]
        v = x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1]
        ahead = x * rotation[0, 2] + y * rotation[1, 2] + z * rotation[2, 2]
        r = np.sqrt(u * u + v * v)
        radius[ring[n], direction[n]] = r
        # A lean turns the point about the camera; leans are small, so x and y of the two frames are alike here.
        pull[0], pull[1], pull[2], pull[3] = ahead * v / r, -ahead * u / r, -u / r, -v / r
        pose[n] = 0.0
        for a in range(4):
            for b in range(4):
                pose[n] += pull[a] * covariance[a, b] * pull[b]

    scatter, usual, median = np.empty(rings), np.ones(rings), np.zeros(rings)
    work = np.empty(max(directions, len(ring)))
    for k in range(rings):
        size = 0
        line = radius[k]
        for j in range(directions):
            r1, r2 = line[around(j + LAG, directions)], line[around(j + 2 * LAG, directions)]
            r3 = line[around(j + 3 * LAG, directions)]
            if line[j] > 0 and r1 > 0 and r2 > 0 and r3 > 0:
                work[size] = abs(r3 - line[j] - 3.0 * (r2 - r1))
                size += 1
        scatter[k] = SIGMA_OF_MAD / np.sqrt(20.0) * middle(work, size) if size >= LEAST else UNKNOWN_PX * mm_per_px[k]
        size = 0
        for j in range(directions):
            if line[j] > 0:
                work[size] = line[j]
                size += 1
        if size >= LEAST:
            median[k] = middle(work, size)
        size = 0
        for n in range(len(ring)):
            if ring[n] == k:
                work[size] = edge_blur[n]
                size += 1
        usual[k] = max(middle(work, size), 1e-9)

    size = 0
    for k in range(rings):
        if median[k] > 0:
            work[size] = median[k]
            size += 1
    wall = middle(work, size)
    apart = np.zeros(rings)
    if size > 1:
        size = 0
        for k in range(rings):
            if median[k] > 0:
                apart[k] = abs(median[k] - wall) / mm_per_px[k]
                work[size] = apart[k]
                size += 1
        bias = min(max(SIGMA_OF_MAD * middle(work, size), least), DRAWN_PX)
    else:
        bias = least
    share = np.empty(rings)  # px
    for k in range(rings):
        share[k] = apart[k] if bias < apart[k] < DRAWN_PX else bias
        drawn[k] = np.sqrt(max(share[k] ** 2 - least**2, 0.0)) * mm_per_px[k]
    for n in range(len(ring)):
        k = ring[n]
        soft = min(max(edge_blur[n] / usual[k], BLUR_LEAST), BLUR_MOST)
        place = (scatter[k] * soft) ** 2
        common = max(share[k], CLIPPED_PX) if clipped[n] else share[k]
        # the width scatters by twice what the middle does; only what is more is not noise
        other = max((0.5 * width_off[n] * mm_per_px[k]) ** 2 - 4.0 * place, 0.0) / 3.0
        out[n] = np.sqrt(place + (common * mm_per_px[k]) ** 2 + other + pose[n] + calibrated[k, direction[n]] ** 2)
