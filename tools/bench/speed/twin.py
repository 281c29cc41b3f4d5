"""Milliseconds a frame of the twin's renderer. Medians of thread CPU time."""

import time
from dataclasses import replace
from statistics import median

from annulus_pipe.twin.head import sustainable_fps
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World, clean_world, demo_world
from tools.bench.table import Row

FRAMES = 9


def milliseconds(world: World, z_mm: float, projector: float, led: float) -> float:
    renderer = Renderer(world)
    renderer.render(world.pose(z_mm), z_mm, projector, led)
    spent = []
    for i in range(FRAMES):
        begun = time.thread_time()
        renderer.render(world.pose(z_mm), z_mm, projector, led, seed=i)
        spent.append((time.thread_time() - begun) * 1e3)
    return median(spent)


def rows() -> list[Row]:
    demo, clean = demo_world(), replace(clean_world(), travel_mm=60.0)
    fps = sustainable_fps(demo)
    return [
        *(
            Row(f"1664x1232, {name}", "-", "-", f"{milliseconds(world, z_mm, projector, led):.1f} ms")
            for name, world, z_mm, projector, led in (
                ("clean pipe, projector", clean, 30.0, 1.0, 0.0),
                ("clean pipe, LED", clean, 30.0, 0.0, 1.0),
                ("demo, projector, pockets and bump in view", demo, 85.0, 1.0, 0.0),
                ("demo, projector, oval in view", demo, 220.0, 1.0, 0.0),
                ("demo, LED", demo, 85.0, 0.0, 1.0),
                ("dark", clean, 30.0, 0.0, 0.0),
            )
        ),
        Row("demo, all cores the head uses", "-", "-", f"{1e3 / fps:.1f} ms a frame, {fps:.1f} frames/s"),
    ]
