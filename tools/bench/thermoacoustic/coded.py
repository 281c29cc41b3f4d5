"""Tables 8.1 to 8.3 in simulation: a code's gain when both conditions are treated alike, and when they are not."""

from tools.bench.table import Row
from tools.bench.thermoacoustic import keep
from tools.study import noise
from tools.study.codes import template

NOTE = """
Each table's noise is set so that the single pulse has the source's PSNR; M is the largest pixel of the noiseless single
image. The reference, 2048 averages of a single pulse, has noise of its own, so that part of a gain cannot show. The
column theory counts it: from 7.84 dB of the minimax filter and 10.41 dB (11 pulses) of the best filter there can be.
With both conditions filtered alike, theory supports none of the source's three gains: 10.56 and 11.33 dB lie just above
that ceiling and are what noise alone gains if only the coded condition is filtered; 16.88 dB is more than even that
gives here. "As in the source" is our reading of §8.2: a template of chips as long as they were sent, on that condition
alone.
"""


def rows() -> list[Row]:
    ceiling = template().ceiling_db
    table = []
    for number, figure in (("8.1", "8.10"), ("8.2", "8.11"), ("8.3", "8.12")):
        keep(f"fig{figure}", noise.table_figure(number))
        found, squares, theirs = (
            noise.compare(number, how) for how in ("minimax", "least-squares", "as in the source")
        )
        what = f"table {number} ({found.setting.averages} averages, {found.setting.power_kw:g} kW)"
        source = f"{found.setting.single_db:.2f} -> {found.setting.coded_db:.2f}: +{found.source_gain_db:.2f} dB"
        table += [
            *(
                conditions_alike(what, source, name, one)
                for name, one in (("minimax", found), ("least squares", squares))
            ),
            Row(
                f"{what}: as in the source, template of held chips on the coded condition alone",
                source,
                "-",
                f"{theirs.gain_db:+.2f} dB; noise alone {theirs.noise_gain_db:+.2f} dB, what the template changes in "
                f"the image caps it at {theirs.sidelobes_db:.1f} dB",
            ),
            Row(
                f"{what}: is the source's gain one that theory supports?",
                f"+{found.source_gain_db:.2f} dB",
                "-",
                verdict(found, theirs, ceiling),
                theory=f"<= {ceiling:.2f} dB, here <= {found.most_db:.2f} dB",
            ),
        ]
    one = noise.compare("8.1")
    keep("fig8.7", noise.single_trace())
    trace = keep("fig8.8", noise.coded_trace())
    pair = keep("fig8.9", noise.pair_trace())
    shots = [noise.compare(number).shot_noise / one.shot_noise for number in noise.TABLES]
    table += [
        Row(
            "noise of one shot that the three single images imply, of table 8.1's",
            "1 setup",
            "-",
            ", ".join(f"{ratio:.2f}" for ratio in shots),
            theory="1, 1, 1",
        ),
        Row(
            "sidelobes of the filter cap the coded image's PSNR: minimax, least squares",
            "42.14 dB shown",
            "-",
            f"{one.sidelobes_db:.1f}, {noise.compare('8.1', 'least-squares').sidelobes_db:.1f} dB",
        ),
        Row(
            "half the power against a full reference, nothing scaled, no noise",
            "25.13 dB shown",
            "-",
            f"{noise.half_power_db():.1f} dB at most: the source must have scaled",
        ),
        Row(
            "one trace, 2 averages: gain of MPSL25, only decoded (Fig. 8.8)",
            "11 dB",
            "within 0.5 dB of theory",
            f"{trace['gain_db']:.2f} dB",
            abs(trace["gain_db"] - trace["gain_theory_db"]) < 0.5,
            theory=f"{trace['gain_theory_db']:.2f} dB",
        ),
        Row(
            "the same, one band filter on both conditions",
            "-",
            "within 0.5 dB of theory",
            f"{trace['gain_same_band_db']:.2f} dB",
            abs(trace["gain_same_band_db"] - trace["gain_theory_db"]) < 0.5,
            theory=f"{trace['gain_theory_db']:.2f} dB",
        ),
        Row(
            "the same, template of held chips on the coded condition alone",
            "11 dB",
            "-",
            f"{trace['gain_held_template_db']:.2f} dB: the rest is the band, not the code",
        ),
        Row(
            "Manchester pair: less noise, but what is left of the pulse's shape (Fig. 8.9)",
            "distorted",
            "-",
            f"{pair['noise_gain_db']:.1f} dB, correlation {pair['likeness_to_single_pulse']:.2f}",
            theory="14.1 dB in two shots",
        ),
    ]
    return table


def conditions_alike(what: str, source: str, name: str, found: noise.Comparison) -> Row:
    expected = found.expected_with_sidelobes_db
    return Row(
        f"{what}: same band filter on both conditions, {name}",
        source,
        "within 0.5 dB of theory",
        f"{found.single_db:.2f} -> {found.coded_db:.2f}: {found.gain_db:+.2f} dB (noise alone "
        f"{found.noise_gain_db:+.2f} dB)",
        abs(found.gain_db - expected) <= 0.5,
        theory=f"{found.expected_db:+.2f} dB, with its sidelobes {expected:+.2f}; any filter {found.most_db:+.2f}",
    )


def verdict(found: noise.Comparison, theirs: noise.Comparison, ceiling: float) -> str:
    gain = found.source_gain_db
    if gain <= found.most_db:
        return "yes"
    if gain <= theirs.noise_gain_db + 1:
        return (
            f"not with conditions filtered alike; unlike filters explain it (noise alone "
            f"{theirs.noise_gain_db:+.2f} dB)"
        )
    return (
        f"no: {gain - ceiling:.2f} dB above the ceiling of all filters; unlike filters give noise alone "
        f"{theirs.noise_gain_db:+.2f} dB in this image"
    )
