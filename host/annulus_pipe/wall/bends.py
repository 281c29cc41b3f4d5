"""Bends, tapers and reducers: pieces of the centre line in the words of an inspector.

A piece that is not surely bent or tapered stands for something all the same: the line is another one behind it. It may
be a joint that nothing shows; then it has no name, and neither has a joint that ends it.
"""

import math

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.rounding import clock_face
from annulus_pipe.wall.adjustment import CURVATURE, PIECE, START, TAPER
from annulus_pipe.wall.axis import Axis, Begins
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure

# What bends with known truth begin elsewhere than the adjustment says, and what their plane is off.
UNMODELLED_MM = 0.2  # of where a bend begins, k = 1: a real one does not begin at once, as the model's does
UNMODELLED_TURN = 0.002  # radians, k = 1: of the plane it lies in, likewise
REDUCER = 0.05  # of the radius: what changes by more within a diameter is a reducer, a fitting; less is a pipe's taper
SURE = 2.0  # times k = 2, as `axis` asks of a joint: what turns or narrows less surely has no name


def find_bends(axis: Axis, scanned_mm: tuple[float, float], common_mm: float = 0.0) -> tuple[Feature, ...]:
    """Every bend and taper, in order of distance; one that goes on where the scan ends, ends there. common_mm : what
    all radii may be off alike, which a change of them has nothing of."""
    if axis.adjusted is None:
        return ()
    out = []
    for i, piece in enumerate(axis.centreline.pieces):
        last = i + 1 == len(axis.centreline.pieces)
        end = scanned_mm[1] if last else axis.centreline.pieces[i + 1].start_mm
        start = max(piece.start_mm, scanned_mm[0])
        if end <= start:
            continue
        if piece.is_bent:
            out.append(_bend(axis, i, start, end, last))
        if piece.taper != 0.0 and axis.begins[i] is Begins.TAPER:
            out.append(_taper(axis, i, start, end, last, common_mm))
    return tuple(out)


def is_sure(axis: Axis, i: int) -> bool:
    """Whether a piece that bends or tapers surely does so; of others, True."""
    if axis.adjusted is None or i + 1 == len(axis.centreline.pieces):
        return True
    piece, begin, end = axis.centreline.pieces[i], *(one.start_mm for one in axis.centreline.pieces[i : i + 2])
    if piece.is_bent:
        return _bend(axis, i, begin, end, last=False).kind is FeatureKind.BEND
    return piece.taper == 0.0 or _taper(axis, i, begin, end, last=False, common_mm=0.0).kind is not FeatureKind.NAMELESS


def _bend(axis: Axis, i: int, start: float, end: float, last: bool) -> Feature:
    assert axis.adjusted is not None
    piece, diameter = axis.centreline.pieces[i], 2.0 * axis.centreline.pieces[i].radius_mm
    k = math.hypot(*piece.curvature)
    way = np.array(piece.curvature) / k
    length = end - start
    by = np.zeros((3, len(axis.centreline.pieces) * PIECE))  # what each number does to radius, angle, plane
    at = i * PIECE
    by[0, at + CURVATURE.start : at + CURVATURE.stop] = -way / k**2
    by[1, at + CURVATURE.start : at + CURVATURE.stop] = way * length
    by[2, at + CURVATURE.start : at + CURVATURE.stop] = np.array([-way[1], way[0]]) / k
    by[1, at + START] = -k
    if not last:
        by[1, at + PIECE + START] = k
    radius_k2, angle_k2, plane_k2 = _k2(axis, by)
    angle = math.degrees(k * length)
    plane = math.degrees(math.atan2(way[1], way[0]))
    if angle < SURE * math.degrees(angle_k2):
        turns = (FeatureMeasure("angle_deg", angle, math.degrees(angle_k2)),)
        return Feature(
            FeatureKind.NAMELESS, (start + end) / 2, length, measures=turns, remark="a bend, a joint or neither"
        )
    toward = clock_face(plane + 90.0)
    remark = f"{1 / k / diameter:.1f} D, {angle:.0f} degrees, to {toward.removesuffix(':00')}"
    measures = (
        FeatureMeasure("start_mm", start, 2.0 * math.hypot(axis.adjusted.sigma(i, START), UNMODELLED_MM)),
        FeatureMeasure("radius_mm", 1.0 / k, radius_k2),
        FeatureMeasure("angle_deg", angle, math.degrees(angle_k2)),
        FeatureMeasure("plane_deg", plane, math.degrees(math.hypot(plane_k2, 2.0 * UNMODELLED_TURN))),
    )
    return Feature(FeatureKind.BEND, (start + end) / 2, length, measures=measures, remark=f"{remark} o'clock")


def _taper(axis: Axis, i: int, start: float, end: float, last: bool, common_mm: float) -> Feature:
    piece = axis.centreline.pieces[i]
    before, after = (piece.radius_mm + piece.taper * (z - piece.start_mm) for z in (start, end))
    by = np.zeros((1, len(axis.centreline.pieces) * PIECE))
    by[0, i * PIECE + TAPER] = end - start
    by[0, i * PIECE + START] = -piece.taper
    if not last:
        by[0, (i + 1) * PIECE + START] = piece.taper
    (change_k2,) = _k2(axis, by)
    if abs(after - before) < SURE * change_k2:
        remark = "a taper, a joint or neither"
        return Feature(FeatureKind.NAMELESS, (start + end) / 2, end - start, remark=remark)
    short = end - start < 2.0 * piece.radius_mm and abs(after - before) > REDUCER * piece.radius_mm
    measures = (
        FeatureMeasure("radius_before_mm", before, math.hypot(change_k2, 2.0 * common_mm)),
        FeatureMeasure("radius_after_mm", after, math.hypot(change_k2, 2.0 * common_mm)),
        FeatureMeasure("taper_percent", 100.0 * piece.taper, 100.0 * change_k2 / (end - start)),
    )
    kind = FeatureKind.REDUCER if short else FeatureKind.TAPER
    return Feature(kind, (start + end) / 2, end - start, measures=measures, remark="goes on" if last else "")


def _k2(axis: Axis, by: FloatArray) -> list[float]:
    """k = 2 of some functions of the pieces' numbers, their gradients given."""
    assert axis.adjusted is not None
    free = by[:, axis.adjusted.free]
    return [2.0 * math.sqrt(max(float(row @ axis.adjusted.covariance @ row), 0.0)) for row in free]
