"""Tables 8.1 to 8.3 in simulation: a code's gain when both arms are treated alike, and when they are not."""

from table import Row, keep

from annulus.tai.study import noise
from annulus.tai.study.codes import template

NOTE = """
Each table's noise is set so that the single pulse has the source's PSNR; M is the largest pixel of the noiseless single
image. The reference, 2048 averages of a single pulse, has noise of its own, so that part of a gain cannot show. The
column theory counts it: from 7.84 dB of the minimax filter and 10.41 dB (11 pulses) of the best filter there can be.
With both arms filtered alike, theory supports none of the source's three gains: 10.56 and 11.33 dB lie just above that
ceiling and are what noise alone gains if only the coded arm is filtered; 16.88 dB is more than even that gives here.
"As in the source" is our reading of §8.2: a template of chips as long as they were sent, and nothing on the other arm.
"""


def rows() -> list[Row]:
    ceiling = template().ceiling_db
    table = []
    for number, figure in (("8.1", "8.10"), ("8.2", "8.11"), ("8.3", "8.12")):
        keep(f"fig{figure}", noise.table_plate(number))
        found, squares, theirs = (
            noise.compare(number, how) for how in ("minimax", "least-squares", "as in the source")
        )
        what = f"table {number} ({found.setting.averages} averages, {found.setting.power_kw:g} kW)"
        source = f"{found.setting.single_db:.2f} -> {found.setting.coded_db:.2f}: +{found.source_gain_db:.2f} dB"
        table += [
            *(arms_alike(what, source, name, one) for name, one in (("minimax", found), ("least squares", squares))),
            Row(
                f"{what}: as in the source, template of held chips on the coded arm alone", source, "-", "-",
                f"{theirs.gain_db:+.2f} dB; noise alone {theirs.noise_gain_db:+.2f} dB, what the template changes in "
                f"the image caps it at {theirs.sidelobes_db:.1f} dB",
            ),
            Row(
                f"{what}: is the source's gain one that theory supports?", f"+{found.source_gain_db:.2f} dB",
                f"<= {ceiling:.2f} dB, here <= {found.most_db:.2f} dB", "-", verdict(found, theirs, ceiling),
            ),
        ]  # fmt: skip
    one = noise.compare("8.1")
    keep("fig8.7", noise.single_trace())
    trace = keep("fig8.8", noise.coded_trace())
    pair = keep("fig8.9", noise.pair_trace())
    shots = [noise.compare(number).shot_noise / one.shot_noise for number in noise.TABLES]
    table += [
        Row(
            "noise of one shot that the three single images imply, of table 8.1's", "1 setup", "1, 1, 1", "-",
            ", ".join(f"{ratio:.2f}" for ratio in shots),
        ),
        Row(
            "sidelobes of the filter cap the coded image's PSNR: minimax, least squares", "42.14 dB shown", "-", "-",
            f"{one.sidelobes_db:.1f}, {noise.compare('8.1', 'least-squares').sidelobes_db:.1f} dB",
        ),
        Row(
            "half the power against a full reference, nothing scaled, no noise", "25.13 dB shown", "-", "-",
            f"{noise.half_power_db():.1f} dB at most: the source must have scaled",
        ),
        Row(
            "one trace, 2 averages: gain of MPSL25, only decoded (Fig. 8.8)", "11 dB",
            f"{trace['gain_theory_db']:.2f} dB", "within 0.5 dB of theory", f"{trace['gain_db']:.2f} dB",
            abs(trace["gain_db"] - trace["gain_theory_db"]) < 0.5,
        ),
        Row(
            "the same, one band filter on both arms", "-", f"{trace['gain_theory_db']:.2f} dB",
            "within 0.5 dB of theory", f"{trace['gain_same_band_db']:.2f} dB",
            abs(trace["gain_same_band_db"] - trace["gain_theory_db"]) < 0.5,
        ),
        Row(
            "the same, template of held chips on the coded arm alone", "11 dB", "-", "-",
            f"{trace['gain_held_template_db']:.2f} dB: the rest is the band, not the code",
        ),
        Row(
            "Manchester pair: less noise, but what is left of the pulse's shape (Fig. 8.9)", "distorted",
            "14.1 dB in two shots", "-",
            f"{pair['noise_gain_db']:.1f} dB, correlation {pair['likeness_to_single_pulse']:.2f}",
        ),
    ]  # fmt: skip
    return table


def arms_alike(what: str, source: str, name: str, found: noise.Comparison) -> Row:
    expected = found.expected_with_sidelobes_db
    return Row(
        f"{what}: same band filter on both arms, {name}", source,
        f"{found.expected_db:+.2f} dB, with its sidelobes {expected:+.2f}; any filter {found.most_db:+.2f}",
        "within 0.5 dB of theory",
        f"{found.single_db:.2f} -> {found.coded_db:.2f}: {found.gain_db:+.2f} dB (noise alone "
        f"{found.noise_gain_db:+.2f} dB)",
        abs(found.gain_db - expected) <= 0.5,
    )  # fmt: skip


def verdict(found: noise.Comparison, theirs: noise.Comparison, ceiling: float) -> str:
    gain = found.source_gain_db
    if gain <= found.most_db:
        return "yes"
    if gain <= theirs.noise_gain_db + 1:
        return f"not with arms filtered alike; unlike filters explain it (noise alone {theirs.noise_gain_db:+.2f} dB)"
    return (
        f"no: {gain - ceiling:.2f} dB above the ceiling of all filters; unlike filters give noise alone "
        f"{theirs.noise_gain_db:+.2f} dB in this image"
    )


if __name__ == "__main__":
    for row in rows():
        print(row)
