"""Where a head is in a pipe, what light it throws and where its projector stands, from the frames themselves.

All of it is one least-squares problem over some thousand points of the wall: six numbers of pose a frame, the light's
shading, the lens's blur, and, in a clean pipe, the projector's place, direction and phase law. A point's own albedo,
modulation, height and drift of light are projected out first (variable projection), so that none of them passes for a
motion of the head. What a scan alone cannot tell, how the whole head lies in the pipe, is told by the wall being round
on the whole: every height is believed to be the pipe's radius to within what heights scatter by, and the more it
departs the less it says (Cauchy). Wrong where a wall is no circle with a straight axis: the pose then leans.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.late import transform
from annulus_pipe.numeric.robust import CAUCHY, cauchy
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure.bore import DEGREE, TERMS, HeadFrames, look_around
from annulus_pipe.wings.fringe.measure.heights import EPSILON_MM, FringeView, Heights, Points
from annulus_pipe.wings.fringe.measure.projector import BENDS, LAW, PLAIN, FringeProjector, changed, lamp_at, phase_at

POSE = 6  # numbers of a pose
EPSILON = 1e-5  # rad: differences in place of derivatives
EPSILON_LAW = np.array([1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-4, 1e-7, *[1e-6] * BENDS, *[1e-4] * 4])
SHADING_SIGMA = 0.5  # of a coefficient: light changes by a factor along the seen wall, not by orders of magnitude
BLUR_SIGMA = 2.0  # px^2
BATCH = 1 << 23  # numbers that normal equations of some points take at once, 64 MB


@dataclass(frozen=True, slots=True)
class Eye:
    """One camera under one slide; both in the head's frame, whose z lies along the pipe but for lean."""

    camera: HeadCamera
    projector: FringeProjector


@dataclass(frozen=True, slots=True)
class Shots:
    """The frames of a scan. images : (N, H, W) grey levels linear in light, black at 0, NaN where saturated. eye : (N,)
    which of the head's eyes saw each, flash : (N,) and at which flash, 0 .. F - 1."""

    images: Float32Array
    eye: IntArray
    flash: IntArray

    @staticmethod
    def single(images: Float32Array) -> "Shots":
        """The shots of a head with one eye: each flash has one frame."""
        return Shots(images, np.zeros(len(images), int), np.arange(len(images)))


@dataclass(frozen=True, slots=True)
class EyeFrames:
    """N frames of a head of several eyes, each field as in `bore.HeadFrames`."""

    lens: FloatArray
    cameras: FloatArray
    heads: FloatArray
    projectors: FloatArray
    eyes: FloatArray
    slide: FloatArray
    drift: FloatArray
    eye: IntArray

    def frames(self, images: Float32Array) -> HeadFrames:
        return HeadFrames(
            images=images,
            lens=self.lens,
            cameras=self.cameras,
            heads=self.heads,
            eyes=self.eyes,
            projectors=self.projectors,
            slide=self.slide,
            drift=self.drift,
            eye=self.eye,
        )

    def phase(self, x: FloatArray, frame: int) -> FloatArray:
        """(P, 3) mm, world -> (P,) rad: the slide's phase there in that frame."""
        q = x @ self.projectors[frame, :, :3].T + self.projectors[frame, :, 3]
        return phase_at(self.slide[frame], q)

    def lamps(self, spot: FloatArray) -> FloatArray:
        """(3,) mm, world -> (N, 3): where light comes to it from, in each frame."""
        turn, moved = self.projectors[:, :, :3], self.projectors[:, :, 3]
        there = turn @ spot + moved
        own = np.stack([lamp_at(slide, q) for slide, q in zip(self.slide, there, strict=True)])
        return np.asarray(np.einsum("nij,ni->nj", turn, own - moved))

    def wave(self, phase: FloatArray) -> FloatArray:
        """(N, ...) rad -> the light's waveform there, of amplitude 1."""
        total = np.cos(phase)
        own = self.slide[:, PLAIN:].reshape(len(phase), -1, 2, *[1] * (phase.ndim - 1))
        for k in range(own.shape[1]):
            total = total + own[:, k, 0] * np.cos((k + 2) * phase) + own[:, k, 1] * np.sin((k + 2) * phase)
        return np.asarray(total)

    def radians_per_mm(self, points: Points, height: FloatArray) -> FloatArray:
        """(P,) how fast the phase changes with height along a ray: of the middle frame of the eye that looks
        straightest at each point."""
        x = points.at(height)
        out, best = np.full(len(x), np.nan), np.full(len(x), -np.inf)
        for eye in np.unique(self.eye):
            mine = np.flatnonzero(self.eye == eye)
            n = int(mine[len(mine) // 2])
            way = x - self.eyes[n]
            facing = way @ self.cameras[n, 2, :3] / np.linalg.norm(way, axis=1)
            way = EPSILON_MM * way / np.einsum("pi,pi->p", way, points.normal)[:, None]
            rate = (self.phase(x + way, n) - self.phase(x - way, n)) / (2 * EPSILON_MM)
            out, best = np.where(facing > best, rate, out), np.maximum(best, facing)
        return out


@dataclass(frozen=True, slots=True)
class PlacedHead:
    """A head in N frames of F flashes, and what is known of its light.

    poses : (F, 6) rotation vector (rad, world's vectors to the head's) and place (mm) of the head's frame. eye, flash :
    (N,) as in `Shots`. shading : (E, 3, TERMS), see `bore`. blur_squared : of the images, px^2. radius_mm : the wall's.
    blur_sigma : of the blur's square, px^2.
    """

    eyes: tuple[Eye, ...]
    poses: FloatArray
    eye: IntArray
    flash: IntArray
    shading: FloatArray
    radius_mm: float
    blur_squared: float = 0.0
    blur_sigma: float = np.inf

    @staticmethod
    def at(
        eyes: Sequence[Eye], shots: Shots, places_mm: FloatArray, radius_mm: float, roll_rad: FloatArray | None = None
    ) -> "PlacedHead":
        """A head that stands straight at (F, 3) places, rolled clockwise looking forward; its light is unknown."""
        poses = np.concatenate([np.zeros((len(places_mm), 3)), places_mm], axis=1)
        poses[:, 2] = 0.0 if roll_rad is None else -roll_rad
        return PlacedHead(tuple(eyes), poses, shots.eye, shots.flash, np.zeros((len(eyes), 3, TERMS)), radius_mm)

    @property
    def projector(self) -> FringeProjector:
        """The one that all eyes share, or the first."""
        return self.eyes[0].projector

    def under(self, projector: FringeProjector) -> "PlacedHead":
        """The same head with that projector alone."""
        return replace(self, eyes=tuple(replace(eye, projector=projector) for eye in self.eyes))

    @property
    def ahead(self) -> tuple[float, float]:
        """Middle and half-length of the wall that its eyes see lit, mm along z."""
        middle, half = self.shading[:, 0, 0], self.shading[:, 0, 1]
        near, far = float((middle - half).min()), float((middle + half).max())
        return (near + far) / 2, (far - near) / 2

    @property
    def view(self) -> EyeFrames:
        """AnnulusError where an eye has fewer than three frames, or did not move between them."""
        turns, count = np.asarray(transform.Rotation.from_rotvec(self.poses[:, :3]).as_matrix()), len(self.eye)
        away = -np.einsum("nij,nj->ni", turns, self.poses[:, 3:])
        widest = max(len(eye.projector.numbers) for eye in self.eyes)
        out = EyeFrames(
            np.zeros((count, 10)),
            np.zeros((count, 3, 4)),
            np.ascontiguousarray(np.concatenate([turns, away[..., None]], axis=2)[self.flash]),
            np.zeros((count, 3, 4)),
            np.zeros((count, 3)),
            np.zeros((count, widest)),
            np.zeros(count),
            self.eye,
        )
        for number, eye in enumerate(self.eyes):
            mine = np.flatnonzero(self.eye == number)
            own = self.flash[mine]
            seen = FringeView.of(eye.camera, eye.projector, self.poses[own, 3:], turns[own])
            out.lens[mine], out.slide[mine, : len(seen.slide)] = seen.lens, seen.slide
            out.cameras[mine], out.projectors[mine] = seen.cameras, seen.projectors
            out.eyes[mine], out.drift[mine] = seen.eyes, seen.drift
        return out


@dataclass(frozen=True, slots=True)
class Freedom:
    """What is believed before the frames are asked, and its standard deviations; 0: known. prior, poses : (N, 6) poses
    and theirs, each frame's own; together : (6,) of what all frames may be off alike. law : (LAW,) of the projector;
    harmonics : how many pairs are sought. wall_mm : how far heights scatter about the radius; drift : of a point's
    light along half its track; radius_mm : of the radius."""

    prior: FloatArray
    poses: FloatArray
    together: FloatArray
    law: FloatArray
    harmonics: int = 0
    wall_mm: float = 1.0
    drift: float = 0.0
    radius_mm: float = 0.0


@dataclass(frozen=True, slots=True)
class PointLooks:
    """Some points in every frame as `look_around` sees them: (N, P), and seen (N, P, 3)."""

    grey: FloatArray
    phase: FloatArray
    slope: FloatArray
    pull: FloatArray
    seen: FloatArray

    @staticmethod
    def of(head: PlacedHead, images: Float32Array, x: FloatArray, normal: FloatArray) -> "PointLooks":
        return PointLooks(*look_around(head.view.frames(images), x, normal))


def shading_terms(head: PlacedHead, seen: FloatArray) -> FloatArray:
    """(N, P, 3) mm in the head's frame -> (N, P, TERMS)."""
    extent = head.shading[head.eye, 0, :2]
    t = (seen[..., 2] - extent[:, :1]) / extent[:, 1:]
    rho = np.hypot(seen[..., 0], seen[..., 1])
    around = np.stack([np.ones_like(t), seen[..., 0] / rho, seen[..., 1] / rho], axis=-1)
    powers = t[..., None] ** np.arange(DEGREE + 1)
    return np.asarray((powers[..., :, None] * around[..., None, :]).reshape(*t.shape, TERMS))


def shaded(head: PlacedHead, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, P, TERMS) -> (N, P) gain of each frame's light, and of its modulation."""
    gain, depth = (np.exp(np.einsum("npt,nt->np", rows, head.shading[head.eye, k])) for k in (1, 2))
    return gain, depth


def refined(
    head: PlacedHead,
    images: Float32Array,
    points: Points,
    freedom: Freedom,
    noise: tuple[float, float, float],
    found: Heights | None = None,
    texture: FloatArray | None = None,
    along: tuple[FloatArray, FloatArray] | None = None,
) -> tuple[PlacedHead, FloatArray]:
    """One Gauss-Newton step, and the covariance (K, K) of poses, shading (gain, depth), blur, radius, law, harmonics.

    found : what `follow_wall` said of the points with this head. None: a clean pipe, whose heights are 0 and whose
    albedo alone is a point's own; the modulation is then the projector's. texture : (P,) as `follow_wall` takes it.
    along : (P,) slopes along the pipe of the albedo's logarithm and of the radius, 1 / mm: with them frames say where
    they were taken, too (see `slip`).
    """
    free = found is not None
    which = (found.flag == 0) & (found.used >= 4) if found is not None else np.ones(len(points.base), bool)
    index = np.flatnonzero(which)
    if len(index) < 10 * POSE:
        raise AnnulusError(f"{len(index)} points of the wall are seen in enough frames: too few to place the head by")
    at, light = head.poses.size, head.shading[:, 1:].size
    common = light + 2 + LAW + 2 * freedom.harmonics
    matrix, pull, held = _prior(head, freedom, common, free)
    each = max(BATCH // (len(head.eye) * common), 1)
    for first in range(0, len(index), each):
        mine = index[first : first + each]
        of = None if found is None else (found.height_mm[mine], found.dc[mine], found.ac[mine])
        slope = np.zeros(len(mine)) if texture is None else texture[mine]
        way = None if along is None else (along[0][mine], along[1][mine])
        some, more = _equations(head, images, points.some(mine), freedom, noise, of, slope, way)
        matrix += some
        pull += more
    keep = ~held
    covariance = np.zeros_like(matrix)
    covariance[np.ix_(keep, keep)] = np.linalg.inv(matrix[np.ix_(keep, keep)])
    step = covariance @ pull
    shading = head.shading.copy()
    shading[:, 1:] += step[at : at + light].reshape(shading[:, 1:].shape)
    moved = replace(
        head,
        poses=head.poses + step[:at].reshape(head.poses.shape),
        shading=shading,
        blur_squared=max(head.blur_squared + float(step[at + light]), 0.0),
        blur_sigma=float(np.sqrt(covariance[at + light, at + light])),
        radius_mm=head.radius_mm + float(step[at + light + 1]),
    )
    law_step = step[at + light + 2 :]
    return moved.under(changed(head.projector, law_step)) if law_step.any() else moved, covariance


def _equations(
    head: PlacedHead,
    images: Float32Array,
    points: Points,
    freedom: Freedom,
    noise: tuple[float, float, float],
    found: tuple[FloatArray, FloatArray, FloatArray] | None,
    slope: FloatArray,
    along: tuple[FloatArray, FloatArray] | None,
) -> tuple[FloatArray, FloatArray]:
    """Normal equations of some points. found : their height, DC and AC; slope : of their albedo."""
    free = found is not None
    frames, count = len(head.eye), len(points.base)
    view = head.view
    x = points.at(found[0] if found is not None else np.zeros(count))
    here = PointLooks.of(head, images, x, points.normal)
    rows = shading_terms(head, here.seen)
    phase = here.phase + head.blur_squared * slope * here.pull
    w = view.wave(phase)
    gain, depth = shaded(head, rows)
    good = np.isfinite(here.grey)
    if found is not None:
        level, swing = found[1:]
    else:  # A alone: the mean of what frames say of it
        unit = gain * (1 + depth * w)
        level = np.where(good, here.grey * unit, 0).sum(axis=0) / np.maximum(
            np.where(good, unit**2, 0).sum(axis=0), 1e-9
        )
        swing = level
    lit = gain * (level + swing * depth * w)
    root = np.where(good, 1 / np.sqrt(noise[0] + np.maximum(lit, 0) * (noise[1] + np.maximum(lit, 0) * noise[2])), 0.0)

    def model(projector: FringeProjector) -> FloatArray:
        other = head.under(projector).view
        there = np.stack([other.phase(x, n) for n in range(frames)])
        wave = other.wave(there + head.blur_squared * slope * here.pull)
        return np.asarray(gain * (level + swing * depth * wave))

    rest = here.grey - lit
    dwave = (view.wave(phase + 1e-5) - view.wave(phase - 1e-5)) / 2e-5
    rise = gain * swing * depth * dwave
    # A head that moves sees other wall through the same pixel, farther off or nearer along the pixel's ray: all that
    # fringes tell of a pose. Pixels' own slopes are not asked: their noise would vouch for any pose.
    moves = _moves(head, x)
    outwards = np.einsum("fpij,pj->fpi", moves, points.normal)[head.flash]
    poses = -(rise * here.slope)[..., None] * outwards
    if along is not None:  # a frame taken farther on sees, wherever it looks, the wall farther on
        ray = x - view.eyes[:, None, :]
        aslant = ray[..., 2] / np.einsum("npj,pj->np", ray, points.normal)
        farther = moves[..., 2][head.flash] - outwards * aslant[..., None]
        poses += (lit * along[0] + rise * here.slope * along[1])[..., None] * farther
    shade = np.zeros((frames, count, len(head.eyes), 2, TERMS))
    every = np.arange(frames)
    shade[every, :, head.eye, 0] = lit[..., None] * rows
    shade[every, :, head.eye, 1] = (gain * swing * depth * w)[..., None] * rows
    wide = [(rise * slope * here.pull)[..., None], np.zeros((frames, count, 1))]
    law = np.zeros((frames, count, LAW + 2 * freedom.harmonics))
    for i in range(law.shape[2]):
        e = EPSILON_LAW[i] if i < LAW else 1e-4
        if i >= LAW or freedom.law[i] > 0:
            step = np.zeros(law.shape[2])
            step[i] = e
            law[..., i] = (model(changed(head.projector, step)) - lit) / e
    common = np.concatenate([shade.reshape(frames, count, -1), *wide, law], axis=2)
    # what is a point's own: its albedo; in a pipe not known to be clean, its modulation, height and drift of light too
    own = [gain * (1 + depth * w)] if not free else [gain, gain * depth * w]
    if free:
        own.append(rise * here.slope)
        if freedom.drift > 0:
            own.append(lit * view.drift[:, None])
    bad = ~(good & np.isfinite(rest) & np.isfinite(poses).all(axis=2) & np.isfinite(common).all(axis=2))
    columns = np.stack(own, axis=-1)
    root[bad] = 0.0
    for part in (rest, poses, common, columns):
        part[bad] = 0.0
    off = head.radius_mm - np.hypot(x[:, 0], x[:, 1]) if free else None
    return _normal(rest, poses, common, columns, root, off, freedom, head)


def _moves(head: PlacedHead, x: FloatArray) -> FloatArray:
    """(F, P, POSE, 3): how far what the head sees at points x goes, mm, per unit of each number of a pose."""
    out = np.zeros((len(head.poses), len(x), POSE, 3))
    out[..., 3:, :] = np.eye(3)
    turns = np.asarray(transform.Rotation.from_rotvec(head.poses[:, :3]).as_matrix())
    for i in range(3):
        step = np.zeros(3)
        step[i] = EPSILON
        other = np.asarray(transform.Rotation.from_rotvec(head.poses[:, :3] + step).as_matrix())
        for n, m in enumerate(head.poses[:, 3:]):
            out[n, :, i] = (((x - m) @ turns[n].T) @ other[n] - (x - m)) / EPSILON
    return out


def _prior(head: PlacedHead, freedom: Freedom, common: int, free: bool) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(K, K) what was believed before, as weights; (K,) how it pulls; (K,) bool, what is known and stays."""
    frames = len(head.poses)
    size = frames * POSE
    weights, pull = np.zeros((size + common, size + common)), np.zeros(size + common)
    held = np.zeros(size + common, bool)
    for i in range(POSE):
        rows = np.arange(frames) * POSE + i
        own, alike = freedom.poses[:, i], float(freedom.together[i])
        if alike == 0 and not own.any():
            held[rows] = True
            continue
        least = np.maximum(own, 1e-6 * max(alike, float(own.max())))
        block = np.linalg.inv(np.diag(least**2) + alike**2)
        weights[np.ix_(rows, rows)] = block
        pull[rows] = block @ (freedom.prior[:, i] - head.poses[:, i])
    sigma = np.concatenate(
        [
            np.full(head.shading[:, 1:].size, SHADING_SIGMA),
            [BLUR_SIGMA if free else 0.0, freedom.radius_mm],
            freedom.law,
            np.ones(2 * freedom.harmonics),
        ]
    )
    sigma[0] = 0.0  # a point's albedo says it
    if free:
        sigma[TERMS] = 0.0  # and its modulation
    held[size:] = sigma == 0
    diagonal = np.where(sigma > 0, 1 / np.maximum(sigma, 1e-12) ** 2, 0.0)
    weights[np.arange(size, size + common), np.arange(size, size + common)] = diagonal
    light = head.shading[:, 1:].ravel()
    pull[size : size + len(light)] = -light * diagonal[: len(light)]
    return weights, pull, held


def _normal(
    rest: FloatArray,
    poses: FloatArray,
    common: FloatArray,
    columns: FloatArray,
    root: FloatArray,
    off: FloatArray | None,
    freedom: Freedom,
    head: PlacedHead,
) -> tuple[FloatArray, FloatArray]:
    """Normal equations of poses and common numbers, what is a point's own projected out."""
    frames, count = rest.shape
    width = columns.shape[2]
    extra = 2 if off is not None else 0  # rows: a height is the radius; a light does not drift
    share = np.zeros(count) if off is None else np.sqrt(cauchy(off / (CAUCHY * freedom.wall_mm))) / freedom.wall_mm
    for turn in range(3):
        own = np.zeros((count, frames + extra, width))
        own[:, :frames] = (columns * root[..., None]).transpose(1, 0, 2)
        r = np.zeros((count, frames + extra))
        r[:, :frames] = (rest * root).T
        if off is not None:
            own[:, frames, 2] = share
            r[:, frames] = off * share
            if width > 3:
                own[:, frames + 1, 3] = 1 / freedom.drift
        q = np.linalg.qr(own)[0]
        left = r - np.einsum("pni,pi->pn", q, np.einsum("pni,pn->pi", q, r))
        if turn < 2:
            root = root * np.sqrt(cauchy(left[:, :frames].T / CAUCHY))
    everyone = np.zeros((count, frames + extra, common.shape[2]))
    everyone[:, :frames] = (common * root[..., None]).transpose(1, 0, 2)
    if off is not None:
        everyone[:, frames, head.shading[:, 1:].size + 1] = -share
    d = poses * root[..., None]  # (N, P, POSE)
    light, size = head.shading[:, 1:].size, head.poses.size
    order = np.argsort(head.flash, kind="stable")
    begins = np.searchsorted(head.flash[order], np.arange(len(head.poses)))  # frames of one flash share its pose

    def by_flash(each: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(each[order], begins, axis=0))

    matrix = np.zeros((size + common.shape[2], size + common.shape[2]))
    for n, block in enumerate(by_flash(d.transpose(0, 2, 1) @ d)):
        matrix[n * POSE : (n + 1) * POSE, n * POSE : (n + 1) * POSE] = block
    cross = by_flash(d.transpose(0, 2, 1) @ everyone[:, :frames].transpose(1, 0, 2)).reshape(size, -1)
    matrix[:size, size:], matrix[size:, :size] = cross, cross.T
    own_light = light // len(head.eyes)
    for eye in range(len(head.eyes)):  # of another eye's light a frame knows nothing
        which = np.r_[eye * own_light : (eye + 1) * own_light, light : common.shape[2]]
        flat = everyone[:, np.concatenate([head.eye == eye, np.full(extra, eye == 0)])][..., which].reshape(
            -1, len(which)
        )
        matrix[np.ix_(size + which, size + which)] += flat.T @ flat
    inner = np.concatenate(
        [
            by_flash(d[..., None] * q[:, :frames].transpose(1, 0, 2)[:, :, None, :])
            .transpose(1, 3, 0, 2)
            .reshape(count * width, size),
            (q.transpose(0, 2, 1) @ everyone).reshape(count * width, -1),
        ],
        axis=1,
    )
    matrix -= inner.T @ inner
    pull = np.concatenate(
        [by_flash(np.einsum("npi,pn->ni", d, left[:, :frames])).ravel(), np.einsum("pnk,pn->k", everyone, left)]
    )
    return matrix, pull
