"""Figures 8.13 and 8.14: two thin wires in agar, what separates them, and what noise does to that."""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from annulus_pipe.wings.tai.measure.phantoms import Disc, phantom
from tools.study.figure import Figure, FloatArray, profile, show_map
from tools.study.images import resolution
from tools.study.noise import CODED, FULL_KW, SINGLE, Condition, condition, show_sample

POWER_KW = 2.0
RAYLEIGH = 0.265  # dip between two peaks that counts as two
NEAR_MM, CLEAR_MM = 0.8, 2.2  # a wire's peak is looked for so near to it; so far off begins what lies between
EXCITATIONS = {"2 us": "1111", "1 us": "11", "0.5 us": SINGLE, "0.5 us MPSL25": CODED}
TRIES = np.geomspace(1e-4, 0.3, 61)


def places_mm() -> tuple[float, float]:
    """Where the wires stand on the x axis."""
    left, right = (part.x_mm for part in phantom("wires")[1:] if isinstance(part, Disc))
    return left, right


def dip(x_mm: FloatArray, line: FloatArray) -> float:
    """How deep the line falls between both wires, of the lesser one's peak; below 0 there is more between them."""
    left, right = places_mm()
    lesser = min(float(line[np.abs(x_mm - at) < NEAR_MM].max()) for at in (left, right))
    between = float(line[(x_mm > left + CLEAR_MM) & (x_mm < right - CLEAR_MM)].max())
    return 1 - between / lesser if lesser > 0 else -math.inf


def envelope(line: FloatArray) -> FloatArray:
    """Of an image's line whose band excludes zero: the size of its ripple."""
    from scipy.signal import hilbert

    return np.asarray(np.abs(hilbert(np.nan_to_num(line))))


def noise_lines(one: Condition) -> list[FloatArray]:
    """Lines of noise through the middle of an image: it is as noisy from all sides, so each one gives many."""
    rows = []
    for image in one.noise:
        for turned in (image, image.T):
            middle = len(turned) // 2
            rows += [np.asarray(turned[middle + 4 * n], float) for n in range(-5, 6)]
    return rows


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """How often both wires are separated, at each of TRIES: rms of the averaged noise, of one full pulse."""

    clean_dip: float
    rate: FloatArray
    half: float  # the noise at which it is one time in two

    @classmethod
    def of(cls, one: Condition, power: float) -> "Separation":
        x = one.clean.x_mm
        line = power * profile(one.clean.values, one.clean.y_mm, 0.0, 0).astype(float)
        rows = noise_lines(one)
        rate = np.array([np.mean([dip(x, envelope(line + rms * row)) >= RAYLEIGH for row in rows]) for rms in TRIES])
        below = np.flatnonzero(rate < 0.5)
        half = float(TRIES[below[0]]) if len(below) else math.inf
        if len(below) and below[0]:
            i = int(below[0])
            part = (rate[i - 1] - 0.5) / (rate[i - 1] - rate[i])
            half = float(TRIES[i - 1] * (TRIES[i] / TRIES[i - 1]) ** part)
        return cls(dip(x, envelope(line)), rate, half)


@cache
def separation(name: str, power_kw: float = POWER_KW) -> Separation:
    return Separation.of(condition("wires", EXCITATIONS[name]), power_kw / FULL_KW)


@cache
def noise_between() -> float:
    """Halfway (in dB) between what the single pulse of 0.5 us bears and what the code bears, both at 2 kW."""
    return math.sqrt(separation("0.5 us").half * separation("0.5 us MPSL25").half)


def rate_at(one: Separation, rms: float) -> float:
    return float(np.interp(math.log(rms), np.log(TRIES), one.rate))


def reference() -> Figure:
    """Fig. 8.13: the sample, and its image at 3 kW with one pulse of 0.5 us."""
    single = condition("wires", SINGLE)
    rms = separation("0.5 us").half / 3
    values = single.at(rms)
    numbers = {"dip": dip(single.clean.x_mm, envelope(profile(values, single.clean.y_mm, 0.0, 0))), "noise": rms}

    def draw(figure: Any) -> None:
        left, right = figure.subplots(1, 2)
        show_sample(left, "wires", "a) agar with two wires of 0.6 mm")
        most = float(np.nanmax(np.abs(single.clean.values)))
        shown = show_map(
            right,
            values / most,
            single.clean.x_mm,
            single.clean.y_mm,
            "b) one pulse of 0.5 us, 3 kW, little noise",
            (-1, 1),
            "RdBu_r",
        )
        figure.colorbar(shown, ax=right, shrink=0.8, label="pressure, of the largest")

    return Figure(numbers, draw, (9.5, 4.2))


def pulse_widths() -> Figure:
    """Fig. 8.14: the same at 2 kW with longer pulses, a short one and a coded one, all in one noise."""
    rms = noise_between()
    found = {name: separation(name) for name in EXCITATIONS}
    sizes = resolution()
    numbers: dict[str, float] = {"noise": rms}
    for name, one in found.items():
        key = name.lower().replace(" ", "_")
        numbers[f"separated_{key}"] = rate_at(one, rms)
        numbers[f"dip_without_noise_{key}"] = one.clean_dip
        numbers[f"bears_noise_{key}"] = one.half
    numbers["code_bears_more_db"] = 20 * math.log10(found["0.5 us MPSL25"].half / found["0.5 us"].half)
    for pulse, width, theory in zip(sizes.pulses_us, sizes.widths_mm, sizes.theory_mm, strict=True):
        numbers[f"width_{pulse:g}_us_mm"], numbers[f"theory_{pulse:g}_us_mm"] = width, theory

    def draw(figure: Any) -> None:
        top, bottom = figure.subplots(2, 4)
        power = POWER_KW / FULL_KW
        for n, (axes, (name, code)) in enumerate(zip(top, EXCITATIONS.items(), strict=True)):
            one = condition("wires", code)
            values = power * one.clean.values + rms * one.noise[0]
            most = float(np.nanpercentile(np.abs(power * one.clean.values), 99.9))
            show_map(
                axes, values, one.clean.x_mm, one.clean.y_mm, f"{'abcd'[n]}) {name}, 2 kW", (-most, most), "RdBu_r"
            )
            for below, image in ((bottom[0], values), (bottom[3], one.clean.values)):
                line = envelope(profile(image, one.clean.y_mm, 0.0, 0))
                near = np.abs(one.clean.x_mm) < 10
                below.plot(one.clean.x_mm, line / line[near].max() + 1.3 * (3 - n), lw=0.8)
                below.annotate(name, (-9.8, 1.3 * (3 - n) + 1.0), fontsize=7)
        for below, title in ((bottom[0], "e) line through both wires"), (bottom[3], "h) the same without noise")):
            below.set(xlabel="x, mm", ylabel="envelope, of its maximum", yticks=[], xlim=(-10, 10))
            below.set_title(title, fontsize=9)
        for name, rates in found.items():
            bottom[1].semilogx(TRIES, 100 * rates.rate, lw=1, label=name)
        bottom[1].axvline(rms, color="0.5", lw=0.8, ls=":")
        bottom[1].set(xlabel="noise after averaging, of one pulse's rise", ylabel="separated, %", xlim=(3e-4, 0.1))
        bottom[1].set_title("f) how often both wires are told apart", fontsize=9)
        bottom[1].legend(fontsize=7)
        bottom[2].plot(sizes.pulses_us, sizes.widths_mm, "o", label="measured, all frequencies heard")
        bottom[2].plot(sizes.pulses_us, sizes.theory_mm, "-", label="theory")
        bottom[2].plot(sizes.pulses_us, 1.5 * np.array(sizes.pulses_us), ":", color="0.5", label="c T")
        bottom[2].set(xlabel="pulse, us", ylabel="width of a wire's image, mm", xlim=(0, None), ylim=(0, None))
        bottom[2].set_title("g) resolution", fontsize=9)
        bottom[2].legend(fontsize=7)

    return Figure(numbers, draw, (15, 7.4))
