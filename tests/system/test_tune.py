"""Promises of tuning: the simulated head in real time, whose head.toml says a readout that is 3 ms too long."""

from dataclasses import replace
from pathlib import Path

import pytest
from test_control import until
from test_operating import run

from annulus_pipe.daemon.config import LampConfig, SocketConfig, load_config
from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.daemon.session import Session
from annulus_pipe.daemon.state import State
from annulus_pipe.daemon.tuning import Cancelled, tune
from annulus_pipe.demo import demo_config
from annulus_pipe.twin.head import start_head
from annulus_pipe.twin.worlds import demo_world

pytestmark = [
    pytest.mark.alone,
    pytest.mark.deep(gate="tests/unit/console/test_tuning.py::test_what_is_proposed_is_told_to_all"),
]

WORLD = demo_world(travel_mm=330.0).scaled(208)
WRONG_US = 3000.0


def test_the_true_window_is_found_and_lamps_come_back(tmp_path: Path) -> None:
    with start_head(WORLD, 15.0, seed=5, speed_mm_s=0.0) as head:
        true = head.timing
        demo_config(head, WORLD, tmp_path)
        told = (tmp_path / "head.toml").read_text()
        right, wrong = (f"readout_us = {true.readout_us + more:.1f}" for more in (0.0, WRONG_US))
        (tmp_path / "head.toml").write_text(told.replace(right, wrong))
        config = replace(
            load_config(tmp_path / "head.toml"),
            calibration=None,
            autostart=False,
            publish=SocketConfig(f"ipc://{tmp_path}/publish"),
            control=SocketConfig(f"ipc://{tmp_path}/control"),
        )
        former, publish = config.lamps, f"ipc://{tmp_path}/publish"

        def operate(client: ControlClient, session: Session) -> None:
            assert session.config.timing.closes_us == pytest.approx(true.closes_us - WRONG_US)
            found = tune(client, publish, "led")
            proposal = found.proposal
            assert abs(proposal.opens_us - true.opens_us) < 100.0
            assert abs(proposal.closes_us - true.closes_us) < 100.0
            assert proposal.banding is not None and proposal.banding < 0.02
            true.check_flash(proposal.delay_us, proposal.width_us)
            assert any("readout_us is" in line and "too large" in line for line in found.remarks)
            assert (session.state, session.config.lamps) == (State.IDLE, former)

            tried: list[LampConfig] = []

            def enough() -> bool:
                if session.config.lamps != former:
                    tried.append(session.config.lamps)
                return len(tried) > 0

            with pytest.raises(Cancelled):
                tune(client, publish, "projector", cancelled=enough)
            assert tried and (session.state, session.config.lamps) == (State.IDLE, former)
            assert head.counters()["lamps_on"] == []

            # killed in the middle: nobody asks for more, nobody stops it
            client.trial(2.0)
            client.lamps(commit=True, trial=True, led_delay_us=0.0)
            assert session.config.lamps != former
            until(lambda: session.state is State.IDLE)
            assert session.config.lamps == former and head.counters()["lamps_on"] == []

        run(config, operate)
