"""Promises about evidence: whatever befell a scan, its labels and places are said again from it, to the last field."""

import random
from dataclasses import replace

import pytest

from annulus.capture.photometry import Photometry
from annulus.labelling.evidence import LABEL, Row
from annulus.labelling.labelling import CameraMode, FrameSeen, Labelling
from annulus.labelling.navigation import Navigation
from annulus.labelling.replay import PATIENCE_NS, Replay
from annulus.link.head import EdgeSeen, LampsCut
from annulus.link.messages import Edge, Fault, FaultCode
from annulus.link.session import EventReceived, EventsLost, Rebooted
from annulus.record.recording import from_json, to_json
from annulus.sensors.sample import Sample
from annulus.stream.frames import FrameHeader
from annulus.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Label, Lamp, Slot, Tick

PERIOD = 40_000_000
LED, PROJECTOR = Photometry(200.0, 1.0, 0.005), Photometry(200.0, 0.2, 0.35)


class Head:
    """Two cameras on one sync, ratio 4, under faults drawn from a seed; edges get through late or not at all."""

    def __init__(self, seed: int) -> None:
        self.rng = random.Random(seed)
        self.navigation = Navigation(0.05)
        self.rows: list[Row] = []
        self.headers: list[FrameHeader] = []
        self.boot, self.since, self.waiting = 1, 0, []
        self.labellings = []

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
                EdgeIndex(edge), Tick(edge * 4_000_000), Slot(k % 5), Lamp.LED if k % 5 == 4 else Lamp.PROJECTOR, 1, 1,
                20 * edge, 1, 7, EdgeFlag(0),
            )  # fmt: skip
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
                frame = FrameSeen(CameraSequence(k), now + jitter, now + jitter + 3_000_000 + camera, picture, {})
                labelling.saw(frame)
                self.waiting.append((camera, frame))
            for camera, labelling in enumerate(self.labellings):
                for _ in range(rng.choice([1, 1, 3])):
                    labelling.look_for_offset(now / 1e9)
                for one in [one for one in self.waiting if one[0] == camera]:
                    if labelling.settled(one[1], now) or rng.random() < 0.02:
                        self.waiting.remove(one)
                        self.headers.append(labelling.header(one[1]))
                    else:
                        break


@pytest.mark.parametrize("seed", range(8))
def test_what_was_said_is_said_again(seed: int) -> None:
    head = Head(seed)
    head.run(0, 300)  # nobody writes down: the head is up, no scan is under way
    head.begin()
    head.run(300, 1500)
    known = [header for header in head.headers if header.label is not Label.UNKNOWN]
    assert len(known) > 800 and any(header.z_assumed for header in known)
    replay = Replay()
    again = [one for row in head.rows for one in replay.feed(row)] + replay.finish()
    assert replay.malformed == 0
    assert len(again) == len(head.headers)
    for was, now in again:
        assert now is not None
        said = now.to_dict()
        for name in LABEL:
            if name not in ("index", "roll_deg"):  # numbers go on from scan to scan; roll from samples before the scan
                assert said[name] == was[name], name
    mine = [(header.camera, header.arrived_ns, header.label, header.z_mm, header.segment) for header in head.headers]
    assert mine == [(now.camera, now.arrived_ns, now.label, now.z_mm, now.segment) for _, now in again if now]


def test_off_line_a_frame_may_wait_for_what_came_too_late() -> None:
    """On the head there was no room to wait for the offset: 14 frames went without a label."""
    head = Head(1)
    head.rng.random = lambda: 0.5  # type: ignore[method-assign]  # nothing goes wrong
    head.rng.choice = lambda of: of[0]  # type: ignore[method-assign]
    head.begin()
    for labelling in head.labellings:
        labelling.settled = lambda *_: True  # type: ignore[method-assign]
    head.run(0, 60)
    unknown = sum(header.label is Label.UNKNOWN for header in head.headers)
    assert unknown >= 14
    replay = Replay(PATIENCE_NS)
    again = [one for row in head.rows for one in replay.feed(row)] + replay.finish()
    assert sum(now is None or now.label is Label.UNKNOWN for _, now in again) <= 4  # the first and last of each camera
    for was, now in again:
        assert now is not None and was["label"] in ("unknown", now.label.value)


def test_rows_that_are_missing_or_damaged_cost_their_frames_only() -> None:
    head = Head(3)
    head.begin()
    head.run(0, 600)
    frames = [i for i, row in enumerate(head.rows) if row["what"] == "frame"]
    gone, torn = frames[300], frames[400]
    head.rows[torn] = {**head.rows[torn], "picture": "?"}
    del head.rows[gone]
    replay = Replay()
    again = [one for row in head.rows for one in replay.feed(row)] + replay.finish()
    assert replay.malformed == 1 and sum(now is None for _, now in again) == 2
    assert len(again) == len(head.headers)


def test_an_edge_that_never_got_its_place_in_time_is_written_down_too() -> None:
    head = Head(0)
    head.begin()
    for edge in range(300):
        head.navigation.heard(EventReceived(Edge(edge, edge, 0, Lamp.LED, 1, 1, 0, 1, EdgeFlag(0)), 0, 7, 5, True))
    assert sum(row["what"] == "unplaced" and row["recovered"] for row in head.rows) > 150
