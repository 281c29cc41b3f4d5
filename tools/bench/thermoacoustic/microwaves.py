"""Where the microwave's power stays: closed forms, the solver, and the solver against itself."""

import math
from itertools import pairwise

from tools.bench.table import Row
from tools.bench.thermoacoustic import keep
from tools.study import bubbles, microwaves


def rows() -> list[Row]:
    best = keep("fig7.7", microwaves.optimal_conductivity())
    shapes = keep("fig7.5", microwaves.three_shapes())
    swing = keep("fig7.6", microwaves.conductivity())
    pulse = keep("fig7.8", microwaves.pulse_width())
    bubbly = keep("fig7.3", bubbles.concentrations())
    percents = [row[0] for row in bubbles.TABLE_7_1]
    swings, same, apart, across = (
        [bubbly[f"{name}_{p}{unit}"] for p in percents]
        for name, unit in (("swing", ""), ("swing_same_gruneisen", ""), ("apart", "_us"), ("across", "_us"))
    )
    off = max(abs(1 - one / width) for one, width in zip(apart, across, strict=True))
    table = []
    for eps in ("1", "3"):
        for name, words in (("half_space", "half-space"), ("slab", "slab of 30 mm")):
            off = best[f"{name}_{eps}_off"]
            table.append(
                Row(
                    f"largest loss in 10 mm, {words}, eps_r {eps}: solver against closed form",
                    "deviates for eps_r 3" if eps == "3" else "agrees, near 1 S/m",
                    "within 1 %",
                    f"{100 * off:+.2f} %, at {best[f'{name}_{eps}_solved_at_s_m']:.3f} S/m",
                    abs(off) <= 0.01,
                    theory=f"at {best[f'{name}_{eps}_at_s_m']:.3f} S/m",
                )
            )
    found = microwaves.convergence()
    coarse, middle, fine = (found[step][0] for step in (2.0, 1.0, 0.5))
    change = middle / fine - 1
    table += [
        Row(
            "WR340 into oil, disc of 20 mm: power absorbed of 1 kW, 1 mm against 0.5 mm",
            "-",
            "within 2 %",
            f"{middle:.1f} and {fine:.1f} W, {100 * change:+.2f} % (2 mm: {coarse:.1f} W)",
            abs(change) <= 0.02,
        ),
        Row("magnitude of its S11, 1 mm and 0.5 mm", "-", "-", f"{found[1.0][1]:.3f} and {found[0.5][1]:.3f}"),
        Row(
            "the same guide into air: S11",
            "-12 dB (3-D)",
            "-",
            f"{20 * math.log10(microwaves.reflection_into_air()):.1f} dB (2-D)",
        ),
        Row(
            "120 x 30 mm before WR340: conductivity of the largest loss, eps_r 1 and 3",
            "deviates from plane wave",
            "-",
            f"{best['guide_1_at_s_m']:.2f} and {best['guide_3_at_s_m']:.2f} S/m",
        ),
        Row(
            "three shapes heard from a line: centres off (Fig. 7.5)",
            "found",
            "<= 0.3 mm",
            ", ".join(f"{shapes[f'{name}_off_mm']:.2f}" for name in ("disc", "square", "rectangle")) + " mm",
            all(shapes[f"{name}_off_mm"] <= 0.3 for name in ("disc", "square", "rectangle")),
            theory="0",
        ),
        Row(
            "signal of a 12 mm disc at 2.32 S/m over that at 0.84 S/m (Fig. 7.6a)",
            "rises",
            "rises",
            f"{swing['swing_2.32_s_m']:.2f}",
            swing["swing_2.32_s_m"] > 1,
        ),
        Row(
            "swing of glycol with 0 to 40 % bubbles, same Grueneisen parameter (Fig. 7.3)",
            "falls",
            "falls",
            ", ".join(f"{one:.2f}" for one in same),
            all(a > b for a, b in pairwise(same)),
        ),
        Row("the same, with the same beta / C_p", "falls", "-", ", ".join(f"{one:.2f}" for one in swings)),
        Row(
            "peak to trough of the same, against the disc's width over its speed of sound",
            "shorter with bubbles",
            "shorter, within 10 %",
            ", ".join(f"{one:.2f}" for one in apart) + f" us, {100 * off:.0f} %",
            all(a > b for a, b in pairwise(apart)) and off <= 0.1,
        ),
        Row(
            "mean wavelength, pulse 0.3 and 0.9 us (Fig. 7.8a)",
            "rises",
            "rises",
            f"{pulse['wavelength_0.3_us_mm']:.1f}, {pulse['wavelength_0.9_us_mm']:.1f} mm",
            pulse["wavelength_0.9_us_mm"] > pulse["wavelength_0.3_us_mm"],
        ),
        Row(
            "image's likeness to the loss, pulse of 40 ns and 4 us (Fig. 7.8b)",
            "blurred",
            "-",
            f"{pulse['correlation_40_ns']:.2f}, {pulse['correlation_4_us']:.2f}",
        ),
    ]
    return table
