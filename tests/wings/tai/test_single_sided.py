"""A plate from one side, through air: found at the noise of the budget, and nothing where nothing is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.budget import SEQUENCES, Laminate, SingleSidedRig, bursts_of
from annulus_pipe.wings.tai.measure.elastic import RATE_HZ, PlateDefect, PlateSample, face_velocity, sound_in_air
from annulus_pipe.wings.tai.measure.layered import PlateModel
from annulus_pipe.wings.tai.single_sided import (
    SAMPLES,
    PlateRecord,
    decoded,
    examine_plate,
    load_plate,
    read_plate,
    save_plate,
    simulate_plate,
    with_noise,
)

RIG, LAMINATE = SingleSidedRig(), Laminate()
X_MM = (np.arange(51) - 25) * 2.0
WAVE_MM = 1e3 * LAMINATE.speed / RIG.middle_hz
COARSE_MM = 0.5  # a cell of the gate's truth: an eighth of the time


def sound(*defects: PlateDefect, cell_mm: float = COARSE_MM) -> np.ndarray:
    velocity, x_mm = face_velocity(PlateSample(defects=defects), RIG, cell_mm)
    return sound_in_air(velocity, x_mm, RIG, X_MM, SAMPLES)


@pytest.fixture(scope="module")
def quiet():
    return sound()


@pytest.fixture(scope="module")
def model():
    return PlateModel(LAMINATE, RIG, 2.0, np.exp(-((X_MM / 60) ** 2)), RATE_HZ, SAMPLES)


def test_the_adjoint_is_the_models(model):
    rng = np.random.default_rng(3)
    image = rng.normal(size=(2, len(model.depths_mm), model.count))
    data = rng.normal(size=(model.count, len(model.bins))) + 1j * rng.normal(size=(model.count, len(model.bins)))
    there = np.vdot(model.forward(image), data).real
    back = float((image * model.adjoint(data)).sum())
    assert abs(there - back) < 1e-10 * np.linalg.norm(model.forward(image)) * np.linalg.norm(data)


def test_both_solvers_agree(model, quiet):
    """Finite differences, ply by ply, against the plate in closed form: size within 5 %."""
    theirs, ours = model.damped(quiet)[model.count // 2], model.sound_plate()
    both = abs(np.vdot(ours, theirs))
    assert both / np.linalg.norm(ours) / np.linalg.norm(theirs) > 0.97
    assert both / np.vdot(ours, ours).real == pytest.approx(1.0, abs=0.05)


def test_an_endless_crack_sounds_like_a_plate_of_its_depth(model):
    """Kirchhoff's way is exact there: sound plate plus crack is the plate above the crack."""
    flat = PlateModel(LAMINATE, RIG, 2.0, np.ones(model.count), RATE_HZ, SAMPLES)
    at = int(np.flatnonzero(flat.depths_mm == 6.0)[0])
    spectrum = flat.kernel[0, at, :, 0]  # wave number 0
    thin = PlateModel(replace(LAMINATE, thickness_mm=6.0), RIG, 2.0, flat.beam, RATE_HZ, SAMPLES)
    expected = thin.sound_plate() - flat.sound_plate()
    assert np.linalg.norm(spectrum - expected) < 0.01 * np.linalg.norm(expected)


@pytest.mark.parametrize(
    ("defect", "seconds"),
    [(PlateDefect("delamination", -20.0, 6.0, 20.0), 35.0), (PlateDefect("water", 22.0, 12.0, 12.0), 0.013)],
    ids=["delamination", "water"],
)
def test_a_defect_is_found_at_the_noise_of_the_budget(defect, seconds):
    _, answer = examine_plate(with_noise(sound(defect), RIG, "manchester", seconds, 5))
    assert len(answer.places) == 1
    place = answer.places[0]
    assert place.kind in (defect.kind, None)
    assert np.hypot(place.x_mm - defect.x_mm, place.depth_mm - defect.depth_mm) < 2.5 < WAVE_MM
    assert abs(place.wide_mm - defect.wide_mm) < 5.0
    assert place.depth_sigma_mm >= 1.0 and place.x_sigma_mm >= 0.5


def test_a_sound_plate_has_no_places(quiet):
    for seed, seconds in ((1, 35.0), (2, 35.0), (3, 0.013)):
        assert examine_plate(with_noise(quiet, RIG, "manchester", seconds, seed))[1].places == ()


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_every_sequence_decodes_to_one_chip(sequence, quiet, model):
    clean = decoded(with_noise(quiet, RIG, sequence, 1e6, 1))
    off = model.damped(clean) - model.damped(quiet)
    assert np.linalg.norm(off) < 0.1 * np.linalg.norm(model.damped(quiet))


@pytest.mark.deep(gate="tests/wings/tai/test_single_sided.py::test_a_defect_is_found_at_the_noise_of_the_budget")
@pytest.mark.parametrize("depth_mm", [4.0, 9.0, 14.0])
def test_delaminations_of_other_depths_are_found(depth_mm):
    defect = PlateDefect("delamination", 15.0, depth_mm, 22.0)
    _, answer = examine_plate(with_noise(sound(defect, cell_mm=0.25), RIG, "manchester", 35.0, 6))
    assert len(answer.places) == 1
    assert np.hypot(answer.places[0].x_mm - 15.0, answer.places[0].depth_mm - depth_mm) < 2.5


def test_simulate_and_image_from_the_command_line(tmp_path):
    plate = tmp_path / "plate.toml"
    plate.write_text("thickness_mm = 20\n[[delamination]]\nx_mm = 10\ndepth_mm = 7\nwide_mm = 24\n")
    raw = tmp_path / "raw.hdf5"
    done = CliRunner().invoke(app, ["tai", "simulate", "--single-sided", "--plate", str(plate), "-o", str(raw)])
    assert done.exit_code == 0, done.output
    truth = json.loads((tmp_path / "raw.truth.json").read_text())
    assert truth["defects"][0]["depth_mm"] == 7 and b"depth_mm" not in raw.read_bytes()
    done = CliRunner().invoke(app, ["tai", "image", str(raw), "-o", str(tmp_path / "out"), "--json"])
    found = json.loads(done.stdout)
    assert len(found["places"]) == 1 and abs(found["places"][0]["x_mm"] - 10) < 2.5
    with np.load(tmp_path / "out" / "image.npz") as saved:
        assert saved["delamination"].shape == (len(saved["depth_mm"]), len(saved["x_mm"]))
    assert (tmp_path / "out" / "image.png").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_simulated_is_refused_before_the_sound_is_made(tmp_path):
    def never(*_: object) -> None:
        raise AssertionError("sound was made")

    for sequence, seconds in (("barker", 1.0), ("single", 0.0), ("single", float("nan"))):
        with pytest.raises(AnnulusError, match=r"sequence 'barker'|s a position"):
            simulate_plate(PlateSample(), RIG, sequence, seconds, progress=never)
    done = CliRunner().invoke(app, ["tai", "simulate", "--single-sided", "-o", str(tmp_path / "a.npz")])
    assert isinstance(done.exception, AnnulusError) and "a.npz" in str(done.exception)


@given(seed=st.integers(0, 2**31), sequence=st.sampled_from(SEQUENCES), thickness=st.floats(6, 40))
@settings(max_examples=15, deadline=None)
def test_a_file_gives_back_what_was_written(tmp_path_factory, seed, sequence, thickness):
    shots = np.random.default_rng(seed).normal(size=(len(bursts_of(sequence)), 17, SAMPLES)).astype(np.float32)
    record = PlateRecord(shots, sequence, 7, RIG, replace(LAMINATE, thickness_mm=thickness))
    path = tmp_path_factory.mktemp("plate") / "a.hdf5"
    save_plate(path, record)
    again = load_plate(path)
    assert (again.shots == shots).all() and again.sequence == sequence and again.averages == 7
    assert again.rig == RIG and again.laminate == record.laminate
    path.write_bytes(path.read_bytes()[: 700 + seed % 3000])
    with pytest.raises(AnnulusError, match=r"cannot be read"):
        load_plate(path)


@given(text=st.text(max_size=80) | st.sampled_from(["[[water]]\nx_mm=1", "thickness_mm=nan", "[[delamination]]\nx=1"]))
@settings(max_examples=40, deadline=None)
def test_any_text_is_a_plate_or_one_line(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("plate") / "p.toml"
    path.write_text(text)
    try:
        read_plate(path)
    except AnnulusError as error:
        assert "\n" not in str(error) and str(path) in str(error)
