"""The publisher process. Run as `python -m annulus.daemon.publisher`.

Whoever may connect may also misbehave: what strangers cost, they cost here. Frames come from the ring, everything else
as notes; what viewers do not take in time is dropped, see stream/publish.py.
"""

import sys
import time
from typing import Any

import zmq

from annulus.daemon.priority import Allowance, prompt
from annulus.numeric.arrays import Image
from annulus.stream.access import Doorkeeper, Keys
from annulus.stream.frames import FrameHeader
from annulus.stream.publish import Publisher
from annulus.stream.working import serve
from annulus.vocabulary import AnnulusError

FREED_S = 1.0  # the address of one that was killed stays taken until the kernel has ended it
REST_MS = 20  # at most, between two looks at who knocks and what viewers ask for


class PublisherJob:
    """A Publisher as a job. A frame's `extra` is its running number; a note's body its own and what it says. Reports
    where it is bound, and each time it had to close everybody's connection.

    Labels are to be there at once, so it has real-time priority where that is allowed, but within limits (Allowance).
    """

    def __init__(self, address: str, keys: Keys | None, realtime: bool | None = False) -> None:
        self._allowance = Allowance(realtime)
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

    def note(self, kind: str, body: Any) -> None:
        number, said = body
        self._publisher.send(kind, number, said)

    def idle(self) -> Any:
        self._doorkeeper.admit()
        self._publisher.listen()
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
    end = time.monotonic() + FREED_S
    while True:
        try:
            return PublisherJob(setup["address"], known, setup["realtime"])
        except AnnulusError:
            if time.monotonic() > end:
                raise
        time.sleep(0.01)


if __name__ == "__main__":
    serve(sys.argv[-1], _prepare, REST_MS)
