"""A probe's readings out of another program's samples, and a detector that is none."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq

from annulus_pipe.sensors.sample import Sample
from annulus_pipe.wings.joints import probe as rooms
from annulus_pipe.wings.joints.probe import ProbeLostError, SampleProbe, VisaProbe


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """A program that says every 5 ms what a probe sees, in V and mV, and of another sensor in between."""
    name, over = f"ipc://{tmp_path}/samples", threading.Event()
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.PUB)
    socket.bind(name)

    def say() -> None:
        while not over.is_set():
            for sensor, values, units in (
                ("supply", {"a": 9.0}, {"a": "V"}),
                ("probe", {"a": 0.3, "p": 88.5, "t": 21.0}, {"a": "V", "p": "mV", "t": "degC"}),
            ):
                body = msgpack.packb(Sample(sensor, time.monotonic_ns(), values, units).to_dict())
                socket.send_multipart([sensor.encode(), body])
            time.sleep(0.005)

    thread = threading.Thread(target=say)
    thread.start()
    yield name
    over.set()
    thread.join()
    context.destroy(linger=0)


def test_samples_are_readings_in_mv_and_younger_than_the_question(
    address: str, stalls: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rooms, "ANSWER_S", 30.0)
    probe = SampleProbe(address, "probe", {"amplitude_mv": "a", "phase_mv": "p"})
    assert probe.read() == {"amplitude_mv": pytest.approx(300.0), "phase_mv": pytest.approx(88.5)}
    asked = time.monotonic()
    probe.read()
    took_s = time.monotonic() - asked
    if stalls.since(asked) < 0.1:
        assert took_s < 1.0
    probe.close()


def test_what_is_no_voltage_or_not_there_is_said(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for sensor, value, said in (
        ("probe", "t", "'degC'"),
        ("probe", "x", "nan"),
        ("nobody", "a", "no sample of 'nobody'"),
    ):
        monkeypatch.setattr(rooms, "ANSWER_S", 0.3 if sensor == "nobody" else 30.0)
        probe = SampleProbe(address, sensor, {"amplitude_mv": value})
        with pytest.raises(ProbeLostError, match=said):
            probe.read()
        probe.close()
    with pytest.raises(ProbeLostError, match="expected a VISA name"):
        VisaProbe("left of the scope", {"amplitude_mv": "?"})
    with pytest.raises(
        ProbeLostError, match=r"127\.0\.0\.1::9"
    ):  # nobody there: told at the opening or the first query
        VisaProbe("TCPIP::127.0.0.1::9::SOCKET", {"amplitude_mv": "?"}).read()
