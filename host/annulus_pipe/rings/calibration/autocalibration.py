"""The projector's rings found from frames of a clean pipe of known radius, the head leaning differently in each.

Assumed: the pipe is round and clean, its radius known (it alone sets the scale), the lens known, each slit's ring read.

What carries it: the light path closes, camera -> wall -> ring's cone -> camera. Each slit says how far along its line,
in pixels, the image of its ring on the pipe lies from where it was seen (Alzuhiri 2022, Eq. 4.10): that alone is safe
to minimise. A cost in angles or in millimetres weighs the far, badly seen wall most and, under noise, shrinks towards a
false scale.

When it breaks: poses too alike leave the vertices open (`Solution.covariance`, or AnnulusError where nothing holds
them); a wrong lens or an oval pipe leaves long waves in the errors (`correlation_length`); another place of the
projector that fits nearly as well shows in `runner_up`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import Pose, pose_of
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import transform
from annulus_pipe.rings.calibration.bundle import SETTLED, Bundle, Solution, packed
from annulus_pipe.rings.calibration.observations import Observations, Placement
from annulus_pipe.vocabulary import AnnulusError

# Of the radius: vertex beside the camera, tried as starts in this order.
# By topic autocalibration (cold starts, with and without noise) and, for a mirror, test_mirror_calibration.
DISTANCES = (-0.7, -0.25, 0.3, -1.8, 1.0)
ASIDE = (0.25, 0.5)  # of the radius: vertex to the side of a camera of several ..
WAYS = 8  # .. in so many directions
COARSE = 32  # observations of each ring in each frame that a start is tried with
SPARSE = 96  # of each ring over all frames: enough for where one of several cameras begins, it is only a beginning
ROUGH = 0.1  # of a parameter's size: how well a start is fitted before it is looked at ..
PROMISING = 6  # .. and so many go on
NEAR = 1e-3  # of a parameter's size: a start is good enough to be compared


def calibrate(
    seen: Observations,
    radius_mm: float,
    *,
    start: Solution | None = None,
    corrections: FloatArray | None = None,
    directions: int = 0,
    flat: tuple[bool, ...] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Solution:
    """All rings and all poses together, from a cold start.

    Parameters
    ----------
    seen : at least two frames, of one camera or of several on one head. radius_mm : the pipe's; it alone sets the scale
    of the answer.
    start : an answer nearby, saves the search. corrections : (K, 2, n) rad and mm, what each ring is known to be off
    its cone, see RingCorrection. directions : so many sectors round each ring may each be off the cone by their own
    angle (lumps of the slide); 0 = none is. Only what differs between poses then tells of the cones.
    flat : which rings are flat planes, those of `start` if none is said; all are cones where nobody says.

    Raises
    ------
    AnnulusError where the observations do not determine the rings: frames too few or too alike.

    Notes
    -----
    Alzuhiri 2022, §4.3.2, Alg. 2 (Alg. 1 when there is one ring). Gauss-Newton with analytic derivatives: every
    observation touches the six numbers of its ring and the four of its pose, so the normal equations are gathered in
    small blocks. Its error is where its ring's image crosses its line, found by Newton's method. Of several cameras
    each begins alone, the projector to its side; what all of them saw of the pipe and the rings says where they stand
    (Eq. 5.10 and 5.11), and then all is adjusted together, six numbers more for each camera.
    """
    rings, frames = int(seen.ring.max()) + 1, int(seen.frame.max()) + 1
    if start is not None:  # a part of the frames need not show every ring
        rings, frames = len(start.rings), len(start.poses)
    if frames < 2:
        raise AnnulusError("one frame cannot tell the projector's place from its angles: lean the head the other way")
    known = np.zeros((rings, 2, 0)) if corrections is None else np.ascontiguousarray(corrections)
    flat = flat or (start.flat if start is not None else ())
    problem = Bundle(seen, rings, frames, radius_mm, known, flat)
    runner_up = math.inf
    report = progress or (lambda done, total: None)
    if start is not None:
        x = packed(start)
    elif problem.cameras > 1:
        x, runner_up = _several(seen, problem, report)
    else:
        few = Bundle(seen.take(_thinned(seen, rings, frames)), rings, frames, radius_mm, known, flat)
        found: list[tuple[float, FloatArray]] = []
        for done, distance in enumerate(DISTANCES):
            report(done, len(DISTANCES) + 1)
            found.append(few.descend(few.first(distance * radius_mm), robust=True, settled=NEAR))
        found.sort(key=lambda one: one[0])
        best, x = found[0]
        far = 0.05 * radius_mm
        others = [cost for cost, other in found if abs(other[5] - x[5]) > far]
        runner_up = min(others, default=math.inf) / max(best, 1e-300)
    if directions:
        problem.allow_sector_offsets(x, directions)
    for _ in range(2):  # with the slits' middles of the first round
        _, x = problem.descend(x, robust=False, settled=SETTLED)
    report(len(DISTANCES) + 1, len(DISTANCES) + 1)
    return problem.solution(x, runner_up)


def _several(seen: Observations, whole: Bundle, report: Callable[[int, int], None]) -> tuple[FloatArray, float]:
    """Where to begin with several cameras, and the least `runner_up` of those that each found alone, from the frames
    that it has."""
    alone, which, runner_up = [], [], math.inf
    for number in range(whole.cameras):
        report(number, whole.cameras + 1)
        own = seen.take(np.flatnonzero(seen.camera == number))
        frames, frame = np.unique(own.frame, return_inverse=True)
        if len(frames) < 2:
            raise AnnulusError(f"one of the cameras shows the rings in {len(frames)} frames, expected two and more")
        own = replace(own, frame=frame, camera=np.zeros(len(own), np.int64), tint=np.zeros((len(own), 0)))
        sparse = own.take(_thinned(own, whole.rings, len(frames), -(-SPARSE // len(frames))))
        few = Bundle(sparse, whole.rings, len(frames), whole.radius, whole.corrections)
        rough: list[tuple[float, FloatArray]] = []
        for aside in ASIDE:
            for way in range(WAYS):
                turn = 2 * math.pi * way / WAYS
                beside = few.first_beside(aside * whole.radius * np.array([math.cos(turn), math.sin(turn)]))
                rough.append(few.descend(beside, robust=True, settled=ROUGH))
        rough.sort(key=lambda one: one[0])
        found = [few.descend(x, robust=True, settled=NEAR) for _, x in rough[:PROMISING]]
        found.sort(key=lambda one: one[0])
        best, x = found[0]
        far = 0.05 * whole.radius
        others = [cost for cost, other in found if np.linalg.norm(other[3:6] - x[3:6]) > far]
        runner_up = min(runner_up, min(others, default=math.inf) / max(best, 1e-300))
        alone.append(few.solution(x, math.inf))
        which.append(frames)
    poses = [dict(zip(frames.tolist(), one.poses, strict=True)) for frames, one in zip(which, alone, strict=True)]
    placed = [_placed(alone[0], poses[0], one, own) for one, own in zip(alone[1:], poses[1:], strict=True)]
    every = [_in_first(frame, poses, placed) for frame in range(whole.frames)]
    first = replace(
        alone[0], poses=tuple(every), cameras=tuple(placed), colour_shift_px=np.zeros((seen.tint.shape[1] // 4, 4))
    )
    few = Bundle(
        seen.take(_thinned(seen, whole.rings, whole.frames)), whole.rings, whole.frames, whole.radius, whole.corrections
    )
    _, x = few.descend(packed(first), robust=True, settled=NEAR)
    return x, runner_up


def _in_first(frame: int, poses: Sequence[Mapping[int, Pose]], placed: Sequence[Placement]) -> Pose:
    """The pipe in the first camera's frame, as the first of the cameras that saw it says."""
    if frame in poses[0]:
        return poses[0][frame]
    own, place = next((own[frame], place) for own, place in zip(poses[1:], placed, strict=True) if frame in own)
    return pose_of(place.rotation @ own.rotation[:, 2], place.rotation @ own.translation + place.centre_mm)


def _placed(
    first: Solution, first_poses: Mapping[int, Pose], other: Solution, other_poses: Mapping[int, Pose]
) -> Placement:
    """Where a camera stands from which the same rings and the same pipe, in the frames of both, were seen."""
    ours: list[FloatArray] = []
    theirs: list[FloatArray] = []
    both = sorted(first_poses.keys() & other_poses.keys())
    if not both:
        raise AnnulusError("no frame of one camera is of the same flash as one of the other")
    for one, poses, out in ((first, first_poses, ours), (other, other_poses, theirs)):
        vertex = np.mean([ring.vertex_mm for ring in one.rings], axis=0)
        out += [np.asarray(ring.axis) for ring in one.rings]
        for pose in (poses[frame] for frame in both):
            axis = pose.rotation[:, 2]
            away = pose.translation - vertex
            out += [axis, (away - (away @ axis) * axis) / one.radius_mm]  # the pipe's way, and where it passes by
    turn, _ = transform.Rotation.align_vectors(np.array(ours), np.array(theirs))
    matrix = np.asarray(turn.as_matrix())
    vertices = [np.mean([ring.vertex_mm for ring in one.rings], axis=0) for one in (first, other)]
    return Placement(matrix, vertices[0] - matrix @ vertices[1])


def with_frame(solution: Solution, one: Observations, pose: Pose) -> FloatArray:
    """The covariance that the rings would have if a frame with these observations, taken in `pose`, were added."""
    rings = len(solution.rings)
    problem = Bundle(one, rings, 1, solution.radius_mm, np.zeros((rings, 2, 0)))
    problem.evaluate(packed(replace(solution, poses=(pose,))), middles=True)
    weight = (
        np.where(np.isfinite(problem.error), 1.0, 0.0) / (solution.sigma_px**2 * solution.correlation_length)[one.ring]
    )
    matrix, _ = problem.normal(weight)
    n = 6 * rings
    own, cross, four = matrix[:n, :n], matrix[:n, n : n + 4], matrix[n : n + 4, n : n + 4]
    gained = own - cross @ np.linalg.solve(four, cross.T)
    unit = np.sqrt(np.diag(solution.covariance))
    unit = np.where(unit > 0, unit, 1.0)  # of a plane some numbers are given
    cover = solution.covariance / unit[:, None] / unit
    return np.asarray(
        np.linalg.solve(np.eye(n) + cover @ (gained * unit[:, None] * unit), cover) * unit[:, None] * unit
    )


def _thinned(seen: Observations, rings: int, frames: int, most: int = COARSE) -> NDArray[np.int64]:
    """About `most`, COARSE at most, observations of each ring in each frame of each camera, evenly taken."""
    out = []
    for camera in range(int(seen.camera.max(initial=0)) + 1):
        for frame in range(frames):
            for ring in range(rings):
                mine = np.flatnonzero((seen.camera == camera) & (seen.frame == frame) & (seen.ring == ring))
                out.append(mine[:: max(1, len(mine) // min(most, COARSE))])
    return np.concatenate(out)
