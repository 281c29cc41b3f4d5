"""A simulated scan as a scan folder: what a camera would have left behind, and the truth beside it."""

import csv
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.scans.scan import CAMERA, COLUMNS, ROLL, SLOT, TABLE
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World, every_world, translucent
from annulus_pipe.twin.worlds.sensor_head import Projector
from annulus_pipe.twin.worlds.world import WAVES
from annulus_pipe.vocabulary import AnnulusError, Label

LED_EVERY = 5  # four projector frames, one of the LED, as the head fires them
LEANS_ABOUT = 1.5  # radii from the camera: a head that leans stands off the axis there


def world_named(
    name: str, seed: int, defects: bool = True, lean_deg: float | None = None, red_mm: float | None = None
) -> World:
    """One of `every_world`; if given, its head leans by `lean_deg` at most, and light enters its wall (`translucent`).
    Raises AnnulusError for a name that is none, or a world whose wall is not drawn so."""
    worlds = every_world()
    if name not in worlds:
        raise AnnulusError(f"world {name!r}: expected one of {', '.join(worlds)}")
    world = worlds[name](seed)
    if not defects:
        world = replace(world, features=())
    if lean_deg is not None:
        lean = lean_deg / sum(WAVES)
        aside = LEANS_ABOUT * world.radius_mm * math.tan(math.radians(lean))
        world = replace(world, wobble_deg=lean, wobble_mm=aside)
    return world if red_mm is None else translucent(world, red_mm)


def write_scan(
    world: World,
    folder: Path,
    frames: int,
    progress: Callable[[str, int, int], None] | None = None,
    calibration: Calibration | None = None,
    counted: Callable[[float], float] | None = None,
) -> None:
    """Pull the head through the world in `frames` even steps and write the scan into `folder`, which must be empty.

    counted : what the odometer has with the head at a station, of a head on another's carrier; else the station.
    Writes frames.csv, frames/*.png, calibration.json (`calibration`, of a head that has changed since or stands in
    another pipe; else a perfect one) and truth.json, whose calibration is always the perfect one. Every fifth frame
    is the LED's; a head with several cameras has a picture of each in every step, but of those whose slide was dark.
    Raises AnnulusError where the folder
    cannot be written or holds something.
    """
    try:
        if folder.is_dir() and any(folder.iterdir()):
            raise AnnulusError(f"{folder}: is not empty, expected a new folder for the scan")
        (folder / "frames").mkdir(parents=True, exist_ok=True)
        known = calibration or world.calibration()
        (folder / "calibration.json").write_text(json.dumps(known.to_dict(), indent=1) + "\n")
        (folder / "truth.json").write_text(json.dumps(world.truth(), indent=1) + "\n")
        renderers = [Renderer(world, number) for number in range(len(world.cameras))]
        several = len(renderers) > 1
        with (folder / TABLE).open("w", newline="") as file:
            table = csv.writer(file)
            light = world.projector
            turning = light if not isinstance(light, Projector) and light.turns > 1 else None
            extra = [*([ROLL] if world.roll_deg else []), *([CAMERA] if several else []), *([SLOT] if turning else [])]
            table.writerow([*COLUMNS, *extra])
            stations = np.linspace(0.0, world.travel_mm, frames)
            counted = counted or float
            if counted(world.travel_mm) < counted(0.0):
                stations = stations[::-1]  # a carrier goes one way, and draws its backward head behind it
            for index, z_mm in enumerate(stations):
                slot = index % LED_EVERY
                led = slot == LED_EVERY - 1
                looks = turning.looking(slot) if turning and not led else ()
                lamp = (Label.LED if led else Label.PROJECTOR).value
                pose = world.pose(z_mm)
                roll = [] if pose.roll is None else [f"{math.degrees(pose.roll):.3f}"]
                for camera, renderer in enumerate(renderers):
                    if looks and camera not in looks:  # its slide is dark
                        continue
                    raw = renderer.render(pose, z_mm, float(not led), float(led), slot=slot, seed=index)
                    name = f"frames/{index:06d}{f'-{camera}' if several else ''}.png"
                    cv2.imwrite(str(folder / name), to_bgr(raw, "bayer_rggb8"), [cv2.IMWRITE_PNG_COMPRESSION, 1])
                    cells = [*([camera] if several else []), *([slot] if turning else [])]
                    table.writerow([index, name, lamp, f"{counted(z_mm):.4f}", *roll, *cells])
                if progress is not None:
                    progress("frames", index + 1, frames)
    except OSError as error:
        raise AnnulusError(f"{folder}: cannot be written ({error.strerror})") from None
