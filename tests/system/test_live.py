"""Promises of what viewers see of a scan while it is under way: the simulated head in real time, all else real."""

import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from test_scan import Rig, frames_are_what_they_are_called, head  # noqa: F401

from annulus.daemon.config import SocketConfig
from annulus.record.recording import open_recording
from annulus.reprocess.relabel import Audit, audit
from annulus.stream.publish import parse
from annulus.twin.head import HeadHandle
from annulus.vocabulary import Label

pytestmark = pytest.mark.system

TOPICS = (b"preview/0", b"rows/0", b"slits/0", b"wall", b"defects", b"closeup")


class Viewer:
    """Has asked for all of it, and keeps it."""

    def __init__(self, context: "zmq.Context[Any]", address: str) -> None:
        self.came: dict[str, list[tuple[Any, bytes]]] = defaultdict(list)
        self._socket = context.socket(zmq.SUB)
        for topic in TOPICS:
            self._socket.subscribe(topic)
        self._socket.connect(address)

    def look(self) -> None:
        while self._socket.poll(0):
            topic, _, body, part = parse(self._socket.recv_multipart())
            self.came[topic].append((body, part))


def test_viewers_see_a_scan_grow_and_its_labels_and_recording_are_as_ever(
    head: HeadHandle, tmp_path: Path  # noqa: F811
) -> None:  # fmt: skip
    address = f"ipc://{tmp_path}/live"
    rig = Rig(head, tmp_path, publish=SocketConfig(address))
    with zmq.Context() as context:
        viewer = Viewer(context, address)

        def until(rig: Rig) -> bool:
            viewer.look()
            return rig.session.labelled >= 100

        report = rig.run(until)
        context.destroy(linger=0)
    recording = open_recording(tmp_path / "scan.mcap")
    assert audit(tmp_path / "scan.mcap").to_dict() | {"frames": 0} == Audit().to_dict()
    known = frames_are_what_they_are_called(recording)
    assert known == report.frames["projector"] + report.frames["led"] and len(recording.frames) >= 100
    assert not report.drops.get("surveyor_failed") and report.telemetry["surveyor"]["alive"] == 1
    came = viewer.came
    labels = {frame.index: frame.label for frame in recording.frames}
    for topic in ("preview/0", "rows/0"):
        assert len(came[topic]) + report.drops.get("publisher_busy", 0) > 0.9 * len(labels)
        assert all(labels[body["index"]] is Label(body["label"]) for body, _ in came[topic])
    late = [body["published"] - time.time() for body, _ in came["preview/0"]]
    assert max(late) < 0 and all(part[:2] == b"\xff\xd8" for _, part in came["preview/0"])
    assert {body["index"] for body, _ in came["slits/0"]} <= {p.frame for p in rig.profiles}
    assert len(came["slits/0"]) > 0.8 * len(rig.profiles)
    rows = [body for body, _ in came["wall"] if body["of"] == "whole"]
    told = {row for body in rows for row in range(body["first"], body["first"] + body["rows"])}
    seen = np.concatenate([profile.points_mm[:, 2] for profile in rig.profiles])
    assert min(told) <= np.percentile(seen, 2) / 5.0 and (max(told) + 1) * 5.0 >= np.percentile(seen, 50)
    assert len({body["scan"] for body, _ in came["wall"]}) == 1
