"""Resonances of circuits drawn as circuits (R, L, C at a line), by `annulus joint sweep`'s fit of their magnitudes."""

import numpy as np
from matplotlib.figure import Figure

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.report.names import BUMP_BLUE, LOSS_RED
from annulus_pipe.report.paper import WIDTH_IN, in_style, png
from annulus_pipe.wings.joints.measure.sweeps import MOVED, Resonance, moved, resonance
from tools.bench.joints import TABLE
from tools.bench.table import Row

NOTE = """
400 sweeps a probe, 201 frequencies, magnitudes alone, noise 1 % of full reflection: a series circuit at a line of 50
ohm, its impedance computed, so that the truth is no fit's own shape. Moved: by the stated part of the resonance against
an equal sweep; a shift counts beyond three sigma of both. Parts are ours: the source prints two frequencies and no
shift. The smaller shift is what a capacitive sensor at 4.5 MHz would have to tell.
"""
SWEEPS, NOISE, COUNT = 400, 0.01, 201
# f0 Hz, loaded Q, shift as a part of f0: a split ring against a change of density, a capacitor against one of moisture.
PROBES = {"split ring, 2.4 GHz": (2.4e9, 40.0, 2e-3), "capacitive, 4.5 MHz": (4.5e6, 25.0, 1e-5)}
COVERED = 0.90  # of k = 2, at least: 95 % are stated


def reflected(f: FloatArray, f0: float, quality: float) -> FloatArray:
    """|S11| of a series circuit of 83 ohm, coupled to a line of 50."""
    resistance = 83.0
    inductance = quality * (resistance + 50.0) / (2 * np.pi * f0)
    impedance = resistance + 2j * np.pi * inductance * (f - f0**2 / f)
    return np.asarray(np.abs((impedance - 50) / (impedance + 50)))


def rows() -> list[Row]:
    table, drawn = [], {}
    for number, (name, (f0, quality, part)) in enumerate(PROBES.items()):
        rng = np.random.default_rng([9310, number])
        f = np.linspace(f0 * (1 - 2.5 / quality), f0 * (1 + 2.5 / quality), COUNT)

        def swept(true: float) -> FloatArray:
            return reflected(f, true, quality) + rng.normal(0, NOISE, COUNT)  # noqa: B023  # called in this round

        pairs = [(resonance(f, swept(f0)), resonance(f, swept(f0 * (1 - part)))) for _ in range(SWEEPS)]
        nothing = sum(np.isnan(resonance(f, 0.5 + rng.normal(0, NOISE, COUNT)).f0_hz) for _ in range(SWEEPS))
        off = np.array([one.f0_hz - f0 for one, _ in pairs])
        covered = float(np.mean(np.abs(off) < 2 * np.array([one.f0_sigma_hz for one, _ in pairs])))
        shifted = sum(moved(*pair) is True for pair in pairs)
        false = sum(moved(a, b) is True for (a, _), (b, _) in zip(pairs[::2], pairs[1::2], strict=True))
        drawn[name] = f, f0, pairs[0], quality, part
        table += [
            Row(
                f"{name}: resonance off the truth, rms; k = 2 holds",
                f"{f0 / 1e9:g} GHz" if f0 > 1e8 else f"{f0 / 1e6:g} MHz",
                f"-; >= {100 * COVERED:g} %",
                f"{1e6 * float(np.std(off)) / f0:.0f} ppm; {100 * covered:.0f} %",
                covered >= COVERED,
            ),
            Row(
                f"{name}: of sweeps without any, one told",
                "-",
                "<= 1 %",
                f"{100 * (SWEEPS - nothing) / SWEEPS:.1f} %",
                SWEEPS - nothing <= 0.01 * SWEEPS,
            ),
            Row(
                f"{name}: shifts of {1e6 * part:g} ppm told; where there is none",
                "not told apart" if f0 < 1e8 else "told apart",
                "-; <= 2 %",
                f"{100 * shifted / SWEEPS:.0f} %; {100 * false / (SWEEPS // 2):.1f} %",
                false <= 0.02 * (SWEEPS // 2),
            ),
        ]
    (TABLE.pictures / "sweeps.png").write_bytes(_drawn(drawn))
    return table


def _drawn(drawn: dict[str, tuple[FloatArray, float, tuple[Resonance, Resonance], float, float]]) -> bytes:
    """As the source's Figs 9.30 and 9.33: sweeps at two points, and where their resonances were found."""
    with in_style():
        figure = Figure(figsize=(WIDTH_IN, 0.4 * WIDTH_IN), layout="constrained")
        for axes, (name, (f, f0, pair, quality, part)) in zip(figure.subplots(1, 2), drawn.items(), strict=True):
            unit, word = (1e9, "GHz") if f0 > 1e8 else (1e6, "MHz")
            for one, true, colour in zip(pair, (f0, f0 * (1 - part)), (BUMP_BLUE, LOSS_RED), strict=True):
                axes.plot(f / unit, 20 * np.log10(reflected(f, true, quality)), color=colour, lw=0.9)
                axes.axvline(one.f0_hz / unit, color=colour, lw=0.8, ls=":")
            axes.set(xlabel=f"frequency, {word}", ylabel="S11, dB", title=f"{name}: {1e6 * part:g} ppm apart")
        figure.suptitle(f"a shift is told beyond {MOVED:g} sigma of both", fontsize=9)
        return png(figure)
