"""Light through dogbones, drawn by Beer-Lambert: shifts, absorbance and alpha against what was put in."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.transmission import against_strengths, transmission

Z = np.arange(0.0, 40.0, 0.25)
SHIFT = np.array([0.9, -0.6, 0.2, -1.4, 1.1, 0.0, -0.7, 0.5])
DEPTH = np.array([0.08, 0.1, 0.09, 0.13, 0.18, 0.12, 0.09, 0.1])
WALL = np.array([5.5, 5.6, 5.75, 5.7, 5.62, 5.5, 5.45, 5.52])
ALPHA = 0.4


def lines(
    rng: np.random.Generator, depth: np.ndarray = DEPTH, noise: float = 0.01, groove: float = 0.3
) -> tuple[np.ndarray, np.ndarray]:
    """(n, Z) mV, and thickness (n, Z) of the aligned lines: a groove at one end."""
    thickness = WALL[:, None] - groove * (Z[None, :] > 33.0)
    joint = np.exp(-(((Z[None, :] - 20.0 - SHIFT[:, None]) / 3.0) ** 4))
    own = WALL[:, None] - groove * (Z[None, :] - SHIFT[:, None] > 33.0)
    clean = 60.0 * np.exp(-ALPHA * own - depth[:, None] * joint)
    return clean * (1 + noise * rng.standard_normal(clean.shape)), thickness


def test_lines_are_aligned_and_the_joints_absorbance_told() -> None:
    mv, _ = lines(np.random.default_rng(3), groove=0.0)
    found = transmission(Z, mv)
    off = found.shift_mm - (SHIFT - SHIFT.mean())
    assert np.abs(off).max() < 3 * found.shift_sigma_mm.max() < 0.5
    within = Z[found.inside] - 20.0 - SHIFT.mean()
    true = DEPTH * np.exp(-((within / 3.0) ** 4)).mean()
    np.testing.assert_allclose(found.depth, true, atol=4 * found.depth_sigma.max())
    assert (np.abs(found.gradient[:, found.inside]).max(axis=1) > found.plain_gradient).all()


def test_thickness_is_taken_out_where_alpha_is_told() -> None:
    mv, thickness = lines(np.random.default_rng(4))
    found = transmission(Z, mv, thickness)
    assert found.alpha == pytest.approx(ALPHA, abs=3 * found.alpha_sigma)
    assert found.thickness_out
    thin = (found.z_mm > 35.0) & (found.z_mm < 38.0)
    left, without = found.absorbance[:, thin].mean(), transmission(Z, mv).absorbance[:, thin].mean()
    assert abs(left) < 0.25 * abs(without)


def test_what_shows_no_joint_is_refused() -> None:
    mv, _ = lines(np.random.default_rng(5), 0 * DEPTH)
    for wrong, said in (
        ((Z, mv[:, :] * 0 + 5 + np.random.default_rng(6).normal(0, 0.05, mv.shape)), "no joint"),
        ((Z, mv - 100), "0 mV or less"),
        ((Z**1.1, mv), "uneven steps"),
        ((Z[:30], mv[:, :30]), "lines of 7.25 mm"),
    ):
        with pytest.raises(AnnulusError, match=said):
            transmission(*wrong)


def test_strengths_are_asked_no_finer_than_dogbones_can_answer() -> None:
    r, as_good, least = against_strengths(DEPTH, -DEPTH)
    assert (r, as_good, least) == (pytest.approx(-1.0), pytest.approx(1 / 16), 1 / 16)
    with pytest.raises(AnnulusError, match="all alike"):
        against_strengths(DEPTH, np.ones(8))


def test_the_command_writes_numbers_and_names_what_is_wrong(tmp_path: Path) -> None:
    mv, _ = lines(np.random.default_rng(7))
    head = "z_mm," + ",".join(f"dogbone_{45 * k}" for k in range(8))
    rows = [",".join(f"{v:.4f}" for v in (z, *one)) for z, one in zip(Z, mv.T, strict=True)]
    good, strength = tmp_path / "ots.csv", tmp_path / "strength.csv"
    good.write_text("\n".join([head, *rows]))
    strength.write_text("angle_deg,energy_j\n" + "\n".join(f"{45 * k},{30 - 80 * d:.2f}" for k, d in enumerate(DEPTH)))
    run = CliRunner().invoke
    done = run(app, ["joint", "transmission", str(tmp_path / "out"), str(good), "--strength", str(strength)])
    assert done.exit_code == 0, done.output
    assert "r -0.9" in done.output
    assert (tmp_path / "out" / "transmission.png").stat().st_size > 10_000
    bad = tmp_path / "bad.csv"
    for text, said in (
        (head.replace("z_mm", "z") + "\n" + rows[0], "expected z_mm"),
        (head.replace("dogbone_90", "left") + "\n" + rows[0], "column 'left'"),
        (head + "\n" + rows[0] + "\n" + rows[1].replace(".", "x"), "line 3"),
        (head + "\n" + rows[0], "1 places"),
    ):
        bad.write_text(text)
        with pytest.raises(AnnulusError, match=said):
            run(app, ["joint", "transmission", str(tmp_path / "o"), str(bad)], catch_exceptions=False)
    strength.write_text("angle_deg,energy_j\n" + "\n".join(f"{40 * k},{k}" for k in range(8)))
    with pytest.raises(AnnulusError, match="has not the 8 dogbones"):
        run(
            app,
            ["joint", "transmission", str(tmp_path / "o"), str(good), "--strength", str(strength)],
            catch_exceptions=False,
        )
    with pytest.raises(AnnulusError, match=r"maps\.npz"):
        run(app, ["joint", "transmission", str(tmp_path), str(good), "--zero-deg", "0"], catch_exceptions=False)
