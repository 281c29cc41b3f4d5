"""Where a camera of a head sees the rings, and its slits against that, as host/native/stereo_view.c has it, to be read.

A camera is any with `camera` (geometry.Camera), `rotation`, `translation` from the head's frame, and `centre`, `first`,
`step`, `lines` of its polar lines.
"""

import math

import numpy as np

from annulus_pipe.numeric.robust import SIGMA_OF_MAD


def on_line(view, point):
    """Line and sample of a point of the head's frame."""
    pixel = view.camera.project((view.rotation @ point + view.translation)[None])[0]
    u, v = pixel - view.centre
    return np.array(
        [math.atan2(v, u) * view.lines / (2.0 * math.pi) % view.lines, (math.hypot(u, v) - view.first) * view.step]
    )


def short_way(lines, all_round):
    return lines - all_round * np.floor(lines / all_round + 0.5)


def expect(view, cones, ways, start, pose):
    """by_generator (4, K, P), by_line (3, K, J): every generator by itself, no cubics between some."""
    by_generator, by_line = np.full((4, *start.shape), np.nan), np.full((3, len(cones), view.lines), np.nan)
    for k, cone in enumerate(cones):
        by_angle, by_radius = np.full((len(start[k]), 2), np.nan), np.full(len(start[k]), np.nan)
        for p, near in enumerate(start[k]):
            if math.isfinite(near):
                by_generator[:, k, p], by_angle[p], by_radius[p] = of_generator(view, cone, ways[k, p], near, pose)
        for p in range(len(start[k])):
            q = (p + 1) % len(start[k])
            between(by_generator[:, k, [p, q]].T, by_angle[[p, q]], by_radius[[p, q]], by_line[:, k])
    return by_generator, by_line


def of_generator(view, cone, way, near, pose):
    """Line, sample, both by a mm; both by a radian of the half-angle where the wall stays; radii a mm."""
    vertex, axis, half = cone[:3], cone[3:6], cone[6]
    point, step = vertex + near * way, 0.02 * near

    def change(to, by):
        line, place = on_line(view, to) - here
        return np.array([short_way(line, view.lines), place]) / by

    here = on_line(view, point)
    turning = math.cos(half) * way - axis  # how the way turns as the cone opens
    out, along, aside = (pose.rotation.T @ v for v in (point - pose.translation, way, turning))
    back = (out[:2] @ aside[:2]) / (out[:2] @ along[:2])
    by_mm = change(point + step * way, step)
    by_angle = change(point + step / math.sin(half) * (turning - back * way), 0.02)
    return np.concatenate([here, by_mm]), by_angle, (out[:2] @ along[:2]) / (out[:2] @ out[:2])


def between(two, by_angle, by_radius, by_line):
    """The lines between two generators: course, by a radius and by a radian, along a straight line in the picture."""
    lines = by_line.shape[1]
    (a, place_a, line_mm_a, place_mm_a), (b, place_b, line_mm_b, place_mm_b) = two
    span = short_way(b - a, lines)
    if not abs(span) > 0.0:
        return
    slope = (place_b - place_a) / span
    by_radius = (np.array([place_mm_a, place_mm_b]) - slope * np.array([line_mm_a, line_mm_b])) / by_radius
    by_angle = by_angle[:, 1] - slope * by_angle[:, 0]
    for line in range(math.ceil(min(a, a + span)), math.floor(max(a, a + span)) + 1):
        part = (line - a) / span
        values = np.array([[place_a, place_b], by_radius, by_angle])
        by_line[:, line % lines] = values[:, 0] + part * (values[:, 1] - values[:, 0])


def off(direction, position, could_be, course, by_radius, spacing):
    """px beyond where each ring should be; against a wall of a radius more, and the nearer neighbour's place."""
    here = course[:, direction].T
    step = np.abs(np.diff(here, axis=1))
    none = np.full((len(here), 1), np.inf)
    apart = np.where(np.isnan(step), np.inf, step)
    gap = np.minimum(np.hstack([none, apart]), np.hstack([apart, none]))
    gap = np.where(np.isfinite(gap), gap, spacing)
    beyond = position[:, None] - here
    return beyond, np.where(could_be, beyond / np.hypot(by_radius[:, direction].T, gap), np.nan)


def as_usual(ring, direction, by_angle, width):
    """Widths as they would be where each ring's slit were equally wide all round."""
    out = np.array(width)
    for n, (k, j) in enumerate(zip(ring, direction, strict=True)):
        if k >= 0 and by_angle[k, j] > 0.0:
            seen = by_angle[k][~np.isnan(by_angle[k])]
            out[n] *= seen.mean() / by_angle[k, j]
    return out


def table(ring, direction, position, width, widest, bend, offset):
    """Places in the middle of the angles, and slits."""
    place, which = np.full(bend.shape, np.nan), np.full(bend.shape, -1)
    for n, (k, j) in enumerate(zip(ring, direction, strict=True)):
        if k >= 0:
            which[k, j] = n
            place[k, j] = position[n] + bend[k, j] * min(width[n], widest) ** 2 / 8.0 - offset[k, j]
    return place, which


def spread(which, stray, edge_blur, inside, outside, wider, least):
    """How far each slit's place may be off, px, and of that what the edge of a wall may."""
    sigma, edge = np.full(which.shape, np.nan), np.zeros(which.shape)
    for k, slits in enumerate(which):
        ahead = [np.roll(stray[k], -4 * n) for n in range(4)]
        third = np.abs(ahead[3] - 3.0 * ahead[2] + 3.0 * ahead[1] - ahead[0])
        third = np.sort(third[~np.isnan(third)])
        scatter = SIGMA_OF_MAD / math.sqrt(20.0) * third[len(third) // 2] if len(third) >= 40 else 0.1
        seen = np.flatnonzero(slits >= 0)
        blurs = np.sort(edge_blur[slits[seen]])
        for j in seen:
            n = slits[j]
            soft = scatter * min(max(edge_blur[n] / max(blurs[len(blurs) // 2], 1e-9), 0.5), 4.0)
            bias = max(0.12, least) if max(inside[n].max(), outside[n].max()) > 235.0 else least
            foreign = max((0.5 * wider[n]) ** 2 - 4.0 * soft**2, 0.0) / 3.0
            edge[k, j], sigma[k, j] = math.sqrt(foreign), math.sqrt(soft**2 + bias**2 + foreign)
    return sigma, edge
