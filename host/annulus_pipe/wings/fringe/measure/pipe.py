"""A pipe's wall from the frames of a head that projects fringes (Alzuhiri 2022, §6.8.2, Models A, B and C).

    seen = measure_pipe(eyes, shots, z_mm, radius_mm)        a `PipeMap`

An eye is one camera under one slide. Model A has one, camera and slide of rings in series; Model B several pairs of
cameras about the pipe, each pair with a slide of stripes of its own, lit in turn; Model C several cameras about one
slide of rings. To the map they are alike: frames of one flash share the head's pose, and a cell is solved from all
frames that see it, whoever took them.

The slide's fringes stand still in the image of a clean pipe: it is the wall that moves through them. Each cell's frames
say its radius; all cells together say how the head lay in the pipe, frame by frame, and what its light is like
(`placement`). Then comes what the lens's blur makes of the wall's texture (`bore`), from the map itself: each map gives
the albedo's slope for the next, and a shadow's edge is one, too. Sigma is a cell's own, of its frames, and what cells
apart scatter beyond that.

Where neither a frame's parallax nor a neighbour decides the order of the fringe a cell is ambiguous and NaN. A loss so
narrow that its near rim keeps light or sight off its floor, or the blur fills it, is fitted as a groove (`groove`);
where its floor shows in no frame its radius is a lower limit: `at_least`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from annulus_pipe.geometry.cone import intersect_cylinder
from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray, Image, IntArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure import groove
from annulus_pipe.wings.fringe.measure.bore import BorePoints, HeadLight, follow_wall
from annulus_pipe.wings.fringe.measure.heights import PARALLAX, Heights, Points, spline
from annulus_pipe.wings.fringe.measure.noise import noise_of
from annulus_pipe.wings.fringe.measure.placement import Eye, Freedom, PlacedHead, Shots, refined
from annulus_pipe.wings.fringe.measure.projector import LAW
from annulus_pipe.wings.fringe.measure.slip import FlashSlips, find_places
from annulus_pipe.wings.fringe.measure.track import AMBIGUOUS, GOOD, ROBUST_FROM

STRAIGHT = 0.9  # cosine: a camera that looks along the pipe
WIDER = 0.02  # of that cosine: a pose that leans
FAR_OF_RADIUS = 20.0  # a pixel that sees the wall farther ahead sees nothing of it
BESIDE = "the camera sees nothing of the wall the projector lights: is the calibration this head's?"
CELL_OF_RADIUS = 1 / 200  # a cell: half a millimetre in an 8-inch pipe, about a pixel
DARK = 0.06  # of the brightest: below that no light falls on the wall
REACH_PX = 4  # of a blur and of a cubic spline: what lies so near the field's edge is not used
LIT_LEAST = 0.01  # of the image: less is no slide of rings on a wall
SOME = 4000  # cells that place the head: its poses are then known to micrometres
ROUNDS = 5  # for the head
BLURRED = 2  # maps with the blur taken out: a third changes nothing
POSE_SIGMA = (0.05, 0.05, 0.0, 0.03, 0.03, 0.0)  # rad, radii: a head's lean and offset; roll and place are as told
RADIUS_SIGMA = 0.03  # of it: what is believed of the stated radius
DRIFT = 0.1  # share by which a point's light may drift along half its track, beside the shading
WALL_LEAST = 1e-4  # of the radius: no wall is rounder
SLOPE_MAX = 1.0  # 1 / mm: an edge of albedo is sharper, the blur of it is not
APART = 8  # cells: two so far from each other share neither pixels nor texture
ROWS = 2  # either way, of cells apart round the pipe ..
LONG_ROWS = 16  # .. and along it
ROW_LEAST = 100  # cells that tell a scatter
BEYOND_FIRST = 0.2  # of what texture was found to do: a slope says it to the first order of the blur
CONTINUOUS = 0.25  # of a period: neighbours nearer than that are one surface
CONTRADICTED = 0.3  # cells of a surface that speak for another order, over those that speak for this one
TRIED = 4000  # cells whose other orders are tried


@dataclass(frozen=True, slots=True)
class PipeMap:
    """The wall as one scan shows it, in the pipe's frame (x right, y down, z along; phi from x towards y).

    z_mm (Z,), phi_deg (A,). radius_mm, sigma_mm (Z, A): NaN where not told. flag (Z, A): track.GOOD .. AMBIGUOUS.
    at_least : (Z, A) bool, the floor of a loss was not seen: the radius is a lower limit, or
    NaN (`groove`). dc, modulation (Z, A): light
    of the wall with the head's own shading taken out, and AC over DC. frames (Z, A): how many told. seen_by (Z, A): the
    eye whose frames did, the number of eyes where several, -1 where none. head : poses, shading, blur, mean radius.
    noise : of a grey level, as `noise_of` says. slipped (F,): flashes whose told place the frames contradict (`slip`);
    the head's poses have the frames'.
    """

    z_mm: FloatArray
    phi_deg: FloatArray
    radius_mm: FloatArray
    sigma_mm: FloatArray
    flag: Image
    at_least: BoolArray
    dc: FloatArray
    modulation: FloatArray
    frames: IntArray
    seen_by: IntArray
    head: PlacedHead
    noise: tuple[float, float, float]
    slipped: BoolArray

    @property
    def cell_mm(self) -> tuple[float, float]:
        """Along, and round the pipe."""
        return float(self.z_mm[1] - self.z_mm[0]), 2 * np.pi * self.head.radius_mm / len(self.phi_deg)


def measure_pipe(
    eyes: Sequence[Eye],
    shots: Shots,
    z_mm: FloatArray,
    radius_mm: float,
    *,
    roll_rad: FloatArray | None = None,
    cell_mm: float | None = None,
    seed: int = 0,
) -> PipeMap:
    """The wall of a pipe from N >= 3 frames of each eye.

    z_mm : (F,) where the head was at each flash, as measured, any steps; roll_rad : (F,) how it was rolled, clockwise
    looking forward, taken as told: a slide of rings says nothing of it. radius_mm : the pipe's, roughly (to a third of
    a fringe). AnnulusError where frames are too few, do not fit the positions or a camera, show no lit wall, or where
    the head stood still.
    """
    z_mm = np.asarray(z_mm, dtype=float)
    if len(shots.flash) and int(shots.flash.max()) >= len(z_mm):
        raise AnnulusError(f"{int(shots.flash.max()) + 1} flashes for {len(z_mm)} positions")
    head = PlacedHead.at(eyes, shots, z_mm[:, None] * [0.0, 0.0, 1.0], radius_mm, roll_rad)
    poses = head.poses
    head, coefficients, (near, far) = lit_wall(head, shots.images)
    step = cell_mm or CELL_OF_RADIUS * radius_mm
    z = np.arange(np.ceil((z_mm.min() + near) / step) * step, z_mm.max() + far, step)
    phi = np.arange(round(2 * np.pi * radius_mm / step)) * 2 * np.pi / round(2 * np.pi * radius_mm / step)
    points = Points.pipe(phi, z, radius_mm)
    random = np.random.default_rng(seed)
    pick = np.sort(random.choice(len(points.base), min(SOME, len(points.base)), replace=False))
    head, noise = _placed(head, coefficients, points.some(pick), poses)
    maps = _Maps(coefficients, points, noise, step)
    found = maps.heights(head, np.full(len(points.base), head.radius_mm - radius_mm), None)
    plain, texture = found, maps.texture(found)
    slipped = np.zeros(len(z_mm), bool)
    for again in range(2):
        for _ in range(BLURRED):
            texture = maps.texture(found)
            head = _refocused(head, coefficients, points.some(pick), poses, noise, found.height_mm[pick], texture[pick])
            found = maps.heights(head, np.nan_to_num(found.height_mm), texture)
        if again or len(shots.eye) < len(eyes) * len(z_mm):  # a slide in turn sees too little of the wall for a place
            break
        places = maps.places(head, poses, found, texture)
        slipped = places.slipped
        if not slipped.any():
            break
        along = np.where(slipped, places.off_mm, 0.0)[:, None] * [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        poses, head = poses + along, replace(head, poses=head.poses + along)
    found = _decided(head, coefficients, points, found, noise)
    shape = points.shape
    found = _scattered(head, z, found, shape, plain.height_mm, np.isfinite(texture))
    modulation = found.modulation.reshape(shape)
    height, sigma, at_least = groove.measured(
        head,
        coefficients,
        noise,
        phi,
        z,
        radius_mm,
        found.height_mm.reshape(shape),
        found.sigma_mm.reshape(shape),
        modulation,
    )
    return PipeMap(
        z,
        np.degrees(phi),
        radius_mm + height,
        sigma,
        found.flag.astype(np.uint8).reshape(shape),
        at_least,
        found.dc.reshape(shape),
        modulation,
        np.nan_to_num(found.used).astype(int).reshape(shape),
        found.who.reshape(shape),
        head,
        noise,
        slipped,
    )


def lit_wall(head: PlacedHead, images: Float32Array) -> tuple[PlacedHead, Float32Array, tuple[float, float]]:
    """The head with its shading's extent, the frames as splines, NaN where the slide throws no light, and how far
    ahead the lit wall begins and ends, mm. What lies in the dark of a rod or beyond the slide's edge stays there: they
    move with the head."""
    for eye in head.eyes:
        lens = eye.camera.camera
        if images.shape[1:] != (lens.height, lens.width):
            raise AnnulusError(
                f"images of {images.shape[2]}x{images.shape[1]}, but the camera is {lens.width}x{lens.height}"
            )
    head.view  # noqa: B018  says what is wrong with lens and positions
    coefficients, shading = np.empty_like(images, dtype=np.float32), head.shading.copy()
    for number, eye in enumerate(head.eyes):
        mine = head.eye == number
        lit, (near, far), widest = _lit(eye, images[mine], head.radius_mm)
        coefficients[mine] = spline(images[mine])
        coefficients[mine] = np.where(lit, coefficients[mine], np.nan)
        shading[number, 0, :3] = (near + far) / 2, (far - near) / 2, widest
    head = replace(head, shading=shading)
    middle, half = head.ahead
    return head, coefficients, (middle - half, middle + half)


def _lit(eye: Eye, images: Float32Array, radius_mm: float) -> tuple[BoolArray, tuple[float, float], float]:
    """(H, W) where an eye's frames show lit wall, how far ahead that begins and ends, mm, and the least cosine of its
    angle to the camera's axis."""
    lens = eye.camera.camera
    whole = np.isfinite(images).all(axis=0)
    if not whole.any():
        raise AnnulusError("every pixel is saturated in some frame: less light, or a shorter flash")
    mean = np.where(whole, np.where(np.isfinite(images), images, 0).mean(axis=0), 0)
    on = (mean > DARK * np.percentile(mean, 99)).astype(np.uint8)
    if on.mean() < LIT_LEAST:
        raise AnnulusError(f"{100 * on.mean():.1f} % of the image is lit: no fringes of light on a pipe's wall")
    ahead, phase = _wall_seen(eye, radius_mm)
    # a trough may be as dark as no light at all: across the fringes, dark no longer than a fringe is lit
    if eye.camera.rotation[2][2] > STRAIGHT and eye.projector.kind == "rings":
        size = (int(np.hypot(*mean.shape)), int(np.pi * min(mean.shape)))
        way = cv2.WARP_POLAR_LINEAR | cv2.INTER_NEAREST | cv2.WARP_FILL_OUTLIERS
        flat = cv2.warpPolar(on, size, (lens.cx, lens.cy), size[0], way)
        flat = cv2.morphologyEx(flat, cv2.MORPH_CLOSE, np.ones((1, _fringe_px(eye, radius_mm)), np.uint8))
        on = cv2.warpPolar(flat, mean.shape[::-1], (lens.cx, lens.cy), size[0], way | cv2.WARP_INVERSE_MAP)
    else:
        rate = np.hypot(*np.gradient(phase))[(on > 0) & np.isfinite(phase)]
        rate = rate[np.isfinite(rate)]
        if not len(rate):
            raise AnnulusError(BESIDE)
        longest = int(min(2 * np.pi / max(float(np.percentile(rate, 5)), 1e-3), lens.width / 8)) | 1
        on = cv2.morphologyEx(on, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (longest, longest)))
    lit = np.asarray(ndimage.binary_erosion((on > 0) & whole & np.isfinite(ahead), iterations=REACH_PX))
    if lit.sum() < LIT_LEAST * lit.size:
        raise AnnulusError("no wall is lit in all frames: are they saturated, or of another slide?")
    near, far = (float(one) for one in np.quantile(ahead[lit], [0.0005, 0.9995]))
    v, u = np.nonzero(lit)
    return lit, (near, far), float(lens.rays(np.stack([u, v], axis=1).astype(float))[:, 2].min()) - WIDER


def _wall_seen(eye: Eye, radius_mm: float) -> tuple[FloatArray, FloatArray]:
    """(H, W) how far ahead of the head each pixel sees the wall of a pipe it stands straight in, mm, and the slide's
    phase there; NaN where it sees none."""
    lens = eye.camera.camera
    v, u = np.mgrid[: lens.height, : lens.width]
    turn = np.array(eye.camera.rotation)
    rays = lens.rays(np.stack([u.ravel(), v.ravel()], axis=1).astype(float)) @ turn
    centre = -np.array(eye.camera.translation_mm) @ turn
    with np.errstate(invalid="ignore", divide="ignore"):
        wall = intersect_cylinder(rays, np.zeros(3), np.array([0.0, 0.0, 1.0]), radius_mm, np.tile(centre, (u.size, 1)))
    far = np.abs(wall[:, 2] - centre[2]) > FAR_OF_RADIUS * radius_mm
    wall = np.where(far[:, None], np.nan, wall)
    return wall[:, 2].reshape(u.shape), eye.projector.phase(wall).reshape(u.shape)


def _fringe_px(eye: Eye, radius_mm: float) -> int:
    """The longest fringe in the image of a wall that is as far off as the projector's own nominal one."""
    lens, slide = eye.camera.camera, eye.projector
    z = np.arange(0.2, 4.0, 0.01) * radius_mm
    wall = np.stack([np.full_like(z, radius_mm), np.zeros_like(z), z], axis=1)
    pixel, phase = lens.project(wall)[:, 0], slide.phase(wall)
    rate = np.abs(np.gradient(pixel) / np.gradient(phase))
    inside = (pixel > 0) & (pixel < lens.width) & np.isfinite(rate)
    if not inside.any():
        raise AnnulusError(BESIDE)
    return int(min(2 * np.pi * float(rate[inside].max()), lens.width / 8)) | 1


def followed(
    head: PlacedHead,
    images: Float32Array,
    points: Points,
    start: FloatArray,
    noise: tuple[float, float, float],
    texture: FloatArray | None = None,
) -> Heights:
    """`follow_wall` of those points, heights outwards from where the points are."""
    count = len(points.base)
    light = HeadLight(head.shading, head.blur_squared if texture is not None else 0.0, DRIFT, noise)
    wall = BorePoints(
        base=points.base,
        path=points.path,
        texture=np.zeros(count) if texture is None else np.nan_to_num(texture),
        start=start,
    )
    outcome, who = follow_wall(head.view.frames(images), light, wall, head.radius_mm * 1e-5)
    return Heights(*outcome, np.empty((0, 0), np.float32), who)


def _freedom(head: PlacedHead, prior: FloatArray, wall: float) -> Freedom:
    sigma = np.array(POSE_SIGMA) * [1, 1, 1, head.radius_mm, head.radius_mm, head.radius_mm]
    return Freedom(
        prior,
        np.tile(sigma, (len(prior), 1)),
        np.zeros(6),
        np.zeros(LAW),
        wall_mm=wall,
        drift=DRIFT,
        radius_mm=RADIUS_SIGMA * head.radius_mm,
    )


def _placed(
    head: PlacedHead, images: Float32Array, points: Points, prior: FloatArray
) -> tuple[PlacedHead, tuple[float, float, float]]:
    """The head's poses and shading from some cells, and the noise."""
    base = float(np.hypot(*points.base[0, :2]))
    wall, noise = RADIUS_SIGMA * base, (1.0, 0.0, 0.0)
    for turn in range(ROUNDS):
        start = np.full(len(points.base), head.radius_mm - base)
        found = followed(head, images, points, start, (1.0, 0.0, 0.0))
        noise = noise_of(found)
        found = followed(head, images, points, start, noise)
        if turn > 1:
            wall = _scatter(found, base)
        head, _ = refined(head, images, points, _freedom(head, prior, wall), noise, found)
    return head, noise


def _refocused(
    head: PlacedHead,
    images: Float32Array,
    points: Points,
    prior: FloatArray,
    noise: tuple[float, float, float],
    start: FloatArray,
    texture: FloatArray,
) -> PlacedHead:
    """The head with its lens's blur, found from what slopes of albedo do to the phase."""
    base = float(np.hypot(*points.base[0, :2]))
    for _ in range(2):
        found = followed(head, images, points, np.nan_to_num(start), noise, texture)
        head, _ = refined(
            head, images, points, _freedom(head, prior, _scatter(found, base)), noise, found, np.nan_to_num(texture)
        )
    return head


def _scatter(found: Heights, base: float) -> float:
    h = found.height_mm[found.flag == GOOD]
    if not len(h):
        raise AnnulusError("no cell of the wall shows fringes: is this the slide of the calibration?")
    return max(robust_sigma(h - np.median(h)), WALL_LEAST * base)


@dataclass(frozen=True, slots=True)
class _Maps:
    """The grid, and what one map says for the next."""

    images: Float32Array
    points: Points
    noise: tuple[float, float, float]
    step_mm: float

    def heights(self, head: PlacedHead, start: FloatArray, texture: FloatArray | None) -> Heights:
        return followed(head, self.images, self.points, start, self.noise, texture)

    def places(self, head: PlacedHead, prior: FloatArray, found: Heights, texture: FloatArray) -> FlashSlips:
        base = float(np.hypot(*self.points.base[0, :2]))
        freedom = _freedom(head, prior, _scatter(found, base))

        def follow(other: PlacedHead, some: Points, height: FloatArray, slope: FloatArray) -> Heights:
            return followed(other, self.images, some, np.nan_to_num(height), self.noise, slope)

        return find_places(head, self.images, self.points, found, texture, freedom, self.noise, self.step_mm, follow)

    def texture(self, found: Heights) -> FloatArray:
        """(P,) slope of the albedo along the pipe over itself, 1 / mm; NaN where too few frames know it."""
        with np.errstate(invalid="ignore", divide="ignore"):
            known = (found.flag == GOOD) & (found.dc > 0) & (found.used >= ROBUST_FROM)  # fewer know no DC by itself
            dc = np.log(np.where(known, found.dc, np.nan)).reshape(self.points.shape)
        rise = np.full((len(dc) + 1, dc.shape[1]), np.nan)
        rise[1:-1] = np.diff(dc, axis=0) / self.step_mm
        before, after = rise[:-1], rise[1:]  # at an end there is only one
        slope = np.where(np.isfinite(before), np.where(np.isfinite(after), (before + after) / 2, before), after).ravel()
        return np.clip(slope, -SLOPE_MAX, SLOPE_MAX)


def _scattered(
    head: PlacedHead, z_mm: FloatArray, found: Heights, shape: tuple[int, int], plain_mm: FloatArray, sloped: BoolArray
) -> Heights:
    """Sigma as cells APART differ, row by row: how far ahead and how often a row was seen decides what texture and blur
    leave beyond the noise of frames. Most of the wall is smooth over that distance. plain_mm : (P,) heights with the
    texture's share still in them; sloped : (P,) bool, whether that is known. What is not known of a large share is
    large, and cells without a slope of their own may have as much of it as others had."""
    h = np.where(found.flag == GOOD, found.height_mm, np.nan).reshape(shape)
    across, along = (h - np.roll(h, APART, axis=1)) / np.sqrt(2), np.full(shape, np.nan)
    along[APART:] = (h[APART:] - h[:-APART]) / np.sqrt(2)
    own = (found.sigma_mm**2).reshape(shape)
    variance = own.copy()
    for j in range(shape[0]):
        beyond = [0.0]
        for apart, rows in ((across, ROWS), (along, LONG_ROWS)):
            near = slice(max(j - rows, 0), j + rows + 1)
            spread = apart[near][np.isfinite(apart[near])]
            if len(spread) >= ROW_LEAST:
                beyond.append(robust_sigma(spread) ** 2 - float(np.nanmedian(own[near])))
        variance[j] += max(beyond)
    few = ~sloped.reshape(shape)
    changed = (found.height_mm - plain_mm).reshape(shape)
    variance += np.nan_to_num(BEYOND_FIRST * changed) ** 2
    changed = changed[~few & np.isfinite(changed)]
    usual = robust_sigma(changed) if len(changed) else 0.0
    middle, half = head.ahead
    ahead = middle + half * np.where(z_mm < z_mm.mean(), -1.0, 1.0)  # where few frames see a cell: at an end
    wider = ((head.radius_mm**2 + ahead**2) / (head.radius_mm**2 + middle**2)) ** 2  # a blur's square on the wall
    variance += np.where(few, (usual * wider[:, None]) ** 2, 0.0)
    return replace(found, sigma_mm=np.sqrt(variance.ravel()))


def _decided(
    head: PlacedHead, images: Float32Array, points: Points, found: Heights, noise: tuple[float, float, float]
) -> Heights:
    """A connected surface whose order of fringe its cells do not decide, against their other orders, is ambiguous."""
    shape = points.shape
    good = found.flag == GOOD
    h = np.where(good, found.height_mm, np.nan)
    if not good.any():
        return found
    spacing = 2 * np.pi / np.abs(head.view.radians_per_mm(points, np.nan_to_num(h)))
    near = CONTINUOUS * float(np.median(spacing[good]))
    smooth = ndimage.uniform_filter(np.nan_to_num(h).reshape(shape), 3) / np.maximum(
        ndimage.uniform_filter(good.reshape(shape).astype(float), 3), 1e-9
    )
    joined = good.reshape(shape) & (np.abs(np.nan_to_num(h).reshape(shape) - smooth) < near)
    surface, count = ndimage.label(joined, structure=np.ones((3, 3)))
    every = np.flatnonzero(good)[:: max(int(good.sum()) // TRIED, 1)]
    tried = points.some(every)
    plain = followed(head, images, tried, h[every], noise)
    which = surface.ravel()[every]
    largest = int(np.argmax(np.bincount(surface.ravel(), minlength=count + 1)[1:])) + 1 if count else 0
    sure = np.ones(count + 1, bool)
    for way in (-1, 1):
        other = followed(head, images, tried, h[every] + way * spacing[every], noise)
        with np.errstate(invalid="ignore"):
            another = (other.flag == GOOD) & (np.abs(other.height_mm - h[every]) > near)
            worse = np.where(another, other.misfit - plain.misfit, np.inf)
        spoken = np.bincount(which, weights=worse > PARALLAX, minlength=count + 1)
        against = np.bincount(which, weights=worse < -PARALLAX, minlength=count + 1)
        tested = spoken > 0
        tested[largest] = True  # what the stated radius says of the wall itself, until cells speak against it
        sure &= tested & (against <= CONTRADICTED * spoken)
    sure[0] = False
    unsure = good & ~sure[surface.ravel()] & (surface.ravel() > 0)
    return replace(
        found,
        height_mm=np.where(unsure, np.nan, found.height_mm),
        sigma_mm=np.where(unsure, np.nan, found.sigma_mm),
        flag=np.where(unsure, AMBIGUOUS, found.flag),
    )
