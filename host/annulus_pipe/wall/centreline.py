"""The pipe's centre line: a chain of straight, bent and tapering pieces, and the way between pipe and space.

Pipe coordinates are x, y about the centre line and chainage s along it; space is the frame of the first piece, which
before its start and along it is the same. A piece begins where the centre line jumps aside (a joint's hi-lo), turns
(its angle), begins or ends to curve, or the radius steps or begins to change. Frames are carried along without twist.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door

STRAIGHT = 1e-9  # 1/mm; less curvature than this is none

_points_to_pipe = door("points_to_pipe", "f8[n,3] points", "i8[n] since", "f8[p,16] pieces", "f8[n,3]! out")


@dataclass(frozen=True, slots=True)
class Piece:
    """From `start_mm` to the next piece's. Against the end of the piece before it: `offset_mm` (x, y), by which the
    centre line jumps, and `turn` (x, y), radians, by which its direction does. `curvature` (x, y), 1/mm, points to
    where it bends; `radius_mm` at its start, `taper` how much that grows a mm."""

    start_mm: float
    radius_mm: float
    offset_mm: tuple[float, float] = (0.0, 0.0)
    turn: tuple[float, float] = (0.0, 0.0)
    curvature: tuple[float, float] = (0.0, 0.0)
    taper: float = 0.0

    @property
    def is_bent(self) -> bool:
        return float(np.hypot(*self.curvature)) > STRAIGHT


class Centreline:
    """Pieces in order of their starts; the first reaches back, the last forward, as far as anybody asks.

    starts (P,) mm; origins (P, 3), frames (P, 3, 3): where each piece begins in space. Raises ValueError when there is
    no piece or starts do not rise.
    """

    __slots__ = ("frames", "origins", "pieces", "starts")

    def __init__(self, pieces: Sequence[Piece]) -> None:
        if not pieces or any(b.start_mm <= a.start_mm for a, b in pairwise(pieces)):
            raise ValueError("a centre line needs pieces whose starts rise")
        self.pieces = tuple(pieces)
        origin, frame = np.array([0.0, 0.0, pieces[0].start_mm]), np.eye(3)
        origins, frames = [origin], [frame]
        for before, piece in pairwise(pieces):
            moved, turned = _along(before, np.array([piece.start_mm - before.start_mm]))
            origin = origin + frame @ moved[0]
            frame = frame @ turned[0]
            origin = origin + frame @ np.array([*piece.offset_mm, 0.0])
            frame = frame @ rotation(np.array([piece.turn]))[0]
            origins.append(origin)
            frames.append(frame)
        self.starts = np.array([piece.start_mm for piece in pieces])
        self.origins, self.frames = np.array(origins), np.array(frames)

    @property
    def is_straight(self) -> bool:
        """One straight piece: pipe coordinates are space."""
        return len(self.pieces) == 1 and not self.pieces[0].is_bent

    @property
    def is_even(self) -> bool:
        """One radius all along."""
        return all(piece.taper == 0.0 and piece.radius_mm == self.pieces[0].radius_mm for piece in self.pieces)

    def piece_of(self, chainage_mm: FloatArray) -> NDArray[np.intp]:
        """(N,) index of the piece at each chainage."""
        return np.searchsorted(self.starts[1:], chainage_mm, side="right")

    def frames_at(self, chainage_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 3) points of the centre line, mm, and (N, 3, 3) its frames there (columns x, y, ahead), in space."""
        own = self.piece_of(chainage_mm)
        origins, frames = np.empty((len(own), 3)), np.empty((len(own), 3, 3))
        for i, piece in enumerate(self.pieces):
            here = own == i
            if here.any():
                moved, turned = _along(piece, chainage_mm[here] - piece.start_mm)
                origins[here] = self.origins[i] + moved @ self.frames[i].T
                frames[here] = self.frames[i] @ turned
        return origins, frames

    def radius_at(self, chainage_mm: FloatArray) -> FloatArray:
        """(N,) mm."""
        own = self.piece_of(chainage_mm)
        of = np.array([(piece.radius_mm, piece.taper, piece.start_mm) for piece in self.pieces])[own]
        return np.asarray(of[:, 0] + of[:, 1] * (chainage_mm - of[:, 2]))

    def to_space(self, points_mm: FloatArray) -> FloatArray:
        """(N, 3) x, y, chainage -> (N, 3) space, mm."""
        if self.is_straight:
            return points_mm
        origins, frames = self.frames_at(points_mm[:, 2])
        return np.asarray(origins + np.einsum("nij,nj->ni", frames[:, :, :2], points_mm[:, :2]))

    def from_head(self, points_mm: FloatArray, chainage_mm: float) -> FloatArray:
        """(N, 3) in the centre line's own frame at a head's chainage, z ahead of it -> pipe coordinates."""
        if self.is_straight:
            return np.asarray(points_mm + np.array([0.0, 0.0, chainage_mm]))
        at = np.array([chainage_mm])
        origins, frames = self.frames_at(at)
        return self.to_pipe(origins[0] + points_mm @ frames[0].T, np.repeat(self.piece_of(at), len(points_mm)))

    def to_head(self, points_mm: FloatArray, chainage_mm: float) -> FloatArray:
        """Inverse of `from_head`."""
        if self.is_straight:
            return np.asarray(points_mm - np.array([0.0, 0.0, chainage_mm]))
        origins, frames = self.frames_at(np.array([chainage_mm]))
        return np.asarray((self.to_space(points_mm) - origins[0]) @ frames[0])

    def to_pipe(self, points_mm: FloatArray, since: NDArray[np.intp] | None = None) -> FloatArray:
        """(N, 3) space -> (N, 3) x, y, chainage. `since` (N,): the piece to begin with, for a pipe may come back to
        where it was; the first if not given."""
        if self.is_straight:
            return points_mm
        own = np.zeros(len(points_mm), np.int64) if since is None else np.ascontiguousarray(since, np.int64)
        bend = np.array([piece.curvature for piece in self.pieces])
        k = np.hypot(bend[:, 0], bend[:, 1])
        k[k <= STRAIGHT] = 0.0
        way = np.where(k[:, None] > 0.0, bend / np.maximum(k, STRAIGHT)[:, None], 0.0)
        pieces = np.column_stack([self.starts, self.origins, self.frames.reshape(-1, 9), way, k])
        out = np.empty(points_mm.shape)
        _points_to_pipe(np.ascontiguousarray(points_mm, np.float64), own, pieces, out)
        return out


def rotation(turn: FloatArray) -> FloatArray:
    """(N, 3, 3) rotations that turn the direction ahead towards (x, y) by that many radians; turn : (N, 2)."""
    angle = np.hypot(turn[:, 0], turn[:, 1])
    safe = np.maximum(angle, 1e-300)
    x, y = turn[:, 0] / safe, turn[:, 1] / safe
    c, s = np.cos(angle) - 1.0, np.sin(angle)
    rows = np.stack([1 + c * x * x, c * x * y, s * x, c * x * y, 1 + c * y * y, s * y, -s * x, -s * y, 1 + c], axis=1)
    return np.asarray(rows.reshape(-1, 3, 3))


def _along(piece: Piece, length_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, 3) the way and (N, 3, 3) the turn from a piece's start, in the frame there."""
    k = float(np.hypot(*piece.curvature))
    way = np.zeros((len(length_mm), 3))
    if k <= STRAIGHT:
        way[:, 2] = length_mm
        return way, np.broadcast_to(np.eye(3), (len(length_mm), 3, 3))
    bend = np.array(piece.curvature)
    way[:, :2] = (2.0 * np.sin(0.5 * k * length_mm) ** 2 / k**2)[:, None] * bend
    way[:, 2] = np.sin(k * length_mm) / k
    return way, rotation(length_mm[:, None] * bend)
