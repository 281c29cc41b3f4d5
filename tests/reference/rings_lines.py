"""Ridges of bright lines as host/native/rings_lines.c finds them, to be read: a sample at a time (Steger 1998)."""

import numpy as np


def ridges(smooth, slope, curve, stop, least_bend, per_line):
    """(N, 4) float32: line, place, curvature and width of every ridge; how many were too many for their line."""
    found, crowded = [], 0
    for line, end in enumerate(np.clip(stop, 0, smooth.shape[1])):
        own = [
            ridge
            for at in range(2, end - 2)
            for ridge in ridge_at(smooth[line], slope[line], curve[line], at, end, least_bend)
        ]
        crowded += max(len(own) - per_line, 0)
        strongest = sorted(range(len(own)), key=lambda n: -own[n][1])[:per_line]  # of equals, the inner ones
        found += [(line, own[n][0], own[n][1], own[n][2]) for n in sorted(strongest)]
    return np.array(found, np.float32).reshape(-1, 4), crowded


def ridge_at(smooth, slope, curve, at, end, least_bend):
    """Place, curvature and width of the ridge between a sample and the next, where there is one."""
    if not (slope[at] > 0.0 and slope[at + 1] <= 0.0):
        return []
    part = slope[at] / (slope[at] - slope[at + 1])
    bend = -(curve[at] + part * (curve[at + 1] - curve[at]))
    if bend < least_bend:
        return []
    return [(at + float(part), bend, width_at(smooth, at if part < 0.5 else at + 1, end))]


def width_at(smooth, top, end):
    """Between the two places where the light is halfway down to the higher of the dips beside it."""
    left, right = top, top
    while left > 0 and smooth[left - 1] <= smooth[left]:
        left -= 1
    while right < end - 1 and smooth[right + 1] <= smooth[right]:
        right += 1
    level = 0.5 * float(smooth[top] + max(smooth[left], smooth[right]))
    a, b = top, top
    while a > left and smooth[a - 1] > level:
        a -= 1
    while b < right and smooth[b + 1] > level:
        b += 1
    low = a - (smooth[a] - level) / max(float(smooth[a] - smooth[a - 1]), 1e-6) if a > 0 else a
    high = b + (smooth[b] - level) / max(float(smooth[b] - smooth[b + 1]), 1e-6) if b + 1 < len(smooth) else b
    return high - low
