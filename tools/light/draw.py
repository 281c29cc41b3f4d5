"""Which effects the light of a drawn pipe has: from its seed, and from what its wall is made of."""

import math
from dataclasses import replace

import numpy as np

from tools.bench.blind.pipe import Scene
from tools.light.effects import Effects, Tube

BOUNCES = 4
WIDTH, MOST = 512, 30  # pixels of a picture's row; frames of a scan
WET = (0.07, 0.25)  # roughness of a wet wall's skin, least and most; of a dry one's
DRY = (0.25, 0.5)
TUBE_ODDS = 0.3
CLEAR = {"white": 0.8, "yellow": 0.6, "orange": 0.4}  # how often light wanders within a wall of that colour
SCATTER_MM = (0.03, 0.5)


def effects_of(scene: Scene) -> Effects:
    """Equal scenes have equal effects."""
    rng = np.random.default_rng([scene.seed, 0xEFF])
    material, radius = scene.pipe.material, scene.pipe.radius_mm
    wet = ", wet" in material.name
    alpha = float(np.clip(math.sqrt(material.gloss_width), *WET)) if wet else float(rng.uniform(*DRY))
    clear = rng.random() < CLEAR.get(material.name.split(",")[0], 0.0)
    scatter = math.exp(rng.uniform(*np.log(SCATTER_MM)))
    wall = radius * rng.uniform(0.012, 0.03)
    lean = rng.normal(0.0, 0.2, 2)
    tube = Tube(radius * rng.uniform(0.1, 0.15), float(wall), lean_deg=(float(lean[0]), float(lean[1])))
    has_tube = rng.random() < TUBE_ODDS
    red, blue = rng.normal(0.0, 4e-4, 2)
    return Effects(
        bounces=BOUNCES,
        alpha=alpha,
        index=1.33 if wet else 1.5,
        scatter_mm=scatter if clear else 0.0,
        tube=tube if has_tube else None,
        curvature_px=float(rng.uniform(0.0, 1.2) * scene.head.height / 616),
        lateral=(float(red), float(blue)),
        dust=int(rng.integers(0, 40)),
        ghost=float(rng.uniform(0.0, 0.01)),
        veil=float(rng.uniform(0.0, 0.04)),
    )


def smaller(scene: Scene) -> Scene:
    """The same scene by a sensor of WIDTH pixels a row, if its own is wider, and without every third frame, if there
    are more than MOST: path tracing costs by the pixel."""
    head = scene.head
    scale = min(1.0, WIDTH / head.width)
    stands = tuple(one for one in scene.stands if one.index % 3 != 1 or len(scene.stands) <= MOST)
    return replace(
        scene,
        stands=stands,
        head=replace(
            head,
            width=round(scale * head.width),
            height=round(scale * head.height),
            focal_px=scale * head.focal_px,
            centre_px=(scale * (head.centre_px[0] + 0.5) - 0.5, scale * (head.centre_px[1] + 0.5) - 0.5),
        ),
    )
