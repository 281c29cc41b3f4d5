"""From a coded shot to an image, and from bad input to one line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.controller import CODES
from annulus_pipe.link.codes import pattern
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import load_acoustic, save_acoustic
from annulus_pipe.wings.tai.decode import decode_record, detected_code, load_template, save_template
from annulus_pipe.wings.tai.image import ImageSettings, make_image
from annulus_pipe.wings.tai.measure.imaging import Region
from annulus_pipe.wings.tai.measure.phantoms import Disc
from annulus_pipe.wings.tai.measure.templates import design
from annulus_pipe.wings.tai.simulate import Setup, simulate

SAMPLE = (Disc(0.0, 0.0, 5.0, 0.4), Disc(2.0, 1.0, 1.0, 1.0))
SETUP = Setup(
    code="mpsl25-stuffed", radius_mm=9.0, positions=32, sampling_rate_hz=10e6, transducer=(0.6e6, 1.2), noise_pa=0.0005
)


@pytest.fixture(scope="module")
def coded():
    return simulate(SAMPLE, SETUP)


@pytest.fixture(scope="module")
def single():
    return simulate(SAMPLE, replace(SETUP, code="single", noise_pa=0.0))


def test_a_decoded_code_is_what_one_pulse_would_have_been_heard_as(coded, single):
    """In time and amplitude, to the sidelobes and the noise."""
    decoded, template = decode_record(coded)
    plain, _ = decode_record(single)
    assert template is not None
    n = plain.signals.shape[1] - 20
    late = plain.t0_s * plain.sampling_rate_hz  # the single pulse's record starts at its chip, not at its middle
    grid = np.arange(20, n - 20)
    expected = np.stack([np.interp(grid - late, np.arange(len(t)), t) for t in plain.signals.astype(float)])
    found = decoded.signals[:, grid]
    assert np.linalg.norm(found - expected) < 0.1 * np.linalg.norm(expected)


@pytest.mark.deep(gate="tests/wings/tai/test_tai.py::test_a_bad_receiver_hum_and_a_wrong_speed_are_put_right")
def test_a_coded_sweep_becomes_an_image(coded, tmp_path):
    save_acoustic(tmp_path / "raw.hdf5", coded)
    result = make_image(tmp_path / "raw.hdf5", tmp_path / "out", ImageSettings(pixel_mm=0.25))
    assert result.decoded_from == "mpsl25-stuffed"
    assert result.excluded == ()
    assert np.hypot(result.strongest[1] - 2.0, result.strongest[2] - 1.0) < 0.45
    with np.load(tmp_path / "out" / "image.npz") as saved:
        assert saved["image"].shape == (len(saved["y_mm"]), len(saved["x_mm"]))
    assert (tmp_path / "out" / "image.png").read_bytes().startswith(b"\x89PNG")


def test_bad_traces_and_holes_are_said(coded, tmp_path):
    signals = coded.signals.copy()
    signals[4] = np.nan
    part = replace(coded, signals=signals[:24], angles_deg=coded.angles_deg[:24])
    save_acoustic(tmp_path / "raw.npz", part)
    result = make_image(tmp_path / "raw.npz", tmp_path / "out", ImageSettings(pixel_mm=0.4))
    assert result.excluded == (4,)
    assert any("1 of 24 traces (4)" in finding for finding in result.findings)
    assert result.holes_deg == ((258.75, 360.0),)


def test_a_bad_receiver_hum_and_a_wrong_speed_are_put_right(single, tmp_path):
    """One receiver turned round, hum of 20 kHz ten times the sound, a speed of sound 3 % off."""
    times = np.arange(single.signals.shape[1]) / single.sampling_rate_hz
    peak = np.abs(single.signals).max()
    signals = single.signals + np.float32(10 * peak) * np.sin(2 * np.pi * 2e4 * times + 1.0).astype(np.float32)
    signals[9] = 2 * (signals[9] - single.signals[9]) - signals[9]
    save_acoustic(tmp_path / "raw.npz", replace(single, signals=signals, sound_speed_m_s=1436.0))
    settings = ImageSettings(
        pixel_mm=0.25, search_m_s=(1400.0, 1560.0), band_hz=(0.15e6, 2e6), region=Region(-6.0, 6.0, -5.5, 6.0)
    )
    result = make_image(tmp_path / "raw.npz", tmp_path / "out", settings)
    assert result.excluded == (9,)
    assert any("receiver at position 9 agrees with the others by -" in finding for finding in result.findings)
    # the circle is only seven waves of the transducer across
    assert result.arrival == "plane" and abs(result.sound_speed_m_s / 1480.0 - 1) < 0.006
    assert np.hypot(result.strongest[1] - 2.0, result.strongest[2] - 1.0) < 0.6
    with np.load(tmp_path / "out" / "image.npz") as saved:
        assert saved["x_mm"].min() >= -6.0 and saved["x_mm"].max() <= 6.0 and saved["y_mm"].min() >= -5.5


def test_another_codes_template_is_refused(coded, tmp_path):
    save_template(tmp_path / "t.json", design(pattern("barker13"), 39), 0.5e-6)
    template = load_template(tmp_path / "t.json")
    with pytest.raises(AnnulusError, match="the template is for barker13, the record was shot with mpsl25-stuffed"):
        decode_record(coded, template)


def test_a_record_that_names_the_wrong_code_is_heard_out(coded):
    assert detected_code(coded) is None
    assert detected_code(replace(coded, code=CODES["barker13"])) == "mpsl25-stuffed"
    assert detected_code(replace(coded, code=CODES["manchester1"])) == "mpsl25-stuffed"


def test_nothing_left_to_image_is_one_line(coded, tmp_path):
    save_acoustic(tmp_path / "raw.npz", replace(coded, signals=np.full_like(coded.signals, np.nan)))
    with pytest.raises(AnnulusError, match="0 of 32 traces can be used"):
        make_image(tmp_path / "raw.npz", tmp_path / "out")


@pytest.mark.deep(gate="tests/wings/tai/test_tai.py::test_a_record_that_names_the_wrong_code_is_heard_out")
def test_the_commands_do_it_all(tmp_path):
    run = CliRunner()
    raw, folder, template = tmp_path / "raw.hdf5", tmp_path / "out", tmp_path / "t.json"
    shot = ["--phantom", "shapes", "--radius-mm", "9", "--positions", "24", "--rate-mhz", "8", "--band-mhz", "0.6"]
    assert run.invoke(app, ["tai", "simulate", *shot, "-o", str(raw)]).exit_code == 0
    assert run.invoke(app, ["burst", "design", "--method", "least-squares", "-o", str(template)]).exit_code == 0
    assert (
        run.invoke(
            app, ["tai", "decode", str(raw), "--template", str(template), "-o", str(tmp_path / "d.npz")]
        ).exit_code
        == 0
    )
    assert load_acoustic(tmp_path / "d.npz").extra["decoded_from"] == "mpsl25-stuffed"
    answer = run.invoke(
        app,
        [
            "tai",
            "image",
            str(tmp_path / "d.npz"),
            "--pixel-mm",
            "0.4",
            "--band",
            "0.1",
            "2",
            "--region",
            "-6",
            "6",
            "-3",
            "3",
            "--json",
            "-o",
            str(folder),
        ],
    )
    assert answer.exit_code == 0
    said = json.loads(answer.stdout)
    assert (said["positions"], said["size"]) == (24, [30, 16])
    bad = run.invoke(app, ["tai", "image", str(raw), "-o", str(folder), "--method", "magic"])
    assert isinstance(bad.exception, AnnulusError)
