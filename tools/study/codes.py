"""Figures 8.1 to 8.3: codes, their filters, and what comes out."""

from functools import cache
from typing import Any

import numpy as np

from annulus_pipe.link.codes import pattern
from annulus_pipe.wings.tai.measure.templates import Method, Template, Transducer, design, pair_correlation
from tools.study.figure import Figure

CHIP_S = 0.5e-6
TAPS = 150  # chips: three times the code


@cache
def template(method: Method = "minimax") -> Template:
    """The filter for stuffed MPSL25 that the study decodes with."""
    return design(pattern("mpsl25-stuffed"), TAPS, method)


@cache
def transducer_template() -> Template:
    """The same behind a transducer of 2.25 MHz and 70 %: five taps a chip, two chips of guard, a floor of 7.6 dB."""
    return design(
        pattern("mpsl25-stuffed"),
        TAPS,
        transducer=Transducer.band(2.25e6, 0.7, 50e6),
        samples_per_chip=5,
        chip_s=CHIP_S,
        guard_chips=2.0,
        gain_floor_db=7.6,
    )


def stuffed_mpsl25() -> Figure:
    """Fig. 8.1: the code, its mismatched filter, and the filter's answer to the code."""
    chips, found = pattern("mpsl25-stuffed"), template()
    squares = template("least-squares")
    numbers = {
        "psr": found.psr,
        "gain_db": found.gain_db,
        "ceiling_db": found.ceiling_db,
        "psr_least_squares": squares.psr,
        "gain_least_squares_db": squares.gain_db,
        "psr_matched": design(chips, TAPS, "matched").psr,
    }

    def draw(figure: Any) -> None:
        left, middle, right = figure.subplots(1, 3)
        left.stairs(chips, np.arange(len(chips) + 1) * CHIP_S * 1e6, fill=True, color="tab:red")
        left.set(xlabel="time, us", ylabel="source on", yticks=[0, 1], title="a) stuffed MPSL25")
        middle.vlines(np.arange(TAPS) * CHIP_S * 1e6, 0, found.taps / np.abs(found.taps).max(), lw=1)
        middle.axhline(0, color="0.6", lw=0.5)
        middle.set(xlabel="time, us", ylabel="tap, of the largest", title="b) mismatched filter, 150 taps")
        at = (np.arange(len(found.output)) - found.peak) * CHIP_S * 1e6
        right.plot(at, found.output, lw=0.9)
        right.set(
            xlabel="time from the peak, us",
            ylabel="filtered, of the peak",
            title=f"c) filtered: highest sidelobe 1/{found.psr:.1f}",
        )

    return Figure(numbers, draw, (12, 3.6))


def barker13() -> Figure:
    """Fig. 8.2: what a bipolar code loses when it can only be switched on and off."""
    on_off = pattern("barker13").astype(float)
    bipolar = 2 * on_off - 1
    lines = {"bipolar": np.correlate(bipolar, bipolar, "full"), "on/off": np.correlate(on_off, on_off, "full")}
    numbers = {f"psr_{name.replace('/', '_')}": peak_over_rest(line) for name, line in lines.items()}

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, 4)
        for n, (name, code) in enumerate((("bipolar", bipolar), ("on/off", on_off))):
            shape, answer, line = axes[2 * n], axes[2 * n + 1], lines[name]
            shape.stairs(code, np.arange(14) * CHIP_S * 1e6, baseline=0, fill=True, color="tab:red")
            shape.set(xlabel="time, us", ylabel="amplitude", title=f"{'ac'[n]}) Barker 13, {name}")
            at = (np.arange(len(line)) - len(line) // 2) * CHIP_S * 1e6
            answer.plot(at, line / line.max(), lw=0.9)
            answer.set(
                xlabel="time from the peak, us",
                ylabel="of the peak",
                title=f"{'bd'[n]}) matched filter: 1/{peak_over_rest(line):.1f}",
            )

    return Figure(numbers, draw, (14, 3.4))


def manchester_pair() -> Figure:
    """Fig. 8.3: two complementary codes whose correlations, added, leave nothing but the neighbours of the peak."""
    codes = [pattern("manchester1"), pattern("manchester2")]
    total = pair_correlation(codes)
    middle = len(total) // 2
    beyond = np.delete(total, [middle - 1, middle, middle + 1])
    numbers = {
        "peak": float(total[middle]),
        "before": float(total[middle - 1]),
        "after": float(total[middle + 1]),
        "elsewhere": float(np.abs(beyond).max()),
    }

    def draw(figure: Any) -> None:
        first, second, right = figure.subplots(1, 3)
        for axes, code, title in ((first, codes[0], "a) first code"), (second, codes[1], "b) second code")):
            axes.stairs(code, np.arange(len(code) + 1) * CHIP_S * 1e6, fill=True, color="tab:red")
            axes.set(xlabel="time, us", ylabel="source on", yticks=[0, 1], title=title)
        right.plot((np.arange(len(total)) - middle) * CHIP_S * 1e6, total, lw=0.9)
        right.set(xlabel="time from the peak, us", ylabel="sum of both correlations", title="c) peak 52, two lobes")

    return Figure(numbers, draw, (12, 3.6))


def peak_over_rest(line: np.ndarray[Any, Any]) -> float:
    """Peak of a correlation over the highest absolute value elsewhere."""
    top = int(np.argmax(np.abs(line)))
    return float(abs(line[top]) / np.abs(np.delete(line, top)).max())
