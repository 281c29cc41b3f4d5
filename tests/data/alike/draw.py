"""Draws this folder anew, by POV-Ray: python tests/data/alike/draw.py"""

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[3]))

from tools.bench.blind.draw import draw
from tools.bench.blind.pipe import Change, Piece, Scene, Thing
from tools.bench.blind.scan import write_scan

POCKET = Thing("pocket", 150.0, 26.0, 110.0, 32.0, 2.6, 0.6)
BUMP = Thing("bump", 185.0, 30.0, 300.0, 30.0, 3.2)
SHALLOW = Thing("pocket", 195.0, 30.0, 40.0, 36.0, 1.7, 0.6)
FRAMES, STEP_MM = 25, 4.8


def scene() -> Scene:
    """A 5.5-inch pipe with two pockets and a bump, and a head that wobbles a little."""
    base = next(one for one in map(draw, range(200)) if one.head.model == "pinhole" and one.head.width == 640)
    grow = 70.0 / base.pipe.radius_mm
    pipe = replace(
        base.pipe,
        pieces=(Piece(-200.0, 70.0),),
        things=(POCKET, BUMP, SHALLOW),
        oval=0.01,
        swell=0.0,
        material=replace(base.pipe.material, name="white", albedo=(0.78, 0.77, 0.74), gloss=0.05, mirror=0.0),
    )
    head = replace(base.head, vertex_mm=tuple(grow * one for one in base.head.vertex_mm), rods=())
    stands = []
    for number in range(FRAMES):
        stand = base.stands[min(number, len(base.stands) - 1)]
        lamp = "led" if number % 5 == 4 else "projector"
        z = STEP_MM * number
        stands.append(
            replace(
                stand,
                index=number,
                lamp=lamp,
                z_mm=z,
                reported_mm=z,
                drift=0.0,
                tx_mm=grow * stand.tx_mm,
                ty_mm=grow * stand.ty_mm,
            )
        )
    sensor = replace(base.sensor, exposure=0.8, jpeg=85, veil=0.0, burnt=1.0)
    limits = {"loss": {"depth_mm": 1.2}, "bump": {"height_mm": 2.0}, "ovality": {"percent": 4.0}}
    return Scene(0, pipe, head, tuple(stands), sensor, Change(), limits, ())


if __name__ == "__main__":
    write_scan(scene(), Path(__file__).parent)
