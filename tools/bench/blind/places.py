"""Where in a pipe a number was measured: what makes it hard there. The first of these that holds is its place."""

import numpy as np

from tools.bench.blind.pipe import Scene
from tools.bench.blind.surface import away_deg

PLACES = ("in drift", "in a bend", "at an end", "beside a joint", "behind a step or rod", "plain wall")
END_OF_RADIUS = 0.35  # of the scan's ends
JOINT_OF_RADIUS = 0.35  # of a joint's, gap's, reducer's or taper's own ends
SHADOW = 2.5  # times its height is how long a step's shadow may be; and a little
ROD_DEG = 7.0
BREAKS = ("joint", "gap", "reducer", "taper")
STEPS = ("bump", "dent", "tee", "cable", "hose", "silt", "water")


def place_of(scene: Scene, span: tuple[float, float], clock: float, arc: float, seen: tuple[float, float]) -> str:
    """The place of something from span[0] to span[1]; `seen` are the ends of what was scanned."""
    radius, things = scene.pipe.radius_mm, scene.pipe.things
    if scene.change.any:
        return "in drift"
    if any(one.kind == "bend" and _near(one.span_mm, span, 0.0) for one in things):
        return "in a bend"
    if span[0] < seen[0] + END_OF_RADIUS * radius or span[1] > seen[1] - END_OF_RADIUS * radius:
        return "at an end"
    others = [one for one in things if one.span_mm != span]
    if any(one.kind in BREAKS and _near(one.span_mm, span, JOINT_OF_RADIUS * radius) for one in others):
        return "beside a joint"
    for one in others:
        if one.kind in STEPS:
            last = one.span_mm[1]
            behind = (last, last + SHADOW * max(one.depth_mm, 0.03 * radius) + 0.05 * radius)
            off = abs(float(away_deg(np.array(clock), one.clock_deg)))
            if _near(behind, span, 0.0) and off <= (arc + one.arc_deg) / 2:
                return "behind a step or rod"
    if arc < 180.0:
        for rod, _, _ in scene.head.rods:
            if abs(float(away_deg(np.array(clock), rod))) <= arc / 2 + ROD_DEG / 2:
                return "behind a step or rod"
    return "plain wall"


def _near(one: tuple[float, float], other: tuple[float, float], margin: float) -> bool:
    return one[0] - margin <= other[1] and other[0] <= one[1] + margin
