"""What a laminate's sound loses on its way to a receiver in air, and what codes make up."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.controller import MICROWAVE_DUTY_MAX_PERMILLE
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.budget import (
    SEQUENCES,
    WATER_GRUENEISEN,
    Laminate,
    SingleSidedRig,
    air_absorption_db_m,
    budget,
    code_cost,
    golay,
    m_sequence,
    water_conductivity,
)

ROOT = Path(__file__).resolve().parents[3]
RIG, LAMINATE = SingleSidedRig(), Laminate()


@pytest.mark.parametrize(
    ("frequency_hz", "celsius", "humidity", "db_km"),
    [(1000, 20, 50, 4.66), (4000, 20, 70, 22.9), (8000, 10, 70, 117.0), (10000, 20, 50, 160.0)],
)
def test_air_absorbs_what_the_standard_tabulates(frequency_hz, celsius, humidity, db_km):
    """ISO 9613-1, table 1 (and ISO 9613-2, table 2, which is taken from it)."""
    assert 1000 * air_absorption_db_m(frequency_hz, celsius, humidity) == pytest.approx(db_km, rel=0.02)


def test_terms_are_of_the_size_that_handbooks_have():
    assert abs(WATER_GRUENEISEN - 0.11) < 0.005  # of water at 20 C
    assert water_conductivity() == pytest.approx(1.4, abs=0.1)
    one = budget(RIG, LAMINATE, "water", 8.0)
    air = next(term for term in one.terms if term.name.startswith("solid to air"))
    assert "-34.9 dB in energy" in air.name and air.db == pytest.approx(-75.7, abs=0.2)
    assert one.received_db == pytest.approx(sum(term.db for term in one.terms))
    more = budget(SingleSidedRig(power_w=2 * RIG.power_w), LAMINATE, "water", 8.0)
    assert more.received_db - one.received_db == pytest.approx(20 * math.log10(2))  # pressure follows power


def test_a_golay_pair_has_no_sidelobes_and_an_m_sequence_those_of_one_chip():
    a, b = golay(6)
    total = np.correlate(a, a, "full") + np.correlate(b, b, "full")
    assert total[63] == 128 and np.abs(np.delete(total, 63)).max() == 0
    signs = 2.0 * m_sequence(8) - 1
    around = np.fft.ifft(np.abs(np.fft.fft(signs)) ** 2).real
    assert around[0] == pytest.approx(255) and np.allclose(around[1:], -1)


def test_a_code_gains_in_a_shot_what_it_costs_in_periods():
    """Within the controller's duty: equal time leaves codes a few dB, whatever they gain in a shot."""
    costs = {name: code_cost(name, RIG) for name in SEQUENCES}
    assert costs["single"].gain_db == pytest.approx(0, abs=1e-6)
    assert costs["golay64"].gain_db == pytest.approx(10 * math.log10(64 / 4), abs=0.1)  # sqrt(N)/2 a shot
    assert 15 < costs["m255"].gain_db < 18.1
    for cost in costs.values():
        assert cost.ones * RIG.pulse_s / cost.period_s <= MICROWAVE_DUTY_MAX_PERMILLE / 1000 + 1e-9
        assert 0 <= cost.rate_db + 1e-6 < 7


def test_the_readme_has_what_the_command_prints():
    done = CliRunner().invoke(app, ["tai", "budget"])
    assert done.exit_code == 0
    readme = (ROOT / "host/annulus_pipe/wings/tai/README.md").read_text()
    assert done.stdout.strip() in readme


def test_a_rig_that_cannot_be_is_one_line():
    with pytest.raises(AnnulusError, match="depth 30"):
        budget(RIG, LAMINATE, "water", 30.0)
    fields = json.loads(CliRunner().invoke(app, ["tai", "budget", "--json"]).stdout)
    assert {one["kind"] for one in fields["budgets"]} == {"delamination", "water"}
    with pytest.raises(AnnulusError, match="stand-off"):
        SingleSidedRig(standoff_mm=0.0)
