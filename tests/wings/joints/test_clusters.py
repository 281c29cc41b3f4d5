"""Good and bad dogbones told by joints that had no say: of simulated joints, with and without a relation."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.clusters import leave_one_out

ANGLES = np.arange(8) * 45.0


def smooth(rng: np.random.Generator) -> np.ndarray:
    """(8,) alike with their neighbours, about 0, of size 1."""
    phi = np.radians(ANGLES)
    a, b, c, d = rng.standard_normal(4)
    return np.asarray(a * np.cos(phi) + b * np.sin(phi) + 0.4 * (c * np.cos(2 * phi) + d * np.sin(2 * phi)))


def joints(rng: np.random.Generator, count: int, share: float) -> tuple[np.ndarray, ...]:
    """values (n, 2), good, pipe, angle: bad where strength is low; W follows strength by that share."""
    values, good = [], []
    for _ in range(count):
        strength = smooth(rng)
        w = 6.0 - share * 0.5 * strength + (1 - share) * 0.5 * smooth(rng) + rng.normal(0, 0.05, 8)
        values.append(np.stack([w, 8.0 + 0.3 * smooth(rng)], axis=1))
        good.append(strength > -0.4)
    return np.concatenate(values), np.concatenate(good), np.repeat(np.arange(count), 8), np.tile(ANGLES, count)


@pytest.mark.deep(gate="tests/wings/joints/test_clusters.py::test_one_joint_is_never_told_by_itself")
def test_a_relation_is_told_and_chance_is_not() -> None:
    rng = np.random.default_rng(1)
    found = leave_one_out(*joints(rng, 8, 0.9))
    assert found.balanced > 0.8
    assert found.p <= 0.01
    fired = np.mean([leave_one_out(*joints(rng, 6, 0.0), seed=k, dealt=99).p <= 0.05 for k in range(60)])
    assert fired <= 0.15  # 60 studies of nothing: 5 % and three sigma


def test_one_joint_is_never_told_by_itself() -> None:
    """A feature that is right within every joint, about a level of its own, tells nothing across joints."""
    rng = np.random.default_rng(2)
    values, good, pipe, angle = joints(rng, 6, 1.0)
    values[:, 0] += np.repeat(rng.normal(0, 5.0, 6), 8)
    values[:, 1] = values[:, 0] * 0.1 + rng.normal(0, 0.01, 48)
    assert leave_one_out(values, good, pipe, angle).balanced < 0.75


def test_too_few_is_said() -> None:
    values, good, pipe, angle = joints(np.random.default_rng(3), 2, 1.0)
    with pytest.raises(AnnulusError, match="2 joints, expected 3"):
        leave_one_out(values, good, pipe, angle)
    values, good, pipe, angle = joints(np.random.default_rng(3), 3, 1.0)
    with pytest.raises(AnnulusError, match="expected good and bad"):
        leave_one_out(values, np.ones_like(good), pipe, angle)
    values[4, 0] = np.nan
    with pytest.raises(AnnulusError, match="1 dogbones where a feature is not told"):
        leave_one_out(values, good, pipe, angle)


@pytest.mark.deep(gate="tests/wings/joints/test_clusters.py::test_one_joint_is_never_told_by_itself")
def test_the_command_from_folders_to_a_verdict(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    values, good, pipe, angle = joints(rng, 6, 1.0)
    phi = np.arange(0, 360, 1.0)
    for number in range(6):
        (tmp_path / f"joint-{number}").mkdir()
        w, t = (np.interp(phi, [*ANGLES, 360], [*one, one[0]]) for one in values[pipe == number].T)
        features = {"phi_deg": phi.tolist(), "W": w.tolist(), "T": t.tolist()}
        (tmp_path / f"joint-{number}" / "features.json").write_text(json.dumps(features))
    table = tmp_path / "dogbones.csv"
    rows = [f"joint-{p},{a:g},{'good' if g else 'bad'}" for p, a, g in zip(pipe, angle, good, strict=True)]
    table.write_text("joint,angle_deg,result\n" + "\n".join(rows))
    done = CliRunner().invoke(app, ["joint", "classify", str(table), "-o", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert (told["verdict"], told["balanced"] > 0.8) == ("told", True)
    assert (tmp_path / "out" / "clusters.png").stat().st_size > 10_000
    for text, said in (
        ("joint,angle_deg\na,1", "no column result"),
        ("joint,angle_deg,result\njoint-0,0,fair", "line 2: result is 'fair'"),
        ("joint,angle_deg,result\njoint-0,x,good", "line 2: angle_deg"),
        ("joint,angle_deg,result\nnowhere,0,good", "no such file"),
    ):
        table.write_text(text)
        with pytest.raises(AnnulusError, match=said):
            CliRunner().invoke(app, ["joint", "classify", str(table), "-o", str(tmp_path)], catch_exceptions=False)
