"""The wall along every generator as host/native/stereo_merge.c finds it, to be read: a generator at a time, cameras as
arrays. annulus_pipe.stereo.merge has the method; views as in stereo_view."""

import math

import numpy as np
from stereo_view import on_line

from annulus_pipe.stereo.merge import BLUNT, CONTRADICTED, EDGE, KNOWN, UNSEEN

JUMP_PX, SLOPE_LINES, NOISY, NOTHING = 3.0, 3, 0.12, np.full(3, np.nan)


def merge(views, expected, sights, vertices, ways, start, most, usable=None):
    """By ring and generator: distance, sigma, camera, heaviest, line, state, apart."""
    rings, steps = start.shape
    out = [[None] * steps for _ in range(rings)]
    for k in range(rings):
        clean = np.zeros((steps, len(views), 4))  # weight, pull, what is left of squares, pull of a pixel
        for p in range(steps):
            asked = range(len(views)) if usable is None else [c for c in range(len(views)) if usable[c, k, p]]

            def ask(s, k=k, p=p, asked=asked):
                """Of each camera: how far the ring's image is from where it should be, px; px a mm; sigma; line."""
                rows = np.full((len(views), 4), np.nan)
                for c in asked:
                    e = expected[c]
                    line, place = (
                        (e.line[k, p], e.place[k, p]) if s is None else on_line(views[c], vertices[k] + s * ways[k, p])
                    )
                    value, slope, sigma = look(
                        sights[c].place[k] - e.course[k], sights[c].sigma_px[k], e.course[k], line
                    )
                    gain = e.place_by_mm[k, p] - slope * e.line_by_mm[k, p]
                    rows[c] = value - place, gain, sigma, line
                return rows

            edges = [sight.edge_px[k] for sight in sights]
            out[k][p], clean[p] = solve(ask, start[k, p], most[k], edges, usable is not None)
        for p in range(steps) if usable is None else ():
            if out[k][p][5] in (EDGE, BLUNT):
                bias = np.array([sight.bias_px for sight in sights])
                found = among_neighbours(clean, p, most[k], bias)
                if found is not None:
                    beyond, sigma, camera = found
                    out[k][p] = (start[k, p] + beyond, sigma, camera, *out[k][p][3:5], KNOWN, out[k][p][6])
    return [np.array([[one[i] for one in row] for row in out]) for i in range(7)]


def look(stray, sigma_px, course, line):
    """Sample, samples a line and sigma of what was seen on a line between lines."""
    lines = len(stray)
    if math.isnan(line):
        return NOTHING
    a, part = int(line) % lines, line - int(line)
    b, (here, there) = (a + 1) % lines, stray[[a, (a + 1) % lines]]
    if abs(there - here) > JUMP_PX:
        return NOTHING
    if math.isnan(there - here):  # of one line alone only where that is the nearer
        near = a if part <= 0.5 else b
        value, sigma = stray[near], sigma_px[near]
    else:
        value, sigma = here + part * (there - here), sigma_px[a] + part * (sigma_px[b] - sigma_px[a])
    if math.isnan(value):
        return NOTHING
    slope = course[b] - course[a]
    change = (stray[(b + SLOPE_LINES) % lines] - stray[(a - SLOPE_LINES) % lines]) / (2 * SLOPE_LINES + 1)
    value += course[a] + part * slope
    return np.array([value, slope + change if abs(change) < JUMP_PX / 2 else slope, sigma])


def solve(ask, start, most, edges, gated):
    """Newton's steps from a clean pipe, then what all cameras together say; and what a clean wall is off."""
    clean, s, total, enough = np.zeros((len(edges), 4)), start, 0.0, (NOISY * most) ** 2
    unseen = (math.nan, math.nan, 0, 0, 0, UNSEEN, math.nan)
    if math.isnan(start):
        return unseen, clean
    for turn in range(6):
        rows = ask(None if turn == 0 else s)
        left, gain, sigma, _ = rows.T
        seen = ~np.isnan(left)
        weight = np.where(seen, 1.0 if gated else (gain / sigma) ** 2, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            pull = np.where(seen & ((gain != 0.0) | gated), weight * left / gain, 0.0).sum()
        total = weight.sum()
        if turn == 0:
            own = gain**2 * 1e-6 if gated else weight
            clean = np.where(seen, [own, gain * left / sigma**2, (left / sigma) ** 2, gain / sigma**2], 0.0).T
        if not (total * enough >= 1.0 or gated):
            break
        if not total > 0.0:
            return unseen, clean
        step = min(max(pull / total, -0.5 * start), start)
        s = min(max(s + step, 0.5 * start), 2.0 * start)
        if abs(step) < 0.2:
            rows[:, 0] -= gain * step
            break
    if not total > 0.0:
        return unseen, clean
    solved = decide(rows, s, most, edges, gated)
    return solved, np.zeros_like(clean) if solved[5] == EDGE else clean


def decide(rows, s, most, edges, gated):
    left, gain, sigma, at = rows.T
    seen = np.flatnonzero(~np.isnan(left))
    weight = np.where(np.isnan(left), -1.0, (gain / sigma) ** 2)
    weights, heaviest = weight[seen].sum(), int(np.argmax(weight))
    if not weights > 0.0:
        return math.nan, math.nan, 0, 0, 0, UNSEEN, math.nan
    line = int(at[heaviest] + 0.5)
    edge = np.array([min(edges[c][int(at[c] + 0.5) % len(edges[c])], sigma[c]) for c in seen])
    own = (weight[seen] * (1.0 - (edge / sigma[seen]) ** 2)).sum()
    shared = (np.abs(gain[seen]) * edge / sigma[seen] ** 2).sum()  # an edge of the wall moves all cameras' slits alike
    unlike = ((left[seen] / np.maximum(sigma[seen], 0.04)) ** 2).sum()
    state = KNOWN
    if not gated:
        if shared > 0.25 * most * weights:
            state = EDGE
        elif not weights * (NOISY * most) ** 2 >= 1.0:
            state = BLUNT
        elif len(seen) > 1 and unlike > 6.0**2 * (len(seen) - 1):
            state = CONTRADICTED
    if state != KNOWN:
        return math.nan, math.nan, 0, heaviest, line, state, math.nan
    alone = (weight > 0.03 * weights).sum() == 1
    both = len(seen) == 2 and weight.max() < 0.9 * weights
    apart = ((left[seen] / sigma[seen]) ** 2).sum() if both else math.nan
    return s, math.sqrt(own + shared**2) / weights, heaviest if alone else len(left), heaviest, line, KNOWN, apart


def among_neighbours(clean, p, most, bias_px):
    """A straight line through what the directions beside say, its slope known beforehand: two numbers."""
    steps = len(clean)
    beside = max(int(2.5 * steps / 360.0 + 0.5), 1)
    turn = np.arange(-beside, beside + 1)
    weight, pull, square, by_px = np.moveaxis(np.where(clean[..., 2:3] > 0.0, clean, 0.0)[(p + turn) % steps], 2, 0)
    count = np.count_nonzero(square > 0.0)
    if count <= beside or not weight.sum() > 0.0:
        return None
    design = np.stack([np.ones(len(turn)), turn])
    normal = (design * weight.sum(axis=1)) @ design.T
    normal[1, 1] += (steps / (360.0 * 0.2)) ** 2
    inverse = np.linalg.inv(normal)
    right = design @ pull.sum(axis=1)
    beyond, slope = inverse @ right
    unlike = (square.sum() - right @ (beyond, slope)) / count
    of_bias = (inverse[0] @ (design @ by_px)) * bias_px
    variance = 3.0 * max(unlike, 1.0) * inverse[0, 0] + (of_bias**2).sum()
    if not variance <= most**2:
        return None
    total = weight.sum(axis=0)
    first = int(np.argmax(total))
    return beyond, math.sqrt(variance), first if total.sum() - total[first] < 0.03 * total.sum() else len(total)
