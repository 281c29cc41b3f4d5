"""Chessboard corners in a photograph: of any size, partly seen, through any lens, with or without ChArUco markers.

Corners are found one by one and linked to their neighbours along the squares' edges, so nothing here needs to know how
many there are, and a wide lens may bend the rows as it likes. A calibration has a free pose for each photograph and
need not know which corner of the target a corner is; where the target tells, `origin` finds it out.
"""

from collections import deque
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import spatial
from annulus_pipe.numeric.robust import robust_sigma

# By topic intrinsics (13 of 13 real photographs kept, rays off the truth on drawn ones) and test_camera.
DETECT_PX = 1400  # longer sides are shrunk to this to find corners; they are refined in the photograph itself
SMOOTH_PX = 1.5  # before corners are looked for
RINGS_PX = (6.0, 4.0, 2.8)  # a corner shows four sectors, light and dark in turn, on one of these circles
SECTORS = 48  # samples round such a circle
NEIGHBOURS = 64  # a marker's bits have corners too, so the nearest is not always the next one
ALONG = np.cos(np.radians(14.0))  # a neighbour lies along the edge, ..
BACK = np.cos(np.radians(24.0))  # .. whose direction there agrees,
CLEAR = 8.0  # times the noise: a corner's contrast
ALIKE = 0.4  # both corners are of about one contrast,
EDGE = 0.35  # and all along, the edge has at least this part of the corners' contrast
WINDOW = 0.3  # of the distance to the next corner: what a place is read from; beyond, a slanted square has other edges
WINDOW_PX, WINDOW_BLURS = 12.0, 5.0  # and at most so many pixels, or standard deviations of the blur
BESIDE_MARKERS = 0.11  # the same, where markers begin an eighth of a square away
SPECKLED = 0.2  # of the contrast: standard deviation inside a square that has a marker
ACROSS = 0.12  # of a square each way: from a corner into the squares around it; a marker begins an eighth away
LEAST = 3  # corners each way


@dataclass(frozen=True, slots=True, eq=False)
class TargetView:
    """The corners of one target in one photograph."""

    cells: NDArray[
        np.int64
    ]  # (N, 2) column and row, from 0; as one looks at the photograph, columns then rows turn right
    pixels: FloatArray  # (N, 2)
    step_px: float  # median distance between neighbours
    blur_px: float  # standard deviation of the blur of its edges
    markers: bool  # something is printed in every other square
    dark: int  # 0 or 1: the square beyond corner (x, y) is dark where x + y is even, or odd
    own_origin: bool = False  # cells are numbered as on the target, in every photograph alike; see `origin`

    @property
    def size(self) -> tuple[int, int]:
        """Corners the long way and the short way, as far as they are seen."""
        columns, rows = (int(v) for v in self.cells.max(axis=0) + 1)
        return max(columns, rows), min(columns, rows)


def renumbered(view: TargetView, quarters: int, shift: NDArray[np.int64]) -> TargetView:
    """Its cells turned by so many quarter turns, (x, y) to (y, -x), and then moved by (2,) whole cells."""
    turn = np.linalg.matrix_power(np.array([[0, 1], [-1, 0]]), quarters % 4)
    square = np.floor(turn @ [0.5, 0.5] + shift).astype(int)  # where the one beyond corner (0, 0) comes to be
    return replace(view, cells=view.cells @ turn.T + shift, dark=int((view.dark + square.sum()) % 2))


def cropped(view: TargetView, columns: int, rows: int) -> TargetView:
    """The part of a view that a target of columns x rows corners can have: clutter sometimes adds a row."""
    best: NDArray[np.bool_] = np.zeros(len(view.cells), bool)
    x, y = view.cells.T
    for width, height in ((columns, rows), (rows, columns)):
        for left in range(max(int(x.max()) + 2 - width, 1)):
            for top in range(max(int(y.max()) + 2 - height, 1)):
                inside = (x >= left) & (x < left + width) & (y >= top) & (y < top + height)
                if np.count_nonzero(inside) > np.count_nonzero(best):
                    best = inside
    part = replace(view, cells=view.cells[best], pixels=view.pixels[best])
    return renumbered(part, 0, -part.cells.min(axis=0))


def find_target(image: NDArray[np.uint8]) -> TargetView | None:
    """The largest connected piece of a chessboard in (H, W) or (H, W, 3) uint8, or None where there is none.

    Corners are saddles of the brightness with four sectors around them. Two are neighbours if each lies along an edge
    of the other and the same side of that edge is light at both.
    """
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    scale = min(1.0, DETECT_PX / max(grey.shape))
    best: dict[tuple[int, int], FloatArray] = {}
    for level in (scale, scale / 2, scale / 4):  # out of focus, an edge is found where it has become sharp again
        if min(grey.shape) * level < 100:
            break
        small = cv2.resize(grey, None, fx=level, fy=level, interpolation=cv2.INTER_AREA) if level < 1 else grey
        factor = np.array([grey.shape[1] / small.shape[1], grey.shape[0] / small.shape[0]])
        found = _grid(np.asarray(small, np.float32))
        if len(found) > 1.1 * len(best):
            best = {cell: (at + 0.5) * factor - 0.5 for cell, at in found.items()}
    if len(best) < LEAST * LEAST:
        return None
    return _refined(np.asarray(grey, np.uint8), best)


def _grid(grey: NDArray[np.float32]) -> dict[tuple[int, int], FloatArray]:
    corners, ways, contrast = _corners(grey)
    if len(corners) < LEAST * LEAST:
        return {}
    link = _links(cv2.GaussianBlur(grey, (0, 0), 0.8), corners, ways, contrast)
    largest: dict[tuple[int, int], int] = {}
    seen = np.zeros(len(corners), bool)
    for seed in np.argsort(-(link >= 0).sum(axis=1)):
        if not seen[seed]:
            piece = _walk(int(seed), link, seen)
            if len(piece) > len(largest):
                largest = piece
    return {cell: corners[i] for cell, i in _trimmed(largest).items()}


def _corners(grey: NDArray[np.float32]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N, 2) places, (N, 4) angles of the edges that leave each, rising, the first and third with light on the side
    of larger angles; (N,) light less dark."""
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX)
    xx, yy, xy = (cv2.Sobel(smooth, cv2.CV_32F, dx, dy, ksize=3) for dx, dy in ((2, 0), (0, 2), (1, 1)))
    saddle = xy * xy - xx * yy
    peak = (saddle >= cv2.dilate(saddle, np.ones((5, 5), np.uint8))) & (saddle > 4e-4 * float(saddle.max()))
    edge = int(np.ceil(RINGS_PX[-1])) + 1
    peak[:edge], peak[-edge:], peak[:, :edge], peak[:, -edge:] = False, False, False, False
    y, x = np.nonzero(peak)
    if len(x) > 6000:
        some = np.argsort(-saddle[y, x])[:6000]
        x, y = x[some], y[some]
    at = np.stack([x, y], axis=1).astype(float)
    angle = np.arange(SECTORS) * (2 * np.pi / SECTORS)
    light = cv2.GaussianBlur(grey, (0, 0), 0.8)
    ways, contrast = np.full((len(at), 4), np.nan), np.zeros(len(at))
    for radius in RINGS_PX:
        todo = np.flatnonzero(np.isnan(ways[:, 0]))
        ring = _sample(light, at[todo, None] + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
        ways[todo], contrast[todo] = _sectors(ring)
    noise = robust_sigma(light - cv2.GaussianBlur(light, (0, 0), 1.6))
    good = np.isfinite(ways[:, 0]) & (contrast > CLEAR * noise)
    good[good] = contrast[good] > 0.12 * np.percentile(contrast[good], 90) if good.any() else False
    return at[good], ways[good], contrast[good]


def _sectors(ring: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, S) light round N places -> (N, 4) angles of the edges, NaN where it is not four sectors; (N,) contrast."""
    high, low = np.percentile(ring, 85, axis=1), np.percentile(ring, 15, axis=1)
    value = ring - ((high + low) / 2)[:, None]
    after = np.roll(value, -1, axis=1)
    crossing = (value < 0) != (after < 0)
    turned = np.roll(value, SECTORS // 2, axis=1)
    alike = (value * turned).sum(axis=1) / np.maximum((value * value).sum(axis=1), 1e-9)
    good = np.flatnonzero((crossing.sum(axis=1) == 4) & (alike > 0.6))
    ways = np.full((len(ring), 4), np.nan)
    if len(good):
        column = np.nonzero(crossing[good])[1].reshape(-1, 4)
        before = np.take_along_axis(value[good], column, axis=1)
        part = before / (before - np.take_along_axis(after[good], column, axis=1))
        angle = (column + part) * (2 * np.pi / SECTORS)
        first = before[:, 0] < 0  # the first crossing turns light
        angle = np.where(first[:, None], angle, np.roll(angle, -1, axis=1))
        straight = np.cos(angle[:, :2] - angle[:, 2:]).max(axis=1)  # both edges go straight on
        width = np.sin(angle[:, 1] - angle[:, 0])
        good, angle = good[ok := (straight < -0.8) & (np.abs(width) > 0.17)], angle[ok]
        ways[good] = angle
    return ways, high - low


def _links(light: NDArray[np.float32], at: FloatArray, ways: FloatArray, contrast: FloatArray) -> NDArray[np.int64]:
    """(N, 4) the next corner along each edge, -1 for none; only what both ends agree on."""
    count = min(NEIGHBOURS, len(at) - 1)
    distance, near = spatial.cKDTree(at).query(at, count + 1)
    distance, near = distance[:, 1:], near[:, 1:]
    towards = np.arctan2(at[near, 1] - at[:, None, 1], at[near, 0] - at[:, None, 0])
    alike = np.minimum(contrast[near] / contrast[:, None], contrast[:, None] / contrast[near]) > ALIKE
    link = np.full((len(at), 4), -1)
    came = np.full((len(at), 4), -1)
    for way in range(4):
        fits = (np.cos(towards - ways[:, way, None]) > ALONG) & alike
        # Seen from there, the light lies on the other side: the edge back is of the other kind.
        back = np.cos(towards[..., None] + np.pi - ways[near][:, :, [(way + 1) % 4, (way + 3) % 4]])
        fits &= back.max(axis=2) > BACK
        for i in np.flatnonzero(fits.any(axis=1)):
            for n in np.flatnonzero(fits[i])[:4]:
                j = near[i, n]
                if _edge_holds(light, at[i], at[j], min(contrast[i], contrast[j]), 1.0 if way % 2 == 0 else -1.0):
                    link[i, way] = j
                    came[i, way] = ((way + 1) % 4, (way + 3) % 4)[int(back[i, n].argmax())]
                    break
    for i, way in zip(*np.nonzero(link >= 0), strict=True):
        if link[link[i, way], came[i, way]] != i:
            link[i, way] = -1
    return link


def _edge_holds(light: NDArray[np.float32], a: FloatArray, b: FloatArray, contrast: float, side: float) -> bool:
    """Whether the line from a to b has light on one side, all along."""
    way = b - a
    length = float(np.hypot(*way))
    across = np.array([-way[1], way[0]]) / length
    off = float(np.clip(0.12 * length, 1.5, 6.0))
    part = np.array([0.25, 0.4, 0.5, 0.6, 0.75])
    middle = a + part[:, None] * way
    difference = _sample(light, middle + off * across) - _sample(light, middle - off * across)
    return bool((side * difference > EDGE * contrast).all())


def _walk(seed: int, link: NDArray[np.int64], seen: NDArray[np.bool_]) -> dict[tuple[int, int], int]:
    """Columns and rows of all corners linked with the seed. What two ways lead to at different places is left out."""
    steps = ((1, 0), (0, 1), (-1, 0), (0, -1))
    place: dict[int, tuple[int, int]] = {seed: (0, 0)}
    turn = {seed: 0}  # which of a corner's edges runs along the columns
    torn: set[int] = set()
    todo = deque([seed])
    seen[seed] = True
    while todo:
        i = todo.popleft()
        for way in range(4):
            j = int(link[i, way])
            if j < 0:
                continue
            dx, dy = steps[(way - turn[i]) % 4]
            there = (place[i][0] + dx, place[i][1] + dy)
            if j in place:
                if place[j] != there:
                    torn |= {i, j}
                continue
            back = int(np.flatnonzero(link[j] == i)[0])
            place[j], turn[j] = there, (back + 2 - (way - turn[i])) % 4
            seen[j] = True
            todo.append(j)
    grid: dict[tuple[int, int], int] = {}
    for i, cell in place.items():
        if i not in torn:
            grid.setdefault(cell, i)
    return grid


def _trimmed(grid: dict[tuple[int, int], int]) -> dict[tuple[int, int], int]:
    """Without corners that hang on by one link: a target has none, the clutter around it has."""
    while True:
        alone = [
            (x, y)
            for x, y in grid
            if not (((x - 1, y) in grid or (x + 1, y) in grid) and ((x, y - 1) in grid or (x, y + 1) in grid))
        ]
        if not alone:
            return grid
        grid = {cell: i for cell, i in grid.items() if cell not in alone}


def _refined(grey: NDArray[np.uint8], grid: dict[tuple[int, int], FloatArray]) -> TargetView | None:
    """Places to a fraction of a pixel: where all brightness gradients around are at right angles to the way there."""
    cells = np.array(list(grid))
    rough = np.array(list(grid.values()))
    step = np.full(len(cells), np.inf)
    mean: list[float] = []
    ends: list[tuple[FloatArray, FloatArray]] = []
    for i, (x, y) in enumerate(grid):
        for other in ((x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1)):
            if other in grid:
                length = float(np.hypot(*(grid[other] - rough[i])))
                step[i] = min(step[i], length)
                mean.append(length)
                ends.append((rough[i], grid[other]))
    markers = _has_markers(grey, grid)
    blur = _blur(grey, ends)
    size = np.array([grey.shape[1], grey.shape[0]])
    # Edges that a lens bends pull a corner to their hollow side by the square of the window; so no more than needed,
    # and none of what lies outside the image.
    reach = np.minimum((BESIDE_MARKERS if markers else WINDOW) * step, max(WINDOW_PX, WINDOW_BLURS * blur))
    reach = np.minimum(reach, np.minimum(rough, size - 1 - rough).min(axis=1) - 2)
    windows = np.clip(np.rint(reach), 2, 40).astype(int)
    fine = np.empty_like(rough)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    for window in np.unique(windows):
        mine = windows == window
        first = rough[mine].astype(np.float32).reshape(-1, 1, 2)
        fine[mine] = cv2.cornerSubPix(grey, first, (int(window),) * 2, (-1, -1), criteria).reshape(-1, 2)
    good = (np.linalg.norm(fine - rough, axis=1) < np.maximum(0.3 * step, 2.0)) & np.all(
        (fine > 1) & (fine < size - 2), axis=1
    )
    if np.count_nonzero(good) < LEAST * LEAST:
        return None
    first = cells[good].min(axis=0)
    if np.any(cells[good].max(axis=0) - first < LEAST - 1):
        return None
    view = TargetView(cells[good], fine[good], float(np.median(mean)), blur, markers, _dark(grey, grid))
    return renumbered(view, 0, -first)


def _dark(grey: NDArray[np.uint8], grid: dict[tuple[int, int], FloatArray]) -> int:
    """Whether squares of even or of odd column and row are the dark ones, by light across the corners."""
    votes = 0.0
    light = grey.astype(np.float32)
    for (x, y), at in grid.items():
        if (x + 1, y) in grid and (x, y + 1) in grid:
            a, b = ACROSS * (grid[x + 1, y] - at), ACROSS * (grid[x, y + 1] - at)
            own, far, other, another = _sample(light, at + np.array([a + b, -a - b, a - b, b - a]))
            votes += float(np.sign(own + far - other - another)) * (1 if (x + y) % 2 == 0 else -1)
    return 0 if votes < 0 else 1


def _has_markers(grey: NDArray[np.uint8], grid: dict[tuple[int, int], FloatArray]) -> bool:
    part = np.linspace(0.2, 0.8, 9)
    u, v = (w.ravel()[:, None] for w in np.meshgrid(part, part))
    inside = [
        (1 - v) * ((1 - u) * a + u * grid[x + 1, y]) + v * ((1 - u) * grid[x, y + 1] + u * grid[x + 1, y + 1])
        for (x, y), a in grid.items()
        if (x + 1, y) in grid and (x, y + 1) in grid and (x + 1, y + 1) in grid
    ]
    if not inside:
        return False
    light = _sample(grey.astype(np.float32), np.array(inside))
    contrast = np.percentile(light, 95) - np.percentile(light, 5)
    return bool(np.mean(light.std(axis=1) > SPECKLED * contrast) > 0.25)


def _blur(grey: NDArray[np.uint8], ends: list[tuple[FloatArray, FloatArray]]) -> float:
    """Standard deviation in pixels of the edges' blur, from light over steepest slope half way between corners."""
    a, b = (np.array([pair[i] for pair in ends]) for i in (0, 1))
    way = b - a
    length = np.linalg.norm(way, axis=1, keepdims=True)
    across = np.stack([-way[:, 1], way[:, 0]], axis=1) / length
    part = np.linspace(-0.35, 0.35, 41)
    profile = _sample(grey.astype(np.float32), (a + b)[:, None] / 2 + (length * part)[:, :, None] * across[:, None])
    profile = np.asarray(cv2.GaussianBlur(profile.astype(np.float32), (3, 1), 0))
    range_ = np.abs(profile[:, :6].mean(axis=1) - profile[:, -6:].mean(axis=1))
    slope = np.abs(np.diff(profile, axis=1)).max(axis=1) / (length[:, 0] * (part[1] - part[0]))
    return float(np.median(range_ / np.maximum(slope, 1e-6)) / np.sqrt(2 * np.pi))


def _sample(image: NDArray[np.float32], at: FloatArray) -> FloatArray:
    """Bilinear at (.., 2) places."""
    flat = at.reshape(-1, 2).astype(np.float32)
    out = np.empty(len(flat), np.float32)
    for i in range(0, len(flat), 30000):  # cv2's limit on a map's side
        part = flat[i : i + 30000]
        out[i : i + 30000] = cv2.remap(
            image, part[:, 0], part[:, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        ).reshape(-1)
    return out.reshape(at.shape[:-1]).astype(float)
