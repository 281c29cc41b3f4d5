"""Codes beside the chirps and stepped frequencies of §7.4, on a microwave that can only be on or off, or dimmed."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from annulus_pipe.link.codes import pattern
from annulus_pipe.wings.tai.measure.templates import Transducer
from tools.bench.table import Row
from tools.bench.thermoacoustic import keep
from tools.study.figure import Figure

RATE_HZ = 100e6
CHIP_S = 0.5e-6  # §8.2
BAND = (2.25e6, 0.7)  # the source's transducer, Hz at the middle and width at -6 dB
LONG_S = 24.5e-6  # of the swept ones: as long as MPSL25 stuffed with zeros, less the last
SWEPT_HZ = (1.4e6, 3.1e6)  # the receiver's band
STEPS = 8  # frequencies of the stepped one
NEAR_S = 1e-6  # about the peak: what is farther off is a sidelobe
SEEDS = 4000  # of noise, for the check of the closed form: the ratio is known to 0.1 dB then
LOUDER = 30.0  # amplitude over noise of that check, so that its mean is known
SHORT_S = 0.22e-6  # half a period at the middle of the band

NOTE = """
The pressure of a small absorber goes with the rate at which power changes, I'(t), and I is never negative: a chirp is
power that swings between 0 and its maximum, or is on and off, and its mean makes no sound. What counts is how much of
the energy lies in the receiver's band: chips of 0.5 us leave most of theirs below it. By the matched filter in white
noise, behind the receiver. "Same energy" averages each until all have sent as much as one single pulse averaged: what
limits exposure and the magnetron. "Same shots" takes one for one: what limits time.
"""

Trains = Sequence[NDArray[np.float64]]


def held(chips: NDArray[np.uint8]) -> NDArray[np.float64]:
    return np.repeat(chips.astype(float), round(CHIP_S * RATE_HZ))


def waveforms() -> dict[str, Trains]:
    """Power over its maximum, of each shot, at RATE_HZ."""
    t = np.arange(round(LONG_S * RATE_HZ)) / RATE_HZ
    low, high = SWEPT_HZ
    swept = 2 * math.pi * (low * t + 0.5 * (high - low) / LONG_S * t**2)
    tones = low + (high - low) * np.minimum(np.floor(t / LONG_S * STEPS), STEPS - 1) / (STEPS - 1)
    stepped = 2 * math.pi * np.cumsum(tones) / RATE_HZ
    return {
        "single pulse": [held(pattern("1"))],
        "shorter pulse of 0.22 us": [np.ones(round(SHORT_S * RATE_HZ))],
        "MPSL25, stuffed": [held(pattern("mpsl25-stuffed"))],
        "chirp, dimmed": [0.5 * (1 - np.cos(swept))],
        "chirp, on and off": [(np.sin(swept) > 0).astype(float)],
        "stepped frequency, on and off": [(np.sin(stepped) > 0).astype(float)],
    }


def received(power: NDArray[np.float64], length: int) -> NDArray[np.complex128]:
    """Spectrum of I'(t) behind the receiver, whose gain is 1 at its best."""
    frequency = fft.rfftfreq(length, 1 / RATE_HZ)
    response = np.abs(fft.rfft(Transducer.band(*BAND, RATE_HZ).response, length))
    rate = 2j * math.pi * frequency * fft.rfft(power, length) / RATE_HZ
    return np.asarray(rate * response / response.max())


def compared() -> Figure:
    """Gains against the single pulse in dB, sidelobes, widths."""
    length = fft.next_fast_len(4 * round(LONG_S * RATE_HZ), real=True)
    outputs, numbers = {}, {}
    rng = np.random.default_rng(45)
    for name, shots in waveforms().items():
        spectra = [received(power, length) for power in shots]
        energy = sum(float(power.sum()) for power in shots)
        matched = sum(fft.irfft(np.abs(one) ** 2, length) for one in spectra)
        peak = float(matched[0])
        out = np.abs(signal.hilbert(np.roll(matched, length // 2))) / peak
        off_s = np.abs(np.arange(length) - length // 2) / RATE_HZ
        snr = sum(_measured_snr(one, length, rng) for one in spectra)
        outputs[name] = (off_s, out)
        numbers |= {
            f"snr, {name}": peak,
            f"energy, {name}": energy,
            f"simulated, {name}": snr / peak,
            f"sidelobe, {name}": 20 * math.log10(max(float(out[off_s > NEAR_S].max()), 1e-6)),
            f"width, {name}": 1e6 * float((out >= 0.5).sum()) / RATE_HZ,
        }

    def paint(figure: Any) -> None:
        axes = figure.subplots(1, len(outputs), sharey=True)
        for one, (name, (off_s, out)) in zip(axes, outputs.items(), strict=True):
            half = len(out) // 2
            one.plot(1e6 * off_s[half:], 20 * np.log10(np.maximum(out[half:], 1e-5)), lw=0.8)
            one.set(xlabel="from the peak, us", ylim=(-60, 2), xlim=(0, 1e6 * LONG_S))
            one.set_title(name, fontsize=9)
        axes[0].set(ylabel="matched filter's envelope, dB")

    return Figure(numbers, paint, (15, 3.2))


def _measured_snr(spectrum: NDArray[np.complex128], length: int, rng: np.random.Generator) -> float:
    """Of the filter's peak, squared over its variance, with white noise of variance 1, from SEEDS draws."""
    clean = fft.irfft(spectrum, length)
    louder = LOUDER / float(np.linalg.norm(clean))
    noisy = [float(clean @ (louder * clean + rng.standard_normal(length))) for _ in range(SEEDS)]
    return float(np.mean(noisy) ** 2 / np.var(noisy, ddof=1)) / louder**2


def rows() -> list[Row]:
    numbers = keep("waveforms", compared())
    names = list(waveforms())
    first = names[0]
    off = [10 * math.log10(numbers[f"simulated, {name}"]) for name in names]
    table = [
        Row(
            "matched filter in noise against the closed form, all waveforms",
            "-",
            "within 0.4 dB",
            f"{min(off):+.2f} to {max(off):+.2f} dB",
            max(map(abs, off)) <= 0.4,
            theory="0",
        )
    ]
    gains = {}
    for name in names[1:]:
        shots = 10 * math.log10(numbers[f"snr, {name}"] / numbers[f"snr, {first}"])
        gains[name] = shots - 10 * math.log10(numbers[f"energy, {name}"] / numbers[f"energy, {first}"])
        table.append(
            Row(
                f"{name}: same energy, same shots; highest sidelobe, width at half",
                "better (no number, §7.4)" if "MPSL" not in name else "11 dB (same shots, §8.3)",
                "-",
                f"{gains[name]:+.1f}, {shots:+.1f} dB; {numbers[f'sidelobe, {name}']:.0f} dB, "
                f"{numbers[f'width, {name}']:.2f} us",
            )
        )
    dimmed, gated = gains["chirp, dimmed"], gains["chirp, on and off"]
    table.append(
        Row(
            "at the same energy: chirp on and off against dimmed",
            "-",
            "within 0.3 dB of theory",
            f"{gated - dimmed:+.2f} dB",
            abs(gated - dimmed - 20 * math.log10(4 / math.pi)) <= 0.3,
            theory="+2.10 dB, the fundamental of a square, (4/pi)^2",
        )
    )
    return table
