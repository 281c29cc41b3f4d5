"""Where a second camera stands, from targets that both cameras photographed at once.

Each camera's own photographs say where a target was before it; of one moment the two differ by where the cameras stand
(Alzuhiri 2022, Eq. 5.12). Here all moments together say it: one placement, one pose of the target a moment, least
squares of the corners in both images, the lenses as their own photographs made them.

What carries it: the cameras stand still to each other. A moment that is none (photographs of two moments, corners that
are numbered from another side in one of them) gives a placement of its own, which no other moment gives again. How well
it is known follows from leaving moments out, what they say of the lenses included, as `Intrinsics.covariance` does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.intrinsics import Intrinsics, TargetObservation, cross_matrix, left_out, target_rows
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import transform
from annulus_pipe.vocabulary import AnnulusError

# By test_seen_by_both: moments that are none are left out, others are not.
LEAST = 3  # moments
FAR = 5.0  # times the usual: a moment's own placement is so far from the others'
OFF, OFF_PX = 3.0, 0.1  # times what a moment's photographs leave over alone, and so many pixels more
STEPS, CLOSE = 20, 1e-9  # of the descent; rad, or of the target's distance: it ends


@dataclass(frozen=True, slots=True)
class Moment:
    """A target seen by both: the photographs' places among each camera's views. `alike`: corners are numbered alike in
    both; else both show all of the target, and either may count from another corner of it."""

    first: int
    second: int
    alike: bool


@dataclass(frozen=True, slots=True, eq=False)
class PlacedCamera:
    """A second camera in the first one's frame: x = rotation x_own + centre_mm. covariance (6, 6): of a small turn of
    it about the first one's x, y, z, rad, and of the centre, mm. rms_px: (M,) of each moment; `used` (M,)."""

    rotation: FloatArray
    centre_mm: FloatArray
    covariance: FloatArray
    rms_px: FloatArray
    used: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """x_second = rotation x_first + shift; the targets' poses are before the first camera."""

    rotation: FloatArray
    shift: FloatArray
    rotations: FloatArray  # (M, 3, 3)
    shifts: FloatArray  # (M, 3)


def place_second(first: Intrinsics, second: Intrinsics, moments: Sequence[Moment]) -> PlacedCamera:
    """Raises AnnulusError, one line, where fewer than three moments, or less than half of them, agree."""
    if len(moments) < LEAST:
        raise AnnulusError(f"{len(moments)} moments at which both cameras show the target, expected at least {LEAST}")
    pairs, state, near = _begin(first, second, moments)
    own = np.array([_mean_px(first.residuals[m.first], second.residuals[m.second]) for m in moments])
    rms, used = np.full(len(moments), np.nan), near
    for _ in range(LEAST):
        if np.count_nonzero(used) < max(LEAST, len(moments) / 2):
            break
        state = _adjusted(first, second, pairs, state, used)
        rms = np.array([_rms(first, second, pairs, state, m) for m in range(len(pairs))])
        before, used = used, rms <= np.maximum(OFF * own, own + OFF_PX)
        if (before == used).all():
            break
    if np.count_nonzero(used) < max(LEAST, len(moments) / 2):
        raise AnnulusError(
            f"{np.count_nonzero(used)} of {len(moments)} moments agree on where the second camera stands: "
            "are the photographs of the same moments, in the same order, and the cameras fixed to each other?"
        )
    turn = state.rotation.T
    return PlacedCamera(turn, -turn @ state.shift, _covariance(first, second, moments, pairs, state, used), rms, used)


def _begin(
    first: Intrinsics, second: Intrinsics, moments: Sequence[Moment]
) -> tuple[list[tuple[TargetObservation, TargetObservation]], _State, NDArray[np.bool_]]:
    """The placement that most moments give by themselves, the corners numbered as goes with it, and whose it is."""
    ways: list[list[tuple[TargetObservation, FloatArray, FloatArray]]] = []
    for m in moments:
        one, other = first.views[m.first], second.views[m.second]
        ways.append([])
        for quarters in range(1 if m.alike else 4):
            q = np.linalg.matrix_power(np.array([[0.0, 1.0], [-1.0, 0.0]]), quarters)
            middles = np.zeros((2, 2)) if m.alike else np.array([v.target_mm.max(axis=0) / 2 for v in (one, other)])
            moved = middles[1] - q.T @ middles[0]  # of the second's numbering: where the first's origin is
            whole = np.eye(3)
            whole[:2, :2], whole[2, 2] = q.T, 1.0
            rotation = second.rotations[m.second] @ whole @ first.rotations[m.first].T
            origin = second.rotations[m.second][:, :2] @ moved + second.translations[m.second]
            renumbered = replace(other, target_mm=(other.target_mm - middles[1]) @ q.T + middles[0])
            ways[-1].append((renumbered, rotation, origin - rotation @ first.translations[m.first]))
    distance = float(np.median(np.linalg.norm(first.translations[[m.first for m in moments]], axis=1)))

    def apart(rotation: FloatArray, shift: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        off = np.full((len(ways), 4), np.inf)
        for i, each in enumerate(ways):
            for j, (_, r, t) in enumerate(each):
                off[i, j] = distance * transform.Rotation.from_matrix(r @ rotation.T).magnitude() + np.linalg.norm(
                    t - shift
                )
        return off.min(axis=1), off.argmin(axis=1)

    tried = [(*apart(r, t), r, t) for each in ways for _, r, t in each]
    off, which, rotation, shift = min(tried, key=lambda one: float(np.median(one[0])))
    pairs = [(first.views[m.first], ways[i][which[i]][0]) for i, m in enumerate(moments)]
    used = [m.first for m in moments]
    state = _State(rotation, shift, first.rotations[used].copy(), first.translations[used].copy())
    return pairs, state, off <= FAR * float(np.median(off))


def _rows(
    first: Intrinsics, second: Intrinsics, pair: tuple[TargetObservation, TargetObservation], state: _State, m: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of one moment (2 N,) px off; slopes (2 N, ..) by the placement, the target's pose, both lenses."""
    own_turn, own_shift = state.rotations[m], state.shifts[m]
    carried = state.rotation @ own_shift
    off_a, lens_a, pose_a = target_rows(first.camera, pair[0], own_turn, own_shift)
    off_b, lens_b, pose_b = target_rows(second.camera, pair[1], state.rotation @ own_turn, carried + state.shift)
    turn, shift = pose_b[..., :3], pose_b[..., 3:]
    placement = np.concatenate([turn - shift @ cross_matrix(carried[None])[0], shift], axis=2)
    pose = np.concatenate([turn @ state.rotation, shift @ state.rotation], axis=2)
    a, b = 2 * len(off_a), 2 * len(off_b)
    lens = np.zeros((a + b, lens_a.shape[2] + lens_b.shape[2]))
    lens[:a, : lens_a.shape[2]], lens[a:, lens_a.shape[2] :] = lens_a.reshape(a, -1), lens_b.reshape(b, -1)
    by_placement = np.concatenate([np.zeros((a, 6)), placement.reshape(b, 6)])
    return (
        np.concatenate([off_a.ravel(), off_b.ravel()]),
        by_placement,
        np.concatenate([pose_a.reshape(a, 6), pose.reshape(b, 6)]),
        lens,
    )


def _past_pose(off: FloatArray, by: FloatArray, by_pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and gradient with the target's pose left free."""
    left = by - by_pose @ np.linalg.lstsq(by_pose, by, rcond=None)[0]
    return left.T @ left, left.T @ off


def _adjusted(
    first: Intrinsics,
    second: Intrinsics,
    pairs: Sequence[tuple[TargetObservation, TargetObservation]],
    state: _State,
    used: NDArray[np.bool_],
) -> _State:
    """Gauss-Newton over the placement and the poses of the moments used."""
    for _ in range(STEPS):
        rows = {m: _rows(first, second, pairs[m], state, m) for m in map(int, np.flatnonzero(used))}
        parts = [_past_pose(off, by, pose) for off, by, pose, _ in rows.values()]
        normal, gradient = (np.sum(part, axis=0) for part in zip(*parts, strict=True))
        step = np.asarray(np.linalg.solve(normal, gradient))
        state = _poses_moved(_moved(state, step), rows, step)
        if (
            np.abs(step[:3]).max() < CLOSE
            and np.abs(step[3:]).max() < CLOSE * np.linalg.norm(state.shifts, axis=1).max()
        ):
            break
    return state


def _moved(state: _State, step: FloatArray) -> _State:
    turn = transform.Rotation.from_rotvec(step[:3]).as_matrix()
    return replace(state, rotation=turn @ state.rotation, shift=state.shift + step[3:])


def _poses_moved(
    state: _State, rows: dict[int, tuple[FloatArray, FloatArray, FloatArray, FloatArray]], step: FloatArray
) -> _State:
    rotations, shifts = state.rotations.copy(), state.shifts.copy()
    for m, (off, by, by_pose, _) in rows.items():
        pose = np.linalg.lstsq(by_pose, off - by @ step, rcond=None)[0]
        rotations[m] = transform.Rotation.from_rotvec(pose[:3]).as_matrix() @ rotations[m]
        shifts[m] = shifts[m] + pose[3:]
    return replace(state, rotations=rotations, shifts=shifts)


def _rms(
    first: Intrinsics,
    second: Intrinsics,
    pairs: Sequence[tuple[TargetObservation, TargetObservation]],
    state: _State,
    m: int,
) -> float:
    """What a moment leaves over when its pose suits a placement that is given."""
    for _ in range(STEPS // 2):
        state = _poses_moved(state, {m: _rows(first, second, pairs[m], state, m)}, np.zeros(6))
    return _mean_px(_rows(first, second, pairs[m], state, m)[0].reshape(-1, 2))


def _mean_px(*parts: FloatArray) -> float:
    return float(np.sqrt(np.mean((np.concatenate(parts) ** 2).sum(axis=1))))


def _covariance(
    first: Intrinsics,
    second: Intrinsics,
    moments: Sequence[Moment],
    pairs: Sequence[tuple[TargetObservation, TargetObservation]],
    state: _State,
    used: NDArray[np.bool_],
) -> FloatArray:
    """Of the small turn and the centre: see `PlacedCamera`. A moment left out moves the placement by what it says of
    it, and by what it, and a photograph without a partner, says of its lens."""
    lenses = first.moves.shape[1] + second.moves.shape[1]
    information, pulls = np.zeros((len(pairs), 6, 6)), np.zeros((len(pairs), 6))
    across = np.zeros((6, lenses))
    for m in map(int, np.flatnonzero(used)):
        off, by, by_pose, lens = _rows(first, second, pairs[m], state, m)
        both, pull = _past_pose(off, np.concatenate([by, lens], axis=1), by_pose)
        information[m], pulls[m] = both[:6, :6], pull[:6]
        across += both[:6, 6:]
    by_lens = -np.linalg.solve(information.sum(axis=0), across)
    split = first.moves.shape[1]
    of_first, of_second = first.moves @ by_lens[:, :split].T, second.moves @ by_lens[:, split:].T
    moves = [
        of_first[m.first] + of_second[m.second] + direct
        for m, direct in zip(moments, left_out(information, pulls), strict=True)
    ]
    moves += [row for i, row in enumerate(of_first) if i not in {m.first for m in moments}]
    moves += [row for i, row in enumerate(of_second) if i not in {m.second for m in moments}]
    turn = state.rotation.T
    local = np.zeros((6, 6))  # the placement's numbers to a turn in the first one's frame, and the centre
    local[:3, :3], local[3:, 3:] = -turn, -turn
    local[3:, :3] = -turn @ cross_matrix(state.shift[None])[0]
    moved = np.array(moves) @ local.T
    return np.asarray((len(moved) - 1) / len(moved) * moved.T @ moved)
