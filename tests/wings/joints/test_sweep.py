"""Resonances of probes: found within their sigma on circuits drawn as circuits, and files read as they were written."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.sweeps import resonance
from annulus_pipe.wings.joints.sweep_file import read_sweep
from annulus_pipe.wings.joints.sweeps import compare_sweeps

SRR_HZ, CAPACITIVE_HZ = 2.4e9, 4.5e6  # the source's two (§9.7)


def reflection(f: np.ndarray, f0: float, quality: float, coupling: float) -> np.ndarray:
    """S11 of a series circuit of R, L and C at a line of 50 ohm, by its impedance. quality : loaded with the line."""
    resistance = 50.0 / coupling
    inductance = quality * (resistance + 50.0) / (2 * np.pi * f0)
    impedance = resistance + 2j * np.pi * inductance * (f - f0**2 / f)
    return np.asarray((impedance - 50) / (impedance + 50))


def sweep(f0: float, quality: float, seed: int, noise: float = 0.01, count: int = 201) -> tuple[np.ndarray, np.ndarray]:
    centre = f0 * (1 + 0.3 / quality)
    f = np.linspace(centre * (1 - 3 / quality), centre * (1 + 3 / quality), count)
    return f, np.abs(reflection(f, f0, quality, 0.6)) + np.random.default_rng(seed).normal(0, noise, count)


@pytest.mark.parametrize(("f0", "quality"), [(SRR_HZ, 40.0), (CAPACITIVE_HZ, 25.0)])
def test_a_resonance_lies_within_its_sigma(f0: float, quality: float) -> None:
    off = []
    for seed in range(40):
        found = resonance(*sweep(f0, quality, seed))
        off.append((found.f0_hz - f0) / found.f0_sigma_hz)
        assert found.f0_sigma_hz < 3e-3 * f0 / quality * 3
        assert found.quality == pytest.approx(quality, rel=0.15)
    assert np.mean(np.abs(off) < 2) > 0.85


@pytest.mark.parametrize("seed", range(20))
def test_no_resonance_is_reported_where_there_is_none(seed: int) -> None:
    f = np.linspace(2.2e9, 2.6e9, 201)
    flat = 0.8 - 0.1 * (f - f[0]) / (f[-1] - f[0]) + np.random.default_rng(seed).normal(0, 0.01, len(f))
    assert np.isnan(resonance(f, flat).f0_hz)


@settings(max_examples=40, deadline=None)
@given(
    values=st.lists(st.tuples(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9)), min_size=2, max_size=8),
    ports=st.sampled_from([1, 2]),
    unit=st.sampled_from([("Hz", 1.0), ("MHz", 1e6), ("GHz", 1e9)]),
    form=st.sampled_from(["RI", "MA", "DB"]),
)
def test_touchstone_comes_in_as_it_was_written(
    values: list[tuple[float, float]],
    ports: int,
    unit: tuple[str, float],
    form: str,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    s = np.array([complex(a, b) if abs(complex(a, b)) > 1e-3 else 0.5 for a, b in values])
    pairs = {
        "RI": np.stack([s.real, s.imag], axis=1),
        "MA": np.stack([np.abs(s), np.degrees(np.angle(s))], axis=1),
        "DB": np.stack([20 * np.log10(np.abs(s)), np.degrees(np.angle(s))], axis=1),
    }[form]
    lines = ["! made for a test", f"# {unit[0]} S {form} R 50"]
    for k, (a, b) in enumerate(pairs):
        row = [1.0 + k, a, b] if ports == 1 else [1.0 + k, 0.1, 0.2, a, b, 0.3, 0.4, 0.5, 0.6]
        lines.append(" ".join(f"{v:.12g}" for v in row) + " ! a remark")
    path = tmp_path_factory.mktemp("sweep") / f"x.s{ports}p"
    path.write_text("\n".join(lines))
    f, magnitude = read_sweep(path, "s21" if ports == 2 else "s11")
    assert f == pytest.approx(unit[1] * (1.0 + np.arange(len(s))))
    assert magnitude == pytest.approx(np.abs(s), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("a.s1p", "# GHz S MA R 50\n1 0.5\n", "line 2: expected 3 numbers"),
        ("a.s1p", "# GHz Z MA R 50\n1 0.5 0\n", "z parameters, expected s"),
        ("a.s1p", "[Version] 2.0\n", "expected Touchstone version 1"),
        ("a.csv", "f,m\n1,2\n", "expected frequency_hz and magnitude"),
        ("a.csv", "frequency_hz,magnitude\n1,2,3\n", "line 2"),
        ("a.csv", "frequency_hz,magnitude\n1e9,x\n", "line 2: expected a frequency"),
    ],
)
def test_what_is_no_sweep_is_one_line(tmp_path: Path, name: str, text: str, why: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(AnnulusError, match=why):
        read_sweep(tmp_path / name)


@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=120), suffix=st.sampled_from(["s1p", "s2p", "csv"]))
def test_whatever_a_file_holds_is_a_sweep_or_one_line(
    data: bytes, suffix: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"wild.{suffix}"
    path.write_bytes(data)
    try:
        f, magnitude = read_sweep(path)
    except AnnulusError as error:
        assert "\n" not in str(error)
    else:
        assert f.shape == magnitude.shape


def test_points_in_air_and_on_a_dogbone_say_what_moved(tmp_path: Path) -> None:
    rows = ["point,file,z_mm"]
    for k, (name, f0) in enumerate((("air", 2.4e9), ("plain", 2.33e9), ("bead", 2.31e9), ("plain again", 2.33e9))):
        f = np.linspace(2.2e9, 2.5e9, 201)
        s = np.abs(reflection(f, f0, 40.0, 0.6)) + np.random.default_rng(k).normal(0, 0.005, len(f))
        (tmp_path / f"{k}.csv").write_text(
            "frequency_hz,magnitude\n" + "\n".join(f"{a:.6g},{b:.6g}" for a, b in zip(f, s, strict=True))
        )
        rows.append(f"{name},{k}.csv,{'' if k == 0 else 5 * k}")
    (tmp_path / "points.csv").write_text("\n".join(rows))
    content, files = compare_sweeps(tmp_path / "points.csv", tmp_path / "out", "s11")
    assert [one["moved"] for one in content["points"]] == [None, True, True, True]
    assert content["points"][2]["shift_hz"] == pytest.approx(-90e6, abs=2e6)
    assert json.loads(files[0].read_text())["points"][1]["z_mm"] == 5 and files[1].stat().st_size > 10_000
