"""A head in virtual time under seeded faults, whose labels and evidence are kept."""

import random
from dataclasses import replace

from annulus_pipe.capture.photometry import Photometry
from annulus_pipe.labelling.evidence import Row
from annulus_pipe.labelling.labelling import CameraMode, FrameSeen, Labelling
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.link.head import EdgeSeen, LampsCut
from annulus_pipe.link.messages import Edge, Fault, FaultCode
from annulus_pipe.link.session import EventReceived, EventsLost, Rebooted
from annulus_pipe.record.frames import from_json, to_json
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Lamp, Slot, Tick

PERIOD = 40_000_000
LED, PROJECTOR = Photometry(200.0, 1.0, 0.005), Photometry(200.0, 0.2, 0.35)


class Head:
    """Two cameras on one sync, ratio 4, under faults drawn from a seed; edges get through late or not at all."""

    def __init__(self, seed: int) -> None:
        self.rng, self.haste = random.Random(seed), random.Random(seed + 1)  # what happens does not hang on labels
        self.navigation = Navigation(0.05)
        self.rows: list[Row] = []
        self.headers: list[FrameHeader] = []
        self.boot, self.since, self.waiting = 1, 0, []
        self.labellings = []
        self.moved_ns = 0  # the first camera's stamps, since it began anew

    def restart(self, moved_ns: int) -> None:
        """The first camera begins anew, and its stamps are off by something else."""
        self.moved_ns = moved_ns
        self.waiting = [one for one in self.waiting if one[0]]
        self.labellings[0].restarted()

    def begin(self) -> None:
        self.navigation.write_down(lambda row: self.rows.append(from_json(to_json(row))))
        self.labellings = [
            Labelling(CameraMode(i, 64, 48, "mono8", PERIOD), self.navigation, lambda *_: None, False) for i in (0, 1)
        ]

    def run(self, first: int, last: int) -> None:
        rng = self.rng
        for k in range(first, last):
            now = k * PERIOD
            if rng.random() < 0.01:
                self.boot, self.since = self.boot + 1, k
                self.navigation.heard(Rebooted(7, 7, "its events begin anew"))
            edge = k - self.since
            flash = Flash(
                EdgeIndex(edge),
                Tick(edge * 4_000_000),
                Slot(k % 5),
                Lamp.LED if k % 5 == 4 else Lamp.PROJECTOR,
                1,
                1,
                20 * edge,
                1,
                7,
                EdgeFlag(0),
            )
            if rng.random() < 0.97:
                raw = Edge(edge, flash.tick, k % 5, flash.lamp, 1, 1, 20 * edge, 1, flash.flags)
                self.navigation.heard(EventReceived(raw, k % 65536, 7, now, False))
                self.navigation.heard(EdgeSeen(flash, now + rng.randrange(1000), 900, self.boot, 1000 + self.boot))
            if rng.random() < 0.01:
                self.navigation.heard(LampsCut(now - 5, now + 5, "interlock"))
                self.navigation.heard(EventReceived(Fault(1, FaultCode.ODOMETER, k), 1, 7, now, False))
                self.navigation.heard(EventsLost(3, 2, 7))
            if rng.random() < 0.005:
                self.navigation.zero()
            self.navigation.sampled(Sample("imu", now - PERIOD, {"roll_deg": k % 360.0}, {"roll_deg": "deg"}))
            for camera, labelling in enumerate(self.labellings):
                if rng.random() < 0.02:
                    continue
                picture = replace(LED if (k - 1) % 5 == 4 else PROJECTOR, fingerprint=rng.getrandbits(64))
                jitter = rng.choice([0, 0, 0, 0, 9_000_000]) + camera * 500
                stamp = now + jitter + (0 if camera else self.moved_ns)
                frame = FrameSeen(CameraSequence(k), stamp, now + jitter + 3_000_000 + camera, picture, {})
                labelling.saw(frame)
                self.waiting.append((camera, frame))
            for camera, labelling in enumerate(self.labellings):
                for _ in range(rng.choice([1, 1, 3])):
                    labelling.look_for_offset(now / 1e9)
                for one in [one for one in self.waiting if one[0] == camera]:
                    if labelling.settled(one[1], now) or self.haste.random() < 0.02:
                        self.waiting.remove(one)
                        self.headers.append(labelling.header(one[1]))
                    else:
                        break
