"""Do features go with strengths: how often chance is believed, what is found, what is refused."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.distance import distance_correlation
from annulus_pipe.wings.joints.measure.statistics import Search, Strengths, correlate, moving_mean, power

PHI = np.arange(360.0)
ANGLES = np.arange(8) * 45.0
COARSE = Search(step_deg=20.0)  # to be quick


def round_the_pipe(rng: np.random.Generator, alike_deg: float) -> FloatArray:
    wave = np.fft.rfft(rng.standard_normal(360)) * np.exp(-0.5 * (np.arange(181) * np.radians(alike_deg)) ** 2)
    return np.asarray(np.fft.irfft(wave, 360))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("alike_deg", [0.0, 40.0])
def test_chance_is_believed_as_often_as_is_said_and_the_ordinary_p_far_more_often(alike_deg: float) -> None:
    rng = np.random.default_rng(5)
    p, ordinary = [], []
    for study in range(200):
        feature = moving_mean(PHI, round_the_pipe(rng, alike_deg), 20.0)
        strengths = Strengths(ANGLES, round_the_pipe(rng, alike_deg)[::45])
        (one,) = correlate({"W": feature}, strengths, COARSE, surrogates=59, seed=study)
        p.append(one.p)
        ordinary.append(one.ordinary_p)
    assert np.mean(np.array(p) <= 0.05) < 0.10  # 0.05 +- 0.016
    assert np.mean(np.array(p) <= 0.5) == pytest.approx(0.5, abs=0.12)
    assert np.mean(np.array(ordinary) < 0.05) > 0.3


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("shift", "sense"), [(20.0, 1), (-30.0, -1)])
def test_what_follows_the_feature_is_found_where_it_is(shift: float, sense: int) -> None:
    rng = np.random.default_rng(2)
    feature = moving_mean(PHI, round_the_pipe(rng, 0.0), 20.0)
    other = moving_mean(PHI, round_the_pipe(rng, 0.0), 20.0)
    angles = np.arange(16) * 22.5  # with eight, a wrong place does as well
    energy = 20 - 30 * np.interp(sense * angles + shift, PHI, feature, period=360)
    one, unlike = correlate({"W": feature, "T": other}, Strengths(angles, energy), Search(), surrogates=199)
    assert (one.shift_deg, one.sense) == (shift, sense)
    assert one.r == pytest.approx(-1.0, abs=0.02)
    assert one.p_all <= 0.05 < unlike.p_all
    assert not one.related  # too wide a search for that; with the zero known:
    known = correlate({"W": feature}, Strengths(angles, energy), Search(0.0, senses=(sense,)), surrogates=99)[0]
    assert not known.related  # it is not where it was said to be
    moved = np.roll(feature, -round(shift)) if sense > 0 else np.roll(feature[::-1], 1 + round(shift))
    assert correlate({"W": moved}, Strengths(angles, energy), Search(0.0, senses=(1,)), surrogates=99)[0].related
    assert one.p <= one.p_all
    assert one.least_p >= 1 / 200


def test_a_feature_that_is_one_wave_can_tell_nothing_when_the_zero_is_unknown() -> None:
    strengths = Strengths(ANGLES, np.cos(np.radians(ANGLES)))
    (one,) = correlate({"W": np.cos(np.radians(PHI))}, strengths, Search(), surrogates=199)
    assert abs(one.r) > 0.999
    assert one.least_p > 0.3
    assert not one.related


def test_the_search_costs_power() -> None:
    feature = moving_mean(PHI, round_the_pipe(np.random.default_rng(1), 0.0), 20.0)
    known, related = power(feature, ANGLES, Search(0.0, senses=(1,)), studies=100)
    assert known == pytest.approx(0.72, abs=0.15)
    assert 0.3 < related <= known
    sought, _ = power(feature, ANGLES, COARSE, studies=50)
    assert sought < 0.6 * known


def test_one_deep_sector_in_both_is_never_called_related_where_the_zero_is_unknown() -> None:
    rng = np.random.default_rng(8)
    told = []
    for study in range(40):
        at = rng.uniform(0, 360, 2)
        one, other = (-np.exp(-0.5 * (((PHI - a + 180) % 360 - 180) / 28.0) ** 2) for a in at)
        energy = other[::45] + 0.05 * rng.standard_normal(8)
        found = correlate({"W": one}, Strengths(ANGLES, energy), Search(step_deg=4.0), surrogates=59, seed=study)[0]
        told.append(found.p <= 0.05)
        assert not found.related
        assert found.least_p_rotated > 0.05
    assert np.mean(told) > 0.1  # what the phases alone would have believed


GOLDEN = Path(__file__).resolve().parents[2] / "data/dcor.json"  # made by the test that asks dcor itself
DCOR = """
import json, sys
import dcor, numpy as np
asked = [(np.array(case["values"]), np.array(case["many"])) for case in json.load(sys.stdin)]
print(json.dumps([[float(dcor.u_distance_correlation_sqr(one, values)) for one in many] for values, many in asked]))
"""  # in a process of its own: it launches numba's threads, and then nobody may say how many


def test_the_distance_correlation_is_that_of_dcor() -> None:
    for case in json.loads(GOLDEN.read_text(encoding="utf-8")):
        ours = distance_correlation(np.array(case["many"]), np.array(case["values"]))
        assert ours == pytest.approx(np.array(case["dcor"]), abs=1e-9)
        assert ours[0] == pytest.approx(1) and ours[2] == 0  # a straight line, and what never changes


@pytest.mark.deep(gate="tests/wings/joints/test_statistics.py::test_the_distance_correlation_is_that_of_dcor")
def test_dcor_still_says_what_is_kept_of_it() -> None:
    cases = GOLDEN.read_text(encoding="utf-8")
    ran = subprocess.run([sys.executable, "-c", DCOR], input=cases, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    for case, theirs in zip(json.loads(cases), json.loads(ran.stdout), strict=True):
        assert case["dcor"] == pytest.approx(theirs, abs=1e-12)


def test_a_bent_relation_is_seen_by_distance_and_chance_by_neither() -> None:
    rng = np.random.default_rng(8)
    fired, bent = [], []
    for seed in range(60):
        feature = round_the_pipe(rng, 8.0)
        at = np.arange(0, 360, 22.5)
        for told, energy in ((fired, rng.normal(size=16)), (bent, np.interp(at, PHI, feature, period=360) ** 2)):
            (one,) = correlate({"W": feature}, Strengths(at, energy), Search(0.0, senses=(1,)), 199, seed)
            told.append((one.distance_p <= 0.05, one.p <= 0.05))
    assert np.mean(fired, axis=0) == pytest.approx([0.05, 0.05], abs=0.08)
    by_distance, by_r = np.mean(bent, axis=0)
    assert by_distance > 0.6 and by_distance > by_r + 0.2


def test_a_mean_goes_round_the_circle_and_over_what_is_not_told() -> None:
    step = np.where((PHI < 10) | (PHI >= 350), 1.0, 0.0)
    assert moving_mean(PHI, step, 40.0)[[0, 180]] == pytest.approx([0.5, 0.0], abs=0.02)
    gap = np.where(np.abs(PHI - 90) < 5, np.nan, np.sin(np.radians(PHI)))
    assert moving_mean(PHI, gap, 1.0) == pytest.approx(np.sin(np.radians(PHI)), abs=0.01)
    for bad, word in ((np.where(PHI < 90, np.nan, step), "told at 75 %"), (np.ones(360), "the same at all angles")):
        with pytest.raises(AnnulusError, match=word):
            moving_mean(PHI, bad, 20.0)


@pytest.fixture
def joint(tmp_path: Path) -> Path:
    rng = np.random.default_rng(4)
    curves = {name: list(round_the_pipe(rng, 5.0)) for name in ("W", "T")}
    (tmp_path / "features.json").write_text(json.dumps({"phi_deg": list(PHI), **curves}))
    return tmp_path


GOOD = "angle_deg,energy_j,result\n" + "".join(f"{a:g},{20 + (a * 7) % 11:g},good\n" for a in ANGLES)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "no column angle_deg and energy_j"),
        ("angle_deg,result\n0,good\n", "no column energy_j"),
        (GOOD.replace("90,", "nan,"), "line 4: angle_deg is 'nan', expected a number"),
        (GOOD.replace("45,", "forty,"), "line 3: angle_deg is 'forty', expected a number"),
        (GOOD + "12\n", "line 10: 1 cell, expected 3 as line 1 has"),
        ("\n".join(GOOD.split("\n")[:2]), "1 dogbones, expected at least 5"),
        ("\n".join(GOOD.split("\n")[:3]), "2 dogbones, expected at least 5"),
        (GOOD.replace("315,", "415,"), "angle 415, expected degrees from 0 to 360"),
        ("angle_deg,energy_j\n" + "".join(f"{i * 0.78},{i % 3}\n" for i in range(8)), "not radians"),
        (GOOD.replace("315,", "360,"), "angle 0 is there twice"),
        ("angle_deg,energy_j\n" + "".join(f"{a},21.5\n" for a in ANGLES), "all strengths are 21.5"),
    ],
)
def test_strengths_that_say_nothing_are_refused_in_one_line(joint: Path, text: str, word: str) -> None:
    path = joint / "strength.csv"
    path.write_text(text)
    with pytest.raises(AnnulusError) as caught:
        CliRunner().invoke(app, ["joint", "correlate", str(joint), str(path)], catch_exceptions=False)
    assert str(path) in str(caught.value)
    assert word in str(caught.value)
    assert "\n" not in str(caught.value)
