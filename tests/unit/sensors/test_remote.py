"""Promises about samples from another process: what is no sample is counted, and nobody waits."""

import time
from collections.abc import Iterator
from typing import Any

import msgpack
import pytest
import zmq

from annulus_pipe.sensors.remote import SAMPLE_MAX, SENSORS_MAX, RemoteSensors
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.vocabulary import AnnulusError


class Server:
    def __init__(self, address: str) -> None:
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.PUB)
        self.socket.bind(address)
        self.address = self.socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def say(self, sensor: str = "imu", name: str | None = None, **changes: Any) -> None:
        body = {**Sample(sensor, time.monotonic_ns(), {"roll_deg": 1.0}, {"roll_deg": "deg"}).to_dict(), **changes}
        self.socket.send_multipart([(name or sensor).encode(), msgpack.packb(body)])

    def close(self) -> None:
        self.context.destroy(linger=0)


@pytest.fixture
def server(tmp_path) -> Iterator[Server]:
    server = Server(f"ipc://{tmp_path}/sensors")
    yield server
    server.close()


def heard(server: Server, sensors: RemoteSensors) -> None:
    """Until the subscription has arrived."""
    end = time.monotonic() + 30.0
    while not sensors.poll():
        assert time.monotonic() < end, "nothing is heard"
        server.say("hello")
        time.sleep(0.01)


def until(sensors: RemoteSensors, count: int, malformed: int = 0) -> list[Sample]:
    """So many, and so many that are none; hellos may still come."""
    samples: list[Sample] = []
    end = time.monotonic() + 30.0
    while (len(samples) < count or sensors.malformed < malformed) and time.monotonic() < end:
        samples += [sample for sample in sensors.poll() if sample.sensor != "hello"]
    return samples


def test_samples_come_in_order_and_what_is_none_is_counted(server: Server) -> None:
    sensors = RemoteSensors(server.address)
    heard(server, sensors)
    server.say("imu", values={"roll_deg": float("nan")})
    server.socket.send(b"one part")
    server.socket.send_multipart([b"imu", b"\xc1"])
    server.socket.send_multipart([b"imu", b"", b""])
    server.say("imu", name="supply")
    server.say("../imu")
    server.say("imu", values={"roll_deg": "much"})
    server.say("imu", host_ns=time.monotonic_ns() + 10**10)
    server.say("supply", values={"u": 12.0}, units={"u": "V"})
    first, second = until(sensors, 2)
    assert first.sensor == "imu" and first.values["roll_deg"] != first.values["roll_deg"]
    assert (second.sensor, second.values, second.units) == ("supply", {"u": 12.0}, {"u": "V"})
    assert sensors.malformed == 7
    sensors.close()


def test_no_more_sensors_than_a_head_has(server: Server) -> None:
    sensors = RemoteSensors(server.address)
    heard(server, sensors)
    for number in range(SENSORS_MAX + 5):
        server.say(f"sensor-{number}")
    assert len(until(sensors, SENSORS_MAX - 1, malformed=6)) == SENSORS_MAX - 1  # "hello" was the first
    assert sensors.poll() == [] and sensors.malformed == 6
    sensors.close()


def test_nobody_there_is_silence_and_who_comes_later_is_heard(tmp_path, stalls) -> None:
    address = f"ipc://{tmp_path}/later"
    sensors = RemoteSensors(address)
    begun = time.monotonic()
    for _ in range(1000):
        assert sensors.poll() == []
    took_s = time.monotonic() - begun
    if stalls.since(begun) < 0.1:
        assert took_s < 1.0  # a thousand looks at nobody
    server = Server(address)
    heard(server, sensors)
    server.close()
    again = Server(address)
    heard(again, sensors)
    again.close()
    sensors.close()


def test_a_message_of_any_size_is_survived(server: Server) -> None:
    sensors = RemoteSensors(server.address)
    heard(server, sensors)
    server.socket.send_multipart([b"imu", bytes(SAMPLE_MAX + 1)])
    heard(server, sensors)  # ZeroMQ ends the connection, and connects again
    sensors.close()


def test_an_address_that_is_none_is_one_line() -> None:
    with pytest.raises(AnnulusError, match="no address of sensors") as caught:
        RemoteSensors("somewhere")
    assert "\n" not in str(caught.value)
