"""The study's comparisons say what they measure, and no more."""

import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from annulus_pipe.link.codes import pattern
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.decode import decode_record
from annulus_pipe.wings.tai.measure.phantoms import Disc
from annulus_pipe.wings.tai.simulate import Setup, simulate
from tools.study import FIGURES, bubbles, chosen, noise
from tools.study.__main__ import main
from tools.study.images import full_width, switched_on
from tools.study.microwaves import peak, under_gaussian
from tools.study.wires import RAYLEIGH, dip, places_mm

# everything eight times as long as in the study, so that an image is small
SMALL = Setup(chip_s=4e-6, radius_mm=17.0, positions=32, sampling_rate_hz=2.5e6, transducer=(0.28125e6, 0.7))


def test_a_burst_is_so_many_pulses():
    """Shifted and added traces of one pulse are what the solver makes of the whole burst."""
    sample = (Disc(1.0, 0.5, 3.0, 1.0),)
    setup = replace(SMALL, chip_s=1e-6, positions=4, sampling_rate_hz=4e6, transducer=(0.6e6, 0.7))
    single = simulate(sample, setup)
    added = noise.sent(single, pattern("1001011"))
    whole = simulate(sample, replace(setup, code="1001011"))
    n = single.signals.shape[1] - 12  # there its record ends
    assert added.code == whole.code
    assert np.abs(added.signals[:, :n] - whole.signals[:, :n]).max() < 0.01 * np.ptp(whole.signals)


def test_bubbles_take_signal_and_shorten_it():
    """Coarse: the bench has the study's own grid."""
    numbers = bubbles.concentrations(pixel_mm=0.4, em_step_mm=2.0).numbers
    percents = [row[0] for row in bubbles.TABLE_7_1]
    for name, unit in (("swing_same_gruneisen", ""), ("apart", "_us"), ("absorbed", "_w")):
        values = [numbers[f"{name}_{percent}{unit}"] for percent in percents]
        assert all(a > b for a, b in pairwise(values)), name
    assert all(abs(numbers[f"apart_{p}_us"] / numbers[f"across_{p}_us"] - 1) < 0.15 for p in percents)


def test_chips_that_fall_between_samples_are_not_added():
    with pytest.raises(AnnulusError, match=r"chips of 10\.4 samples"):
        noise.sent(replace(noise.shot("core", SMALL), sampling_rate_hz=2.6e6), pattern("101"))


def test_both_arms_alike_gain_what_the_filter_gains():
    """Noise is set so that the single pulse has the source's PSNR; the code's is then a matter of theory."""
    found = noise.compare("8.2", setup=SMALL, seeds=3)
    assert found.single_db == pytest.approx(12.5797, abs=1e-6)
    assert found.noise_gain_db == pytest.approx(7.84, abs=0.8)
    assert found.gain_db == pytest.approx(found.expected_with_sidelobes_db, abs=0.8)
    assert found.expected_db < found.most_db < 10.414
    assert found.source_gain_db > found.most_db  # 16.88 dB: no linear filter gives that


def test_the_references_own_noise_hides_part_of_a_gain():
    many, few = (noise.compare(table, setup=SMALL, seeds=3) for table in ("8.1", "8.2"))
    assert many.expected_db < few.expected_db < 7.84
    perfect = 10 * math.log10((1 / 256 + 1 / 2048) * 2048)  # not even an image without noise could show more
    assert many.most_db < perfect


def test_an_image_with_noise_is_the_image_of_noisy_traces():
    """An image is linear in its traces: the shortcut that the tables take."""
    one = noise.condition("core", "single", setup=SMALL, seeds=1)
    clean = noise.shot("core", SMALL)
    rms = 0.01
    noisy = replace(
        clean, signals=clean.signals + np.float32(rms) * noise.white(clean, 100).signals
    )  # seed 0 of one chip
    image = noise.imaged(noise.treated(noisy, "minimax", SMALL))
    inside = np.isfinite(image.values)
    assert np.abs(image.values - one.at(rms))[inside].max() < 3e-6 * np.nanmax(np.abs(image.values))


def test_filtering_one_arm_alone_looks_like_a_gain():
    """The template of held chips takes noise out that has nothing to do with the code."""
    alike = noise.compare("8.2", setup=SMALL, seeds=3)
    unlike = noise.compare("8.2", "as in the source", SMALL, 3)
    assert unlike.noise_gain_db > alike.noise_gain_db + 1


def test_a_pulse_of_any_length_is_put_back_to_its_middle():
    clean = noise.shot("core", SMALL)
    assert noise.compressed(noise.sent(clean, pattern("1111"))).t0_s == pytest.approx(clean.t0_s - 8e-6)
    one = decode_record(clean)[0]
    assert noise.compressed(clean).t0_s == pytest.approx(one.t0_s)


def test_two_peaks_are_two_when_the_line_sinks_between_them():
    x = np.linspace(-12, 12, 481)
    left, right = places_mm()

    def line(width: float, rest: float) -> np.ndarray:
        return np.exp(-(((x - left) / width) ** 2)) + 0.7 * np.exp(-(((x - right) / width) ** 2)) + rest

    assert dip(x, line(1.0, 0.0)) > 0.97
    assert dip(x, line(1.0, 0.0)) > RAYLEIGH > dip(x, line(1.0, 5.0))
    assert dip(x, line(9.0, 0.0)) < RAYLEIGH
    assert dip(x, -line(1.0, 0.0)) == -math.inf


def test_widths_and_maxima_are_measured_between_samples():
    x = np.linspace(-5, 5, 201)
    assert full_width(x, np.exp(-((x - 0.3) ** 2) / 2), 0.3) == pytest.approx(2.3548, abs=6e-4)
    ring = np.exp(-(((np.abs(x) - 1.5) / 0.2) ** 2))
    assert full_width(x, ring, 0.0) == pytest.approx(3.0 + 2 * 0.2 * math.sqrt(math.log(2)), abs=0.004)
    sigma = np.geomspace(0.1, 10, 31)
    at, most = peak(sigma, 3.0 - np.log(sigma / 0.77) ** 2)
    assert (at, most) == (pytest.approx(0.77, rel=1e-6), pytest.approx(3.0, rel=1e-6))


def test_pulses_keep_their_energy():
    dt = 1e-7
    instant = np.zeros((1, 400))
    instant[0, 100] = 1.0
    on = switched_on(instant, 3e-6, dt)
    assert on.sum() == pytest.approx(1.0)
    assert np.flatnonzero(on[0] > 1e-9)[[0, -1]].tolist() == [100, 130]
    smooth = under_gaussian(instant, dt, 2e-6)
    assert smooth.sum() == pytest.approx(1.0)
    assert full_width(np.arange(400.0), smooth[0], 100.0, 60.0) == pytest.approx(20.0)


def test_every_figure_of_the_source_is_there():
    assert chosen([]) == list(FIGURES)
    assert {f"7.{n}" for n in range(3, 9)} | {f"8.{n}" for n in (1, 2, 3, 4, *range(7, 15))} | {"11"} == set(FIGURES)
    with pytest.raises(AnnulusError, match=r"figure '9.1': expected one of 7\.3"):
        chosen(["9.1"])
    assert main(["9.1"]) == 1


def test_a_figure_is_a_picture_and_a_row_of_numbers(tmp_path, capsys):
    assert main(["fig8.3", "--out", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["8.3"]["peak"] == 52
    assert (tmp_path / "fig8.3.png").read_bytes().startswith(b"\x89PNG")
    table = json.loads((tmp_path / "study.json").read_text())
    assert (table["8.3"]["before"], table["8.3"]["after"], table["8.3"]["elsewhere"]) == (-25, -26, 1)
    assert "8.3,complementary Manchester pair,peak,52" in (tmp_path / "study.csv").read_text()
