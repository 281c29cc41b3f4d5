"""Promises of the scope's driver, over TCP through PyVISA, against an instrument that speaks SCPI and misbehaves."""

import contextlib
import socket
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from annulus_pipe.twin.line import TcpLine
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.digitizer import Acquisition, DigitizerLostError, ScopeDigitizer, TriggerLostError
from annulus_pipe.wings.tai.simulated import scope as twin
from annulus_pipe.wings.tai.simulated.scope import SimulatedScope

WANTED = Acquisition(rate_hz=10e6, duration_s=64e-6, range_v=0.4, averages=4, delay_s=2e-6)


@contextlib.contextmanager
def served(scope: SimulatedScope, volts: float | None = 0.1) -> Iterator[str]:
    """The scope on a socket, triggered as often as it waits; volts None: nobody triggers."""
    line, over = TcpLine(), threading.Event()

    def serve() -> None:
        arrivals = 0
        while not over.is_set():
            heard = line.read()
            if line.arrivals != arrivals:
                arrivals = line.arrivals
                scope.connect()
            if volts is not None and scope.waits:
                scope.record(volts * np.cos(np.arange(scope.window()[2]) / 20))
            answer = scope.receive(heard)
            while answer:
                answer = answer[line.write(answer) :]
            if scope.hang_up:
                line.hang_up()
            time.sleep(5e-4)
        line.close()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield line.url.replace("socket://", "TCPIP::").replace("1:", "1::") + "::SOCKET"
    finally:
        over.set()
        thread.join()


def opened(resource: str) -> ScopeDigitizer:
    return ScopeDigitizer(resource, settle_s=0.0, answer_s=30.0)


@contextlib.contextmanager
def impatient(scope: ScopeDigitizer) -> Iterator[None]:
    """While an answer is asked for that will not come."""
    scope._answer_s, scope._session.timeout = 0.25, 250
    yield
    scope._answer_s = 30.0  # .. of the session that `recover` opens
    scope._session.timeout = 30_000


def test_volts_rate_and_time_are_those_of_the_signal() -> None:
    with served(SimulatedScope()) as resource, opened(resource) as scope:
        assert "DSO-X 4052A" in scope.name
        scope.configure(WANTED)
        for _ in range(2):
            scope.arm()
            trace = scope.read()
            assert len(trace.volts) == 1000  # the most it returns of an average
            assert trace.rate_hz == pytest.approx(1000 / 64e-6) and trace.rate_hz >= WANTED.rate_hz
            assert trace.t0_s == pytest.approx(2e-6, abs=1e-12)
            assert np.abs(trace.volts - 0.1 * np.cos(np.arange(1000) / 20)).max() <= 0.51 * 0.4 / 256
            assert trace.clipped == 0


def test_a_single_shot_may_be_longer() -> None:
    with served(SimulatedScope()) as resource, opened(resource) as scope:
        scope.configure(Acquisition(rate_hz=50e6, duration_s=64e-6, range_v=0.4))
        scope.arm()
        assert len(scope.read().volts) == 5000


def test_what_is_beyond_the_range_is_said_to_be_clipped() -> None:
    with served(SimulatedScope(), volts=0.21) as resource, opened(resource) as scope:
        scope.configure(WANTED)
        scope.arm()
        trace = scope.read()
        loud = np.abs(0.21 * np.cos(np.arange(1000) / 20)) > 0.2
        assert 0.8 * loud.sum() < trace.clipped <= 1.2 * loud.sum()


def test_a_hole_is_no_number() -> None:
    with served(SimulatedScope({0: "hole"})) as resource, opened(resource) as scope:
        scope.configure(WANTED)
        scope.arm()
        assert np.flatnonzero(np.isnan(scope.read().volts)).tolist() == list(range(500, 520))


def test_triggers_that_never_come_are_one_clear_line_and_it_can_be_used_again() -> None:
    with served(SimulatedScope({0: "deaf"})) as resource, opened(resource) as scope:
        scope.configure(WANTED)
        scope.arm()
        with (
            impatient(scope),
            pytest.raises(TriggerLostError, match=r"waits for a trigger 0\.25 s after the last of 4 was sent"),
        ):
            scope.read()
        scope.recover()
        scope.arm()
        assert len(scope.read().volts) == 1000


@pytest.mark.parametrize(
    "fault, error, says",
    [
        ("hang", TriggerLostError, "waits for a trigger"),  # cannot be told from it
        ("drop", DigitizerLostError, "no answer"),
        ("short", DigitizerLostError, "no answer"),
        ("huge", DigitizerLostError, r"a block of 999999999 bytes, expected 2000"),
        ("nonsense", DigitizerLostError, "preamble .* expected ten numbers"),
    ],
)
def test_a_scope_that_misbehaves_is_one_line_and_comes_back(fault: str, error: type[Exception], says: str) -> None:
    with served(SimulatedScope({0: fault})) as resource, opened(resource) as scope:
        scope.configure(WANTED)
        scope.arm()
        with impatient(scope), pytest.raises(error, match=says) as raised:
            scope.read()
        assert "\n" not in str(raised.value)
        scope.recover()
        scope.arm()
        assert np.isfinite(scope.read().volts).all()


@pytest.mark.parametrize(
    "preamble",
    [
        "1,2,3",
        "+1,2,1E9,4,6E-8,0,0,1E-6,0,32768",
        "+0,2,1000,4,6.4E-8,0,0,1E-6,0,32768",
        "+1,2,1000,4,-6.4E-8,0,0,1E-6,0,32768",
        "+1,2,1000,4,6.4E-8,nan,0,1E-6,0,32768",
        "+1,2,1000,4,6.4E-6,0,0,1E-6,0,32768",
        "+1,2,1000.5,4,6.4E-8,0,0,1E-6,0,32768",
        "x" * 5000,
    ],
)
def test_a_preamble_is_not_believed(preamble: str, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = SimulatedScope._answer

    def lying(self: SimulatedScope, name: str) -> bytes:
        return preamble.encode() + b"\n" if name == ":WAVEFORM:PREAMBLE" else answer(self, name)

    monkeypatch.setattr(SimulatedScope, "_answer", lying)
    with served(SimulatedScope()) as resource, opened(resource) as scope:
        scope.configure(WANTED)
        scope.arm()
        with pytest.raises(DigitizerLostError):
            scope.read()


def test_a_refused_setting_is_said_in_the_scopes_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(twin._LIMITS, ":CHANNEL1:RANGE", (8e-3, 0.1))
    with (
        served(SimulatedScope()) as resource,
        opened(resource) as scope,
        pytest.raises(AnnulusError, match="acquisition: -222"),
    ):
        scope.configure(WANTED)


def test_somebody_else_or_nobody_there_is_one_line() -> None:
    with (
        served(SimulatedScope(name="ACME,TOASTER,1,1")) as resource,
        pytest.raises(AnnulusError, match="'ACME,TOASTER,1,1'"),
    ):
        opened(resource)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        nobody = f"TCPIP::127.0.0.1::{free.getsockname()[1]}::SOCKET"
        with pytest.raises(DigitizerLostError, match=nobody):
            opened(nobody)
    with pytest.raises(AnnulusError, match="expected a VISA name"):
        opened("my scope")


@pytest.mark.parametrize("change", [{"rate_hz": 0.0}, {"duration_s": float("nan")}, {"averages": 0}, {"range_v": 1e3}])
def test_an_acquisition_that_makes_no_sense_is_refused(change: dict[str, float]) -> None:
    wanted = {"rate_hz": 1e7, "duration_s": 1e-4, "range_v": 1.0} | change
    with pytest.raises(AnnulusError, match=next(iter(change))):
        Acquisition(**wanted)
