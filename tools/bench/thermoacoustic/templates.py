"""Sidelobes and noise of the filters, against the source's and against the best there can be."""

from tools.bench.table import Row
from tools.bench.thermoacoustic import keep
from tools.study import codes


def rows() -> list[Row]:
    stuffed = keep("fig8.1", codes.stuffed_mpsl25())
    barker = keep("fig8.2", codes.barker13())
    pair = keep("fig8.3", codes.manchester_pair())
    heard = codes.transducer_template()
    gain = stuffed["gain_db"]
    return [
        Row(
            "stuffed MPSL25, 150 taps: peak over the highest sidelobe",
            "56.4",
            ">= 59.0",
            f"{stuffed['psr']:.2f}",
            stuffed["psr"] >= 59.0,
            theory="59.1 (the optimum of the problem)",
        ),
        Row(
            "its gain over one pulse in white noise",
            "11 dB (measured, filters differ)",
            ">= 7.8 dB",
            f"{gain:.2f} dB",
            gain >= 7.8,
            theory=f"{stuffed['ceiling_db']:.2f} dB is the ceiling of any filter",
        ),
        Row(
            "least squares instead of minimax",
            "-",
            "-",
            f"{stuffed['psr_least_squares']:.1f}, {stuffed['gain_least_squares_db']:.2f} dB",
        ),
        Row("matched filter instead", "-", "-", f"{stuffed['psr_matched']:.2f}, {stuffed['ceiling_db']:.2f} dB"),
        Row(
            "behind 2.25 MHz, 70 %, guard +-2 chips, 5 samples a chip",
            "-",
            ">= 75 at >= 7.6 dB",
            f"{heard.psr:.1f} at {heard.gain_db:.2f} dB",
            heard.psr >= 75 and heard.gain_db >= 7.6 - 1e-6,
        ),
        Row(
            "Barker 13, matched filter, bipolar and on/off",
            "13, 1.8",
            "13, 1.8",
            f"{barker['psr_bipolar']:.1f}, {barker['psr_on_off']:.2f}",
            abs(barker["psr_bipolar"] - 13) < 1e-9 and abs(barker["psr_on_off"] - 1.8) < 1e-9,
            theory="13, 9/5",
        ),
        Row(
            "Manchester pair: peak, neighbours, elsewhere",
            "52",
            "52, <= 1 elsewhere",
            f"{pair['peak']:.0f}, {pair['before']:.0f} and {pair['after']:.0f}, {pair['elsewhere']:.0f}",
            pair["peak"] == 52 and pair["elsewhere"] <= 1,
            theory="52, -25, -26, 1",
        ),
    ]
