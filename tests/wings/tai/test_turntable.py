"""Promises of `annulus head turntable`, on the firmware's own code in real time."""

from collections.abc import Iterator

import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.link import operate
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import Move, StopCause, TurntableStop, TurntableStopped
from annulus_pipe.twin.native import NativeBoard
from annulus_pipe.twin.real_time import serving
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.phantoms import Disc
from annulus_pipe.wings.tai.simulated.phantom import RigSetup
from annulus_pipe.wings.tai.simulated.receiver import Receiver
from annulus_pipe.wings.tai.simulated.rig import AcousticRig
from annulus_pipe.wings.tai.simulated.scope import SimulatedScope


@pytest.fixture(scope="module")
def receiver() -> Receiver:
    return Receiver(RigSetup((Disc(0.0, 0.0, 5.0, 0.4),), 9.0, transducer=(0.6e6, 1.2), pulse_v=0.05, noise_v=2e-4))


@pytest.fixture
def port(receiver: Receiver) -> Iterator[str]:
    try:
        board = NativeBoard()
    except AnnulusError as error:
        pytest.skip(str(error))
    bench = AcousticRig(board, receiver, SimulatedScope({}))
    with serving(bench):
        yield bench.port_url


def say(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["head", "turntable", *words])
    return result.exit_code, " ".join((result.output + str(result.exception or "")).split())


def test_it_is_configured_and_turned_within_its_limits(port: str) -> None:
    limits = ("--lowest", "-50", "--highest", "600", "--acceleration", "40000", "--start-us", "2000")
    code, text = say("configure", "--port", port, *limits)
    assert code == 0
    assert "600" in text
    code, text = say("move", "--port", port, "--to", "600", "--step-us", "120")
    assert code == 0
    assert "600" in text
    code, text = say("move", "--port", port, "--to", "601", "--step-us", "120")
    assert code != 0
    assert "position = 601 is out of range" in text
    code, text = say("stop", "--port", port)
    assert code == 0
    assert "600" in text


def test_a_move_that_was_stopped_says_where_and_why(port: str) -> None:
    with Client(port) as client:
        client.request(Move(20_000, 10_000, 0))
        client.request(TurntableStop())
        with pytest.raises(
            AnnulusError, match=r"the turntable stopped at step \d+(, expected 0| because it was told to)$"
        ):
            operate.move_turntable(client, port, 0, 100.0, hold=False)
    assert "may stand elsewhere" in operate.why_it_stopped(TurntableStopped(0, 7, StopCause.FAULT, 1))


def test_an_end_switch_that_is_reached_refuses_the_move_towards_it(port: str) -> None:
    code, _ = say("configure", "--port", port, "--end-high")
    assert code == 0
    code, text = say("move", "--port", port, "--to", "10")  # nothing is wired: high
    assert code != 0
    assert "upper end switch is reached, or its wire is broken" in text
