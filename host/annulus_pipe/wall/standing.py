"""What of the map stands out over the limit of listing and belongs to nothing that is listed: sought last, with why.

Whoever looks at the map sees every patch of it. So whatever is over the limit that a report prints, and as large both
ways as the size that it prints, stands in the list or among the undecided places; or it is the rim of something that
does, lower than that and within a slit's width of it.

And what is measured lower may be over the limit all the same, by what it may be off: a slit draws a short pit flatter,
a dome's top is small. So a patch that may reach the limit, and is too large to be noise, is among the undecided too.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import nan_median
from annulus_pipe.wall.grid import Wall, smooth
from annulus_pipe.wall.indications import Indication, Kind, Scale, agreeing_observations
from annulus_pipe.wall.patches import label_around

# Held by tests/regression/dark_red_on_the_map_and_in_no_list.
RIM_PART = 0.6  # of the depth of what is listed beside it: a lower patch within a slit's width is that one's own rim
FEW = "fewer than two looks agree on it"
UNSURE_WHY = "its depth is known too little"
NOISE_WHY = "rings differ there by as much"
END_WHY = "only the last rows of the scan show it"
JOINT_WHY = "a joint's bead or edge and damage of it are not distinguished"
LEVEL_WHY = "it lies flat across the bottom: water, a deposit or a bump"
EDGE_WHY = "it lines the edge of something larger"
ROUND_WHY = "too little sound wall beside it round the pipe: damage, or part of a joint or a groove"
HOLLOW_WHY = "most of what its outline holds was not seen: a bump, or the rim of an opening"
THROUGH_WHY = "it is deeper than thin walls are thick, and light was lost in it: an opening, or a loss"
TALL_WHY = "it stands higher than it is wide: an object, or light of one ring taken for another's"
SHALLOW_WHY = "it is measured less deep than what is listed, and may be deeper"
SHALLOW_SIZES = 1.5  # of the smallest size that is listed, both ways: of smaller ones every map has some by its noise


def depth_limit_mm(wall: Wall, scale: Scale) -> float:
    """Smallest depth listed, as a report prints it."""
    noise = float(np.median(wall.noise_mm))
    return max(scale.limits.seed_noise * noise, scale.mm(scale.limits.seed_of_radius))


def left_standing(
    wall: Wall,
    scale: Scale,
    listed: Sequence[tuple[float, BoolArray]],
    features: BoolArray | None,
    joints: BoolArray | None,
) -> Iterator[tuple[Indication, str]]:
    """Every patch over the limit that nothing accounts for, or that may be over it, and why it is no defect.

    Parameters
    ----------
    listed : depth (mm) and cells (Z, A) of each defect and undecided place. features : (Z, A) cells where no defect is
        looked for. joints : (Z,) rows of joints: their bead stands out all round, so there a patch is what stands out
        of it, and the limit is that of the noise there.
    """
    limits, size = scale.limits, scale.mm(scale.limits.size_of_radius)
    seed, rim = scale.seed_and_rim(wall)
    limit = np.full_like(seed, depth_limit_mm(wall, scale))
    residual = smooth(wall.residual_mm()).astype(np.float64)
    known = wall.seen if features is None else wall.seen & ~features
    if joints is not None and joints.any():
        residual[joints] -= nan_median(residual[joints].T)[:, None]
        known = known | (wall.seen & joints[:, None])
        limit[joints] = np.maximum(limit, seed)[joints]
    known &= wall.shape_sigma_mm() <= wall.shape_limit_mm  # beside a shape that is not known nothing stands out
    cells = np.zeros(wall.radius_mm.shape, bool)
    deepest = np.zeros(wall.radius_mm.shape)
    for depth, place in listed:
        cells |= place
        beside = scale.around(place, scale.mm(limits.edge_of_radius))
        deepest[beside] = np.maximum(deepest[beside], depth)
    sigma = np.hypot(wall.cell_noise_mm, np.nan_to_num(wall.sigma_mm))
    may_reach = np.maximum(limit - 2.0 * np.hypot(sigma, wall.shape_sigma_mm()), rim)
    for kind, out in ((Kind.LOSS, residual), (Kind.BUMP, -residual)):
        height = np.where(known, out, -np.inf).astype(np.float32)
        left = np.zeros_like(cells)
        for part in _patches(height, limit, size, cells, deepest, scale):
            left |= part
        near, n = label_around(scale.around(left, scale.mm(limits.join_of_radius) / 2))
        if joints is not None:  # of a joint one line
            of_joint, many = ndimage.label(joints)
            near, n = np.where(joints[:, None], np.where(of_joint > 0, n + of_joint, 0)[:, None], near), n + many
        for i in range(1, n + 1):
            mask = left & (near == i)
            if not mask.any():
                continue
            if joints is not None and joints[mask.any(axis=1)].all():
                yield Indication(kind, mask, height, wall.cell_noise_mm, sigma), JOINT_WHY
                continue
            why = _why(mask, kind, height, wall, seed, rim, limits.observations)
            yield Indication(kind, mask, height, wall.cell_noise_mm, sigma), why
        cells |= left
        for part in _patches(height, may_reach, SHALLOW_SIZES * size, cells, deepest, scale):
            of_joint = joints is not None and joints[part.any(axis=1)].any()
            if not of_joint and agreeing_observations(part, kind, wall, rim) >= limits.observations:
                yield Indication(kind, part, height, wall.cell_noise_mm, sigma), SHALLOW_WHY


def _patches(
    height: Float32Array, least: FloatArray, size_mm: float, cells: BoolArray, deepest: FloatArray, scale: Scale
) -> Iterator[BoolArray]:
    """Patches (Z, A) beyond `least`, as large as `size_mm` both ways, that neither touch `cells` nor are the rim of
    what is `deepest` (mm) beside them."""
    label, n = label_around(height > least)
    for i in range(1, n + 1):
        part = label == i
        if (part & cells).any() or height[part].max() < RIM_PART * deepest[part].max():
            continue
        if all(np.count_nonzero(part.any(axis=1 - axis)) * scale.cell_mm[axis] >= size_mm for axis in (0, 1)):
            yield part


def _why(
    mask: BoolArray, kind: Kind, height: Float32Array, wall: Wall, seed: FloatArray, rim: FloatArray, observations: int
) -> str:
    if agreeing_observations(mask, kind, wall, rim) < observations:
        return FEW
    return NOISE_WHY if (height[mask] <= seed[mask]).mean() >= 0.5 else EDGE_WHY
