"""The publisher process. Run as `python -m annulus_pipe.daemon.publisher`.

Whoever may connect may also misbehave: what strangers cost, they cost here. Frames come from the ring, everything else
as notes; what viewers do not take in time is dropped, see stream/publish.py.
"""

import sys
import time
from collections import Counter
from contextlib import suppress
from typing import Any

import zmq

from annulus_pipe.daemon.live_wall import LiveWall
from annulus_pipe.daemon.pictures import preview, rows, slits
from annulus_pipe.daemon.priority import ProcessorAllowance, prompt
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.stream.access import Doorkeeper, Keys
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.publish import Publisher
from annulus_pipe.stream.working import serve
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile

FREED_S = 1.0  # the address of one that was killed stays taken until the kernel has ended it
REST_MS = 20  # at most, between two looks at who knocks and what viewers ask for


class PublisherJob:
    """A Publisher as a job. A frame's `extra` is its running number; a note's body its own and what it says. Reports
    where it is bound, and each time it had to close everybody's connection.

    What is made of frames and profiles for somebody (pictures.py), and the wall, is made and numbered here. Labels are
    to be there at once, so it has real-time priority where that is allowed, but within limits (ProcessorAllowance).
    """

    def __init__(
        self,
        address: str,
        keys: Keys | None,
        realtime: bool | None = False,
        calibration: Calibration | None = None,
        scan: int | None = None,
    ) -> None:
        """`scan`: number of the one under way, of which this one has seen nothing yet: it takes over."""
        self._calibration = calibration
        self._under_way = scan is not None
        self._wall = None if calibration is None else LiveWall(calibration, scan or 0)
        self._made: Counter[str] = Counter()  # by topic
        self._allowance = ProcessorAllowance(realtime)
        self._context: zmq.Context[zmq.Socket[bytes]] = prompt(zmq.Context())
        self._doorkeeper = Doorkeeper(self._context)
        try:
            self._publisher = Publisher(self._doorkeeper, address, keys)
        except AnnulusError:
            self._context.destroy(linger=0)
            raise
        self._reported: list[Any] = []

    def frame(self, header: FrameHeader, image: Image, extra: Any) -> Any:
        topic = f"frame/{header.camera}"
        if self._publisher.wanted(topic):  # 2 MB copied for nobody otherwise
            self._publisher.send(topic, extra, header.to_dict(), image.data)
        for topic, make in ((f"preview/{header.camera}", preview), (f"rows/{header.camera}", rows)):
            if self._publisher.wanted(topic):
                self._send(topic, *make(header, image))

    def note(self, kind: str, body: Any) -> None:
        number, content, *part = body
        self._publisher.send(kind, number, content, *part)
        if kind in ("begun", "ended"):
            self._under_way = kind == "begun"
            if self._under_way and self._wall is not None:
                self._wall.begin(content["scan"])
        if kind == "profile" and self._calibration is not None and self._wall is not None:
            with suppress(ValueError):  # a malformed profile must not cost those that are there
                profile = Profile.from_dict(content)
                self._wall.add(profile)
                topic = f"slits/{profile.camera}"
                if self._publisher.wanted(topic) and (found := slits(profile, self._calibration)):
                    self._send(topic, *found)

    def _send(self, topic: str, body: Any, part: bytes) -> None:
        self._publisher.send(topic, self._made[topic], body, part)
        self._made[topic] += 1

    def idle(self) -> Any:
        self._doorkeeper.admit()
        asked = self._publisher.listen()
        if self._wall is not None and self._publisher.wanted("wall"):
            if any(b"wall".startswith(prefix) for prefix in asked):
                self._wall.say_again()
            for message in self._wall.say(time.monotonic(), in_turn=self._under_way):
                self._send("wall", *message)
        self._allowance.look()
        report = [self._publisher.address, self._publisher.floods]
        if report == self._reported:
            return None
        self._reported = report
        return report

    def close(self) -> Any:
        self._context.destroy(linger=200)


def _prepare(setup: Any) -> PublisherJob:
    keys = setup["keys"]
    known = None if keys is None else Keys(keys["public"], keys["secret"], frozenset(keys["viewers"]))
    calibration = None if setup["calibration"] is None else Calibration.from_dict(setup["calibration"])
    end = time.monotonic() + FREED_S
    while True:
        try:
            return PublisherJob(setup["address"], known, setup["realtime"], calibration, setup["scan"])
        except AnnulusError:
            if time.monotonic() > end:
                raise
        time.sleep(0.01)


if __name__ == "__main__":
    serve(sys.argv[-1], _prepare, REST_MS)
