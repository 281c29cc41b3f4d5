"""The source's figures 7.3 to 7.8 and 8.1 to 8.14 (but the set-up's photographs), and tables 8.1 to 8.3, as simulation.

    for done in study(["8.4"], Path("out")):        # out/fig8.4.png, out/study.csv, out/study.json
        print(done.name, done.numbers)

Each figure is a picture and a row of numbers. `make bench-thermoacoustic` holds the same numbers against targets.
"""

import csv
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from annulus_pipe.vocabulary import AnnulusError
from tools.study import bubbles, codes, images, microwaves, noise, plates, wires
from tools.study.figure import Figure

Progress = Callable[[str, int, int], None]

FIGURES: Mapping[str, tuple[str, Callable[[], Figure]]] = {
    "7.3": ("bubbles in glycol, with table 7.1", bubbles.concentrations),
    "7.4": ("line and L-shaped arrays", images.transducer_orientation),
    "7.5": ("three shapes, microwaves and time reversal", microwaves.three_shapes),
    "7.6": ("conductivity, signal and image", microwaves.conductivity),
    "7.7": ("which conductivity takes most", microwaves.optimal_conductivity),
    "7.8": ("width of the pulse", microwaves.pulse_width),
    "8.1": ("stuffed MPSL25 and its filter", codes.stuffed_mpsl25),
    "8.2": ("Barker 13, bipolar and on/off", codes.barker13),
    "8.3": ("complementary Manchester pair", codes.manchester_pair),
    "8.4": ("50 positions, points and interpolated", images.interpolation),
    "8.7": ("one trace, single pulse", noise.single_trace),
    "8.8": ("one trace, MPSL25", noise.coded_trace),
    "8.9": ("one trace, Manchester pair", noise.pair_trace),
    "8.10": ("image of the core, with table 8.1", partial(noise.table_figure, "8.1")),
    "8.11": ("fewer averages, with table 8.2", partial(noise.table_figure, "8.2")),
    "8.12": ("half the power, with table 8.3", partial(noise.table_figure, "8.3")),
    "8.13": ("two wires in agar", wires.reference),
    "8.14": ("two wires: long, short and coded pulses", wires.pulse_widths),
    "11": ("a plate from one side, through air: no figure of the source's", plates.from_one_side),
}


@dataclass(frozen=True, slots=True)
class SavedFigure:
    name: str
    title: str
    numbers: Mapping[str, float]
    picture: Path


def chosen(names: Sequence[str]) -> list[str]:
    """Figures by number, "fig" before it or not; all where none is named. AnnulusError for one that there is not."""
    wanted = [name.lower().removeprefix("fig").lstrip(". ") for name in names]
    for name in wanted:
        if name not in FIGURES:
            raise AnnulusError(f"figure {name!r}: expected one of {', '.join(FIGURES)}")
    return [name for name in FIGURES if not wanted or name in wanted]


def study(names: Sequence[str], out: Path, progress: Progress | None = None) -> list[SavedFigure]:
    """Draws the figures named (all if none is) into `out`, and writes study.csv and study.json of their numbers."""
    wanted = chosen(names)
    out.mkdir(parents=True, exist_ok=True)
    done = []
    for n, name in enumerate(wanted):
        if progress:
            progress("figures", n, len(wanted))
        title, make = FIGURES[name]
        figure = make()
        picture = out / f"fig{name}.png"
        figure.save(picture)
        done.append(SavedFigure(name, title, dict(figure.numbers), picture))
        _write(done, out)  # what is done stays, whatever happens to the rest
    if progress:
        progress("figures", len(wanted), len(wanted))
    return done


def _write(done: Sequence[SavedFigure], out: Path) -> None:
    with (out / "study.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["figure", "title", "number", "value"])
        writer.writerows(_rows(done))
    table = {one.name: {"title": one.title, "picture": one.picture.name, **one.numbers} for one in done}
    (out / "study.json").write_text(json.dumps(table, indent=1) + "\n")


def _rows(done: Sequence[SavedFigure]) -> Iterator[tuple[str, str, str, str]]:
    for one in done:
        for name, value in one.numbers.items():
            yield one.name, one.title, name, f"{value:.6g}"
