"""A certificate's numbers lie in their intervals, a head that got worse is refused, nobody changes a digit of it."""

import json
import math
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.qualification.applicability import Applicability, HeadInUse
from annulus_pipe.qualification.budget import Contribution, budget
from annulus_pipe.qualification.certificate import parse_certificate, read_certificate
from annulus_pipe.qualification.plan import StudyPlan
from annulus_pipe.qualification.precision import components
from annulus_pipe.qualification.signature import sign
from annulus_pipe.qualification.study import certified, compared, power
from annulus_pipe.vocabulary import AnnulusError
from tests.unit.qualification.known_heads import CONDITIONS, DAY, PLAN, PULL, WORLDS, made, readings, signed_file


def coverage(studies: int, seed: int, plan: StudyPlan = PLAN) -> dict[str, FloatArray]:
    """World -> shares of studies whose interval holds the true bias, s_r, s_R."""
    rng, out = np.random.default_rng(seed), {}
    for name, world in WORLDS.items():
        held = np.zeros(3)
        for _ in range(studies):
            errors, warm, mean = world.study(rng, plan)
            accuracy = certified(plan, readings(plan, errors, warm), CONDITIONS, DAY).accuracy
            held += [accuracy.bias.holds(mean), accuracy.s_r.holds(world.s_r), accuracy.s_R.holds(world.s_R)]
        out[name] = held / studies
    return out


def test_numbers_of_known_heads_lie_in_their_intervals() -> None:
    """200 studies of four worlds, by scans of one piece or of all three: 95 % of 600 intervals, give or take 2.7 (three
    standard deviations)."""
    shares = [coverage(25, 1, plan) for plan in (PLAN, PULL)]
    assert 0.923 < np.mean([share for world in shares for share in world.values()]) < 0.977, shares


@pytest.mark.deep(
    gate="tests/unit/qualification/test_certificate.py::test_numbers_of_known_heads_lie_in_their_intervals"
)
def test_numbers_of_known_heads_lie_in_their_intervals_each() -> None:
    for plan in (PLAN, PULL):
        for name, shares in coverage(2000, 3, plan).items():
            assert (shares > 0.93).all() and (shares < 0.975).all(), (plan.one_pull, name, shares)


def refused(studies: int, seed: int) -> tuple[float, float]:
    """Shares of checks that refuse a head as certified, and one that is twice as bad."""
    rng, counts = np.random.default_rng(seed), np.zeros(2)
    for i in range(studies):
        world = list(WORLDS.values())[i % len(WORLDS)]
        errors, warm, _ = world.study(rng, PLAN)
        certificate = certified(PLAN, readings(PLAN, errors, warm), CONDITIONS, DAY)
        for k, later in enumerate((world, world.times(2.0))):
            errors, warm, _ = later.study(rng, PLAN)
            counts[k] += not compared(certificate, PLAN, readings(PLAN, errors, warm), drifting=False).upheld
    good, bad = counts / studies
    return float(good), float(bad)


def test_a_head_twice_as_bad_as_its_certificate_is_refused() -> None:
    good, bad = refused(200, seed=5)
    assert bad >= 0.95 and good <= 0.10, (good, bad)
    alike, each = power(PULL)
    assert power(PLAN) == (each, each) and 0.95 < each < 0.97 and 0.5 < alike < 0.6


def test_what_a_later_diameter_keeps_is_kept_by_19_of_20() -> None:
    """Errors of operators who took no part, over the certified temperatures, within U."""
    rng, inside = np.random.default_rng(7), []
    for i in range(150):
        world = list(WORLDS.values())[i % len(WORLDS)]
        errors, warm, _ = world.study(rng, PLAN)
        accuracy = certified(PLAN, readings(PLAN, errors, warm), CONDITIONS, DAY).accuracy
        later = world.bias + rng.normal(0, world.s_R, 100) + world.slope * (rng.uniform(12.0, 22.0, 100) - 17.0)
        inside.append(np.mean(np.abs(later) <= accuracy.U))
    assert 0.93 < np.mean(inside) < 0.98


def test_the_budget_of_the_guide() -> None:
    """JCGM 100:2008, H.1 (a gauge block, nm): u 32, 16.7 degrees of freedom, t 2.92 at 99 %, printed so."""
    nm = [(25.0, 18.0), (9.7, 25.6), (2.9, 50.0), (16.6, 2.0)]
    made = budget([Contribution(str(u), u, dof, "A", "") for u, dof in nm], 0.0)
    assert round(made.u) == 32 and int(10 * made.dof) / 10 == 16.7
    assert made.dominant is not None and made.dominant.u == 25.0 and sum(made.share) == pytest.approx(1.0)
    assert made.k == pytest.approx(2.1122, abs=2e-4)  # Student's t of 16.76 at 95 %
    far = budget([Contribution("a", 1.0, math.inf, "B", "")], 10.0)
    assert pytest.approx(10.0 + 1.6449, rel=1e-4) == far.U  # far from 0 one side is left


def test_one_operator_says_nothing_of_others() -> None:
    with pytest.raises(ValueError, match="1 operators with 5 repeats each, expected 2"):
        components(np.zeros((3, 1, 5)))


USE = HeadInUse("7", "ab12cd34ef567890", "1.4.0 abc", "0.1.0", 152.5, 15.0, date(2027, 3, 1))


@pytest.mark.parametrize(
    ("change", "standing", "reason"),
    [
        ({}, Applicability.APPLIES, ""),
        ({"day": date(2027, 11, 30)}, Applicability.DOES_NOT, "it lapsed on 2027-11-29"),
        ({"day": date(2026, 11, 1)}, Applicability.DOES_NOT, "after the day of the scan"),
        ({"head": "8"}, Applicability.DOES_NOT, "it is of head 7, and this is 8"),
        ({"calibration": "0" * 16}, Applicability.DOES_NOT, "it is of calibration ab12cd34ef567890"),
        ({"firmware": "1.5.0 abd"}, Applicability.DOES_NOT, "it is of firmware"),
        ({"software": "0.2.0"}, Applicability.DOES_NOT, "it is of software 0.1.0"),
        ({"diameter_mm": 203.0}, Applicability.DOES_NOT, "and the diameter is 203 mm"),
        ({"temperature_c": 40.0}, Applicability.DOES_NOT, "and the temperature is 40 degC"),
        ({"temperature_c": None}, Applicability.OPEN, "the scan has no temperature"),
        ({"firmware": ""}, Applicability.OPEN, "the scan does not say which firmware"),
        ({"head": "8", "firmware": ""}, Applicability.DOES_NOT, "it is of head 7"),
    ],
)
def test_a_certificate_speaks_for_its_head_alone(
    change: dict[str, object], standing: Applicability, reason: str
) -> None:
    found, reasons = made().scope.standing(replace(USE, **change))  # type: ignore[arg-type]
    assert found is standing and (reasons[0].find(reason) >= 0 if reason else not reasons), reasons


def test_nobody_changes_a_digit_of_it(tmp_path: Path) -> None:
    file = signed_file(tmp_path)
    read = read_certificate(file)
    assert read == replace(made(), signature=read.signature) and read.number == made().number and read.is_signed
    data = json.loads(file.read_text())
    for change in (
        lambda content: content["accuracy"].update(U=0.01),
        lambda content: content["scope"].update(until="2036-11-29"),
        lambda content: content["runs"].pop(),
        lambda content: content["operators"].append("C. Cole"),
    ):
        forged = json.loads(json.dumps(data))
        change(forged["content"])
        file.write_text(json.dumps(forged))
        with pytest.raises(AnnulusError, match="not as it was signed: something in it was changed"):
            read_certificate(file)
    for wrong, line in (
        ({**data, "signature": None}, "nobody has signed it"),
        ({**data, "format": "annulus-certificate/9"}, "its format is"),
        ({**data, "number": "000000000000"}, "its number is '000000000000', expected"),
        ({**data, "content": {**data["content"], "more": 1}}, "holds what no certificate of this format has"),
        ({**data, "content": {**data["content"], "accuracy": {}}}, "accuracy.bias must be a mapping"),
        ({**data, "signature": {"algorithm": "Ed25519", "public_key": "zz", "value": ""}}, "64 hexadecimal digits"),
    ):
        with pytest.raises(ValueError, match=line):
            parse_certificate(json.dumps(wrong).encode())
    with pytest.raises(AnnulusError, match="no private key"):
        sign(made().content(), tmp_path / "lab.key.pub")
