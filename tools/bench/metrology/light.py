"""What light does in a real pipe and our own drawings leave out, in mm: one pipe by Mitsuba, effect by effect.

The pipe is 6-inch, white, with a pocket and a bump; only light changes from row to row. It is surveyed as any
scan is, and its points are held against the true wall about the axis that the survey found (tools/bench/blind/cloud).
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tools.bench.blind.cloud import SLICE_OF_RADIUS, centred, errors
from tools.bench.blind.head import draw_head, draw_stands
from tools.bench.blind.pipe import Change, Material, Piece, Pipe, Scene, Sensor, Thing
from tools.bench.blind.results import Results, read_results
from tools.bench.blind.scan import write_frames
from tools.bench.blind.score import Number, judged, thing_numbers
from tools.bench.blind.stations import station_numbers
from tools.bench.blind.surface import Surface
from tools.bench.scenes.run import measure
from tools.bench.table import Row
from tools.light.camera import Camera
from tools.light.draw import smaller
from tools.light.effects import Effects, Tube

NOTE = (
    "By the light: how much farther out the middle point is than under a matt wall's light. Radius: the middle error "
    "of all points (positive: farther out than the wall is), what 95 % of them keep, and what 999 of 1000 keep. "
    "Diameter: the middle and the worst error of the stations' mean. Of a pocket of 2.5 mm and a bump of 2 mm: what is "
    "said less what is true, with k = 2. Pictures have 512 pixels a row, so a pixel is 0.5 to 2.4 mm of wall along the "
    "pipe. Made by `python -m tools.bench metrology light`."
)
RADIUS_MM, SEED, FRAMES = 76.2, 39, 12
THINGS = (Thing("pocket", 118.0, 20.0, 60.0, 24.0, 2.5, 1.0), Thing("bump", 150.0, 30.0, 200.0, 26.0, 2.0))
GLASS = Tube(9.0, 2.0)
TOGETHER = Effects(
    bounces=5,
    alpha=0.3,
    scatter_mm=0.2,
    tube=replace(GLASS, lean_deg=(0.2, 0.1)),
    curvature_px=1.0,
    lateral=(1e-3, -1e-3),
    dust=40,
    ghost=0.01,
    veil=0.03,
)
LIGHTS = {
    "matt wall, light straight from the slide": Effects(),
    "dry skin, a rough dielectric (alpha 0.3)": Effects(alpha=0.3),
    "wet skin (alpha 0.1, water)": Effects(alpha=0.1, index=1.33),
    "from wall to wall, five bounces, matt": Effects(bounces=5),
    "from wall to wall, five bounces, wet": Effects(bounces=5, alpha=0.1, index=1.33),
    "wall that scatters, 0.05 mm between two scatterings": Effects(scatter_mm=0.05),
    "wall that scatters, 0.2 mm": Effects(scatter_mm=0.2),
    "wall that scatters, 0.5 mm": Effects(scatter_mm=0.5),
    "wall that scatters, 1.5 mm, as without pigment": Effects(scatter_mm=1.5),
    "projector in a tube of 2 mm PMMA, calibrated in it": Effects(tube=GLASS),
    "that tube leans by 0.3 degrees since": Effects(tube=replace(GLASS, lean_deg=(0.3, 0.0))),
    "field curvature, blur of 1.5 px more at the edge": Effects(curvature_px=1.5),
    "lateral colour, red and blue 0.1 % larger and smaller": Effects(lateral=(1e-3, -1e-3)),
    "40 specks of dust on the slide": Effects(dust=40),
    "ghost of 1 %, veil of 3 %": Effects(ghost=0.01, veil=0.03),
    "all together, 0.2 mm between two scatterings": TOGETHER,
}


@dataclass(frozen=True, slots=True)
class Measured:
    """One light's survey against the truth. error_mm, sigma_mm : of points; diameters, things : what was said."""

    error_mm: NDArray[np.float64]
    sigma_mm: NDArray[np.float64]
    diameters: list[Number]
    things: dict[str, Number | None]

    @property
    def within(self) -> float:
        """Part of the points within k = 2."""
        return float(np.mean(np.abs(self.error_mm) <= 2.0 * self.sigma_mm))

    @property
    def middle_mm(self) -> float:
        return float(np.median(self.error_mm))


def scene() -> Scene:
    """The same pipe, head and places for every light."""
    rng = np.random.default_rng(SEED)
    head = replace(draw_head(np.random.default_rng(6), RADIUS_MM), rods=())
    stands = draw_stands(rng, RADIUS_MM, ())[:FRAMES]
    pipe = Pipe(
        (Piece(-3.0 * RADIUS_MM, RADIUS_MM),),
        THINGS,
        Material("white", (0.78, 0.77, 0.74), 0.0, 0.02, 0.0, 0.0, 0.0),
        0.003,
        40.0,
        0.0,
        (0.0, 1.0),
        ((0.0, 0.0), (0.0, 0.0)),
    )
    sensor = Sensor(0.8, 1e4, 4.0, 0.8, 0.0, 92, 1.0, (0.0, 40.0))
    return smaller(Scene(SEED, pipe, head, stands, sensor, Change(), {"loss": {"depth_mm": 1.0}}, ()))


def measured(effects: Effects, folder: Path) -> Measured:
    """Draws the pipe under some light into `folder`, surveys it, holds it against the truth."""
    drawn, camera = scene(), Camera(scene(), effects)
    (folder / "frames").mkdir(parents=True)
    write_frames(drawn, folder, camera.photograph, {}, camera.back_mm())
    measure(folder, folder / "results")
    return held(drawn, read_results(folder / "results"))


def held(drawn: Scene, results: Results) -> Measured:
    """A survey against the truth."""
    surface = Surface(drawn.pipe)
    known = np.isfinite(results.sigma_mm)
    places = surface.from_space(results.points_mm[known])
    error = errors(surface, *centred(surface, *places, SLICE_OF_RADIUS * RADIUS_MM))
    numbers = station_numbers(drawn, results, surface)
    return Measured(
        error,
        results.sigma_mm[known],
        [Number(*one) for one in numbers if one[0] == "diameter, mean"],
        dict(_things(drawn, results, surface)),
    )


def _things(drawn: Scene, results: Results, surface: Surface) -> Iterator[tuple[str, Number | None]]:
    listed = [one for one in results.listed if one.group != "undecided"]
    seen = results.from_mm, results.to_mm
    for thing in drawn.pipe.things:
        _, best, _ = judged(thing, drawn, results, listed)
        numbers = thing_numbers(thing, best, "", surface, seen) if best is not None else ()
        yield thing.kind, next((one for one in numbers if one.what == "depth"), None)


def reported(one: Measured, matt_mm: float) -> str:
    """A row's words. matt_mm : the middle error under a matt wall's light."""
    off = np.abs(one.error_mm)
    diameters = np.array([number.reported - number.true for number in one.diameters])
    kept = sum(bool(number.right) for number in one.diameters)
    worst = float(np.abs(diameters).max()) if len(diameters) else float("nan")
    middle = float(np.median(diameters)) if len(diameters) else float("nan")
    things = ", ".join(
        f"{kind} not listed"
        if number is None
        else f"{kind} {number.reported - number.true:+.2f} ± {number.k2:.2f}{' (≥)' if number.at_least else ''}"
        for kind, number in one.things.items()
    )
    kept_k2 = f"{100 * one.within:.1f} % of {len(off)} points within k = 2, and {kept} of {len(diameters)} diameters"
    within = f"{np.percentile(off, 95):.3f}, {np.percentile(off, 99.9):.2f} mm"
    return (
        f"{kept_k2}; by the light {one.middle_mm - matt_mm:+.3f} mm; radius {one.middle_mm:+.3f}, {within}; "
        f"diameter {middle:+.3f}, {worst:.3f} mm; {things}"
    )


def rows() -> list[Row]:
    out, matt_mm = [], float("nan")
    for name, effects in LIGHTS.items():
        with tempfile.TemporaryDirectory() as folder:
            try:
                one = measured(effects, Path(folder) / "scan")
                matt_mm = matt_mm if out else one.middle_mm
                words = reported(one, matt_mm)
            except Exception as error:  # must not cost the other lights
                words = f"{type(error).__name__}: {' '.join(str(error).split())}"
        print(f"  {name}: {words}", flush=True)
        out.append(Row(name, "-", "-", words))
    return out
