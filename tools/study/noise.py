"""Figures 8.7 to 8.14 and tables 8.1 to 8.3: what a code is worth in noise, both conditions treated alike.

One forward run a sample. A burst is so many single pulses, so its traces are the single pulse's, shifted and added;
an image is linear in its traces, so clean traces and noise are imaged once and put together for every noise, number of
averages and power.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from annulus_pipe.link.codes import pattern, text
from annulus_pipe.numeric.arrays import Chips
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord
from annulus_pipe.wings.tai.decode import decode_record, sweep_of
from annulus_pipe.wings.tai.measure.imaging import AcousticImage, time_reversal
from annulus_pipe.wings.tai.measure.phantoms import phantom
from annulus_pipe.wings.tai.measure.templates import decode_pair
from annulus_pipe.wings.tai.simulate import Setup, coupling, simulate, through
from tools.study.codes import CHIP_S, template
from tools.study.figure import Figure, FloatArray, profile, show_map, show_trace

SETUP = Setup(chip_s=CHIP_S, radius_mm=17.0, positions=50, sampling_rate_hz=20e6, transducer=(2.25e6, 0.7))
PIXEL_MM = 0.23
WITHIN = 0.95  # of the circle's radius: what the comparison looks at
SEEDS = 4
REFERENCE_AVERAGES = 2048
FULL_KW = 3.0
SPIKE_PA = 1.0  # coupling of one chip, in pressures of one pulse
SINGLE, CODED = "single", "mpsl25-stuffed"

How = Literal["minimax", "least-squares", "as in the source"]  # the first two: one band filter behind both conditions


@dataclass(frozen=True, slots=True)
class Setting:
    """One table of the source, and what it found (§8.5.2)."""

    averages: int
    power_kw: float
    single_db: float
    coded_db: float

    @property
    def noise(self) -> float:
        """Rms of the averaged noise in signals of full power, of one shot's noise."""
        return FULL_KW / self.power_kw / math.sqrt(self.averages)


TABLES: Mapping[str, Setting] = {
    "8.1": Setting(256, 3.0, 31.58, 42.1350),
    "8.2": Setting(2, 3.0, 12.5797, 29.4600),
    "8.3": Setting(256, 1.5, 13.7996, 25.1262),
}


# Traces


@cache
def shot(sample: str, setup: Setup = SETUP) -> AcousticRecord:
    """A sample under one pulse of one chip, without noise."""
    return simulate(phantom(sample), setup)


def sent(single: AcousticRecord, chips: Chips) -> AcousticRecord:
    """The same sample under a burst: so many single pulses, one chip apart."""
    assert single.chip_s is not None
    step = single.chip_s * single.sampling_rate_hz
    if abs(step - round(step)) > 1e-6:
        raise AnnulusError(f"chips of {step:g} samples cannot be added up, expected a whole number")
    each = round(step)
    samples = single.signals.shape[1]
    total = np.zeros((len(single.signals), samples + each * (len(chips) - 1)), np.float32)
    for n in np.flatnonzero(chips):
        total[:, n * each : n * each + samples] += single.signals
    return replace(single, signals=total, code=text(chips))


def white(record: AcousticRecord, seed: int) -> AcousticRecord:
    """Noise of rms 1 in place of the sound."""
    noise = np.random.default_rng(seed).standard_normal(record.signals.shape)
    return replace(record, signals=noise.astype(np.float32))


def band_filtered(record: AcousticRecord, setup: Setup) -> AcousticRecord:
    """Through the receiver's own band once more, without delay: the filter of both conditions."""
    return replace(record, signals=through(record.signals.astype(float), setup).astype(np.float32))


def held(record: AcousticRecord) -> AcousticRecord:
    """Averaged over a chip: what correlating with a template of chips as long as they were sent does besides."""
    assert record.chip_s is not None
    frequency = scipy.fft.rfftfreq(2 * record.signals.shape[1], 1 / record.sampling_rate_hz)
    spectrum = scipy.fft.rfft(record.signals, 2 * record.signals.shape[1], axis=1)
    line = scipy.fft.irfft(spectrum * np.sinc(frequency * record.chip_s), axis=1)[:, : record.signals.shape[1]]
    return replace(record, signals=line.astype(np.float32))


def compressed(record: AcousticRecord, how: How = "minimax") -> AcousticRecord:
    """As `annulus tai decode` does it: a code through its template, a pulse moved to its middle."""
    if "1" in record.code and "0" in record.code.strip("0"):
        return decode_record(record, template("least-squares" if how == "least-squares" else "minimax"))[0]
    assert record.chip_s is not None
    return replace(record, t0_s=record.t0_s - 0.5 * len(record.code) * record.chip_s, code="")


def treated(record: AcousticRecord, how: How, setup: Setup = SETUP) -> AcousticRecord:
    """Decoded and filtered: both conditions behind one band filter, or as in the source the coded condition alone,
    by its template of chips as long as they were sent."""
    done = compressed(record, how)
    if how != "as in the source":
        return band_filtered(done, setup)
    return held(done) if record.code.count("1") > 1 else done


# Images


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """One way to shoot and to filter: the image without noise, and images of one shot's noise of rms 1."""

    clean: AcousticImage
    noise: tuple[FloatArray, ...]

    def at(self, noise: float, seed: int = 0) -> FloatArray:
        """The image with noise of that rms."""
        return np.asarray(self.clean.values + noise * self.noise[seed % len(self.noise)])


def imaged(record: AcousticRecord) -> AcousticImage:
    """Pixels as long as the chip asks for."""
    assert record.chip_s is not None
    return time_reversal(sweep_of(record), pixel=PIXEL_MM * record.chip_s / CHIP_S)


@cache
def noise_images(code: str, how: How, setup: Setup = SETUP, seeds: int = SEEDS) -> tuple[FloatArray, ...]:
    """Images of noise of rms 1, recorded for as long as that code takes, treated like its sound."""
    if code == SINGLE and how == "least-squares":
        return noise_images(code, "minimax", setup, seeds)
    empty = sent(shot("core", setup), pattern(code))
    offset = 100 * len(pattern(code))
    return tuple(imaged(treated(white(empty, offset + seed), how, setup)).values for seed in range(seeds))


@cache
def condition(sample: str, code: str, how: How = "minimax", setup: Setup = SETUP, seeds: int = SEEDS) -> Condition:
    clean = imaged(treated(sent(shot(sample, setup), pattern(code)), how, setup))
    return Condition(clean, noise_images(code, how, setup, seeds))


def within(image: AcousticImage, radius_mm: float) -> NDArray[np.bool_]:
    y, x = np.meshgrid(image.y_mm, image.x_mm, indexing="ij")
    return np.asarray((np.hypot(x, y) < radius_mm) & np.isfinite(image.values))


# Tables 8.1 to 8.3


@dataclass(frozen=True, slots=True)
class Comparison:
    """One table: all in dB against a reference of 2048 averages at full power, unless it says otherwise."""

    setting: Setting
    shot_noise: float  # rms of one shot, in pressures of one pulse, with which the single pulse has the source's PSNR
    single_db: float
    coded_db: float
    sidelobes_db: float  # of the coded image without noise: what the sidelobes of its filter leave
    noise_gain_db: float  # by how much less noise there is in the coded image, apart from its sidelobes
    gain_db: float
    gain_clean_db: float  # against a reference without noise
    expected_db: float  # of the minimax filter, the reference's noise counted
    most_db: float  # of any linear filter, the reference's noise counted

    @property
    def expected_with_sidelobes_db(self) -> float:
        """The gain once more, with what the sidelobes leave in the image added to its noise."""
        noise = 10 ** (-(self.single_db + self.expected_db) / 10)
        return -10 * math.log10(noise + 10 ** (-self.sidelobes_db / 10)) - self.single_db

    @property
    def source_gain_db(self) -> float:
        return self.setting.coded_db - self.setting.single_db


def psnr_db(image: FloatArray, reference: FloatArray, most: float) -> float:
    """Eq. 8.21."""
    return 10 * math.log10(most**2 / float(np.mean((image - reference) ** 2)))


def noise_for(psnr: float, differences: Sequence[FloatArray], most: float) -> float:
    """The rms of one shot at which noise `differences` of rms 1 leave that PSNR."""
    square = float(np.mean([np.mean(one**2) for one in differences]))
    return most * 10 ** (-psnr / 20) / math.sqrt(square)


@cache
def compare(table: str, how: How = "minimax", setup: Setup = SETUP, seeds: int = SEEDS) -> Comparison:
    """A table of the source with the noise that gives its single pulse its PSNR."""
    setting = TABLES[table]
    single, coded = (condition("core", code, how, setup, seeds) for code in (SINGLE, CODED))
    inside = within(single.clean, WITHIN * setup.radius_mm)
    truth, decoded = (np.asarray(one.clean.values[inside], float) for one in (single, coded))
    noises = [[np.asarray(one[inside], float) for one in both.noise] for both in (single, coded)]
    most = float(np.abs(truth).max())
    quiet = 1 / math.sqrt(REFERENCE_AVERAGES)
    others = noises[0][1:] + noises[0][:1]  # the reference has noise of its own
    differences = [setting.noise * one - quiet * other for one, other in zip(noises[0], others, strict=True)]
    shot_noise = noise_for(setting.single_db, differences, most)
    fit = float(truth @ decoded / (decoded @ decoded))  # filters that are not alike have other amplitudes

    def mean_db(errors: Sequence[FloatArray]) -> float:
        return 10 * math.log10(most**2 / float(np.mean([np.mean(one**2) for one in errors])))

    single_db = mean_db([shot_noise * one for one in differences])
    heard = [fit * (decoded + shot_noise * setting.noise * one) - truth for one in noises[1]]
    coded_db = mean_db([one - shot_noise * quiet * other for one, other in zip(heard, others, strict=True)])
    clean_db = mean_db(heard) - mean_db([shot_noise * setting.noise * one for one in noises[0]])
    found = template("least-squares" if how == "least-squares" else "minimax")

    def against_reference(gain_db: float) -> float:
        square = setting.noise**2
        return 10 * math.log10((square + quiet**2) / (square / 10 ** (gain_db / 10) + quiet**2))

    return Comparison(
        setting,
        shot_noise,
        single_db,
        coded_db,
        mean_db([fit * decoded - truth]),
        mean_db([fit * one for one in noises[1]]) - mean_db(noises[0]),
        coded_db - single_db,
        clean_db,
        against_reference(found.gain_db),
        against_reference(found.ceiling_db),
    )


def half_power_db() -> float:
    """PSNR of a perfect image at half the power against a reference at full power, if nobody scales it."""
    single = condition("core", SINGLE)
    truth = single.clean.values[within(single.clean, WITHIN * SETUP.radius_mm)]
    return psnr_db(0.5 * truth, truth, float(np.abs(truth).max()))


def table_figure(table: str) -> Figure:
    """Figures 8.10 (with table 8.1), 8.11 (8.2), 8.12 (8.3): single, coded, and a line through the core."""
    found, theirs = compare(table), compare(table, "as in the source")
    squares = compare(table, "least-squares")
    single, coded = (condition("core", code) for code in (SINGLE, CODED))
    noise = found.shot_noise * found.setting.noise
    numbers = {
        "psnr_single_db": found.single_db,
        "psnr_coded_db": found.coded_db,
        "gain_db": found.gain_db,
        "gain_clean_reference_db": found.gain_clean_db,
        "gain_expected_db": found.expected_db,
        "gain_any_filter_db": found.most_db,
        "gain_least_squares_db": squares.gain_db,
        "gain_as_in_the_source_db": theirs.gain_db,
        "gain_source_db": found.source_gain_db,
        "shot_noise": found.shot_noise,
    }

    def draw(figure: Any) -> None:
        axes = figure.subplots(1, 4)
        reference = single.at(found.shot_noise / math.sqrt(REFERENCE_AVERAGES), 1)
        images = (single.at(noise), coded.at(noise), reference)
        most = float(np.nanmax(np.abs(single.clean.values)))
        setting = found.setting
        names = (
            f"a) single, {setting.averages} averages, {setting.power_kw:g} kW: {found.single_db:.1f} dB",
            f"b) MPSL25: {found.coded_db:.1f} dB",
            f"c) reference: single, {REFERENCE_AVERAGES} averages, 3 kW",
        )
        for one, image, name in zip(axes, images, names, strict=False):
            shown = show_map(one, image / most, single.clean.x_mm, single.clean.y_mm, name, (-1, 1), "RdBu_r")
        figure.colorbar(shown, ax=axes[2], shrink=0.8)
        for n, (name, colour) in ((0, ("single", "0.6")), (2, ("reference", "tab:blue")), (1, ("MPSL25", "tab:red"))):
            line = profile(images[n], single.clean.y_mm, 0.0, 0) / most
            axes[3].plot(single.clean.x_mm, line, lw=0.9, color=colour, label=name)
        axes[3].set(xlabel="x, mm", ylabel="pressure, of the largest", ylim=(-1.5, 1.5))
        axes[3].set_title("d) line through the core", fontsize=9)
        axes[3].legend(fontsize=8)

    return Figure(numbers, draw, (17, 3.8))


# Figures 8.7 to 8.9: one trace


@cache
def trace() -> AcousticRecord:
    """What one position hears of the core, with the coupling of the pulse into the receiver."""
    whole = shot("core")
    samples = whole.signals.shape[1]
    spike = through(coupling(replace(SETUP, spike_pa=SPIKE_PA), pattern("single"), samples)[None], SETUP)
    return replace(whole, signals=(whole.signals[:1] + spike).astype(np.float32), angles_deg=whole.angles_deg[:1])


def one_shot(code: str, averages: int, seed: int) -> AcousticRecord:
    """A trace with the noise of table 8.1, averaged."""
    clean = sent(trace(), pattern(code))
    rms = compare("8.1").shot_noise / math.sqrt(averages)
    return replace(clean, signals=clean.signals + np.float32(rms) * white(clean, seed).signals)


def pair_of(averages: int, seed: int, noise: bool = True) -> AcousticRecord:
    codes = [pattern("manchester1"), pattern("manchester2")]
    shots = [
        one_shot(text(chips), averages, seed + n) if noise else sent(trace(), chips) for n, chips in enumerate(codes)
    ]
    decoded = decode_pair([one.signals for one in shots], SETUP.sampling_rate_hz, codes, CHIP_S)
    return replace(shots[0], signals=decoded.astype(np.float32), code="", t0_s=0.0)


@cache
def noise_in_trace(code: str, how: How | None, seeds: int = 8) -> tuple[float, float]:
    """(rms of one shot's noise of rms 1, rms of the sample's sound under one pulse), both treated alike; None only
    decodes."""

    def done(record: AcousticRecord) -> FloatArray:
        one = compressed(record) if how is None else treated(record, how)
        times = one.t0_s + np.arange(one.signals.shape[1]) / one.sampling_rate_hz
        return np.asarray(one.signals[:, _heard(times)], float)

    empty = sent(trace(), pattern(code))
    left = [float(np.mean(done(white(empty, 50 + seed)) ** 2)) for seed in range(seeds)]
    sound = replace(shot("core"), signals=shot("core").signals[:1])
    if how == "as in the source" and code != SINGLE:
        sound = held(sound)
    return math.sqrt(float(np.mean(left))), float(np.sqrt(np.mean(done(sound) ** 2)))


def snr_db(code: str, how: How | None, averages: int) -> float:
    """Sound over noise in one trace, with the noise of table 8.1."""
    noise, sound = noise_in_trace(code, how)
    return 20 * math.log10(sound / (noise * compare("8.1").shot_noise / math.sqrt(averages)))


def _heard(times_s: FloatArray) -> NDArray[np.bool_]:
    """While sound from the sample can arrive."""
    reach = 14e-3
    radius = 1e-3 * SETUP.radius_mm
    return np.asarray(
        (times_s > (radius - reach) / SETUP.sound_speed_m_s) & (times_s < (radius + reach) / SETUP.sound_speed_m_s)
    )


def single_trace() -> Figure:
    """Fig. 8.7: sample, and what one position hears at 2048 and at 2 averages."""
    numbers = {"snr_2048_db": snr_db(SINGLE, None, 2048), "snr_2_db": snr_db(SINGLE, None, 2)}
    records = [compressed(one_shot("single", averages, 7)) for averages in (2048, 2)]

    def draw(figure: Any) -> None:
        left, *others = figure.subplots(1, 3)
        show_sample(left, "core", "a) cheese with an agar core, receiver on the right")
        for axes, record, name in zip(others, records, ("b) 2048 averages", "c) 2 averages"), strict=True):
            _line(axes, record, f"{name}, 3 kW")
        _regions(others[0])

    return Figure(numbers, draw, (15, 3.8))


def coded_trace() -> Figure:
    """Fig. 8.8: MPSL25 as heard, and behind its filter at 2048 and at 2 averages."""
    plain = snr_db(SINGLE, None, 2)
    numbers = {
        "snr_2_db": snr_db(CODED, None, 2),
        "gain_db": snr_db(CODED, None, 2) - plain,
        "gain_same_band_db": snr_db(CODED, "minimax", 2) - snr_db(SINGLE, "minimax", 2),
        "gain_held_template_db": snr_db(CODED, "as in the source", 2) - plain,
        "gain_theory_db": template().gain_db,
    }
    raw = one_shot("mpsl25-stuffed", 2048, 9)
    records = [raw, *(compressed(one_shot("mpsl25-stuffed", averages, 9)) for averages in (2048, 2))]

    def draw(figure: Any) -> None:
        names = ("a) as heard, 2048 averages", "b) filtered, 2048 averages", "c) filtered, 2 averages")
        for axes, record, name in zip(figure.subplots(1, 3), records, names, strict=True):
            _line(axes, record, name)

    return Figure(numbers, draw, (15, 3.8))


def pair_trace() -> Figure:
    """Fig. 8.9: the Manchester pair as heard, and summed behind its matched filters."""
    clean = pair_of(1, 0, noise=False)
    plain = compressed(trace())
    times = clean.t0_s + np.arange(clean.signals.shape[1]) / clean.sampling_rate_hz
    own = plain.t0_s + np.arange(plain.signals.shape[1]) / plain.sampling_rate_hz
    alone, both = np.interp(times, own, plain.signals[0])[_heard(times)], clean.signals[0, _heard(times)]
    left = [(pair_of(2, 60 + 2 * seed).signals - clean.signals)[0, _heard(times)] for seed in range(8)]
    noise = math.sqrt(float(np.mean([np.mean(one.astype(float) ** 2) for one in left])))
    numbers = {
        "snr_2_db": 20 * math.log10(float(np.sqrt(np.mean(alone**2))) / noise),
        "noise_gain_db": 20 * math.log10(compare("8.1").shot_noise / math.sqrt(2) / noise),
        "likeness_to_single_pulse": float(np.corrcoef(both, alone)[0, 1]),
        "shots": 2.0,
    }
    records = [one_shot("manchester1", 2048, 3), one_shot("manchester2", 2048, 4), pair_of(2048, 5), pair_of(2, 6)]

    def draw(figure: Any) -> None:
        names = ("a) first code, 2048 averages", "b) second code, 2048 averages", "c) summed, 2048", "d) summed, 2")
        for axes, record, name in zip(figure.subplots(1, 4), records, names, strict=True):
            _line(axes, record, name)

    return Figure(numbers, draw, (17, 3.6))


def show_sample(axes: Any, name: str, title: str) -> None:
    """What stands in front of the receiver."""
    from annulus_pipe.wings.tai.measure.field import SoundGrid
    from annulus_pipe.wings.tai.measure.phantoms import draw

    grid = SoundGrid((300, 300), 2 * SETUP.radius_mm / 280)
    show_map(axes, draw(phantom(name), grid), grid.x_mm, grid.y_mm, title, (0, 1.05))
    axes.plot(SETUP.radius_mm, 0, "<", color="tab:orange")


def _line(axes: Any, record: AcousticRecord, title: str) -> None:
    times = 1e6 * (record.t0_s + np.arange(record.signals.shape[1]) / record.sampling_rate_hz)
    show_trace(axes, times, record.signals[0], title)
    clean = np.abs(shot("core").signals[0]).max()
    axes.set(ylabel="pressure, of one pulse's rise", xlim=(0, min(times[-1], 60)))
    if record.code.count("1") <= 1:
        axes.set(xlim=(0, 25), ylim=(-1.6 * clean, 1.6 * clean))


def _regions(axes: Any) -> None:
    """Where coupling, near wall, core and far wall are heard."""
    _, high = axes.get_ylim()
    places = ((0.0, "coupling", 0.98), (3.0, "near wall", 0.9), (11.0, "core", 0.98), (21.0, "core", 0.98))
    for way, name, height in (*places, (31.0, "far wall", 0.98)):
        axes.annotate(name, (way / 1.48, height * high), ha="center" if way else "left", va="top", fontsize=7)
