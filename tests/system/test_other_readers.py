"""Promises of a recording to programs that are not ours: `rerun mcap` and the `mcap` package's strict reader find
nothing to complain of, see pictures, points and times of today, and every message that we see.
"""

import os
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import SeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.frames import LABEL_TOPIC
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.wall.profile import Profile

FRAMES, H, W, PERIOD_NS = 20, 96, 128, 40_000_000
RERUN = Path(sys.executable).with_name("rerun")
CALIBRATION = {
    "format": "annulus-calibration/2",
    "cameras": [
        {"id": 0, "model": "pinhole", "width": W, "height": H, "fx": 40.0, "fy": 40.0, "cx": 63.5, "cy": 47.5},
        {
            "id": 3,
            "model": "fisheye",
            "width": W,
            "height": H,
            "fx": 40.0,
            "fy": 40.0,
            "cx": 63.5,
            "cy": 47.5,
            "distortion": [0.01, 0, 0, 0],
            "rotation": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
            "translation_mm": [0, 0, 50],
        },
    ],
}


def profile(index: int, z_mm: float) -> Profile:
    turn = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    points = np.stack([100 * np.cos(turn), 100 * np.sin(turn), np.full(360, z_mm)], axis=1).astype(np.float32)
    same = np.zeros(360, np.uint8)
    return Profile(index, z_mm, Pose(), points, np.full((360, 3), 90, np.uint8), same, np.arange(360, dtype=np.uint16))


def write(path: Path, codec: Codec) -> Clock:
    clock = Clock.now()
    with RecordingWriter(
        path, calibration=CALIBRATION, configuration={"fps": 25}, now_ns=clock.host_ns, codec=codec, clock=clock
    ) as writer:
        for index in range(FRAMES):
            now_ns = clock.host_ns + index * PERIOD_NS
            for camera in (0, 3):
                image = np.random.default_rng(index).integers(60, 70, (H, W), dtype=np.uint8)
                label = {
                    "index": index,
                    "camera": camera,
                    "label": "projector",
                    "reason": "",
                    "z_mm": 1000.0 + index,
                    "roll_deg": 30.0,
                    "encoding": "bayer_bggr8",
                    "width": W,
                    "height": H,
                    "timestamp_ns": now_ns,
                }
                assert writer.frame(label, image, now_ns + camera)
            writer.note("/profile", profile(index, 1000.0 + index).to_dict(), now_ns + PERIOD_NS // 2, index)
            writer.note("/event", {"kind": "disk", "text": f"event {index}"}, now_ns + PERIOD_NS)
        # what was sent first and comes last
        writer.note("/event", {"kind": "head", "text": "late"}, clock.host_ns)
        writer.note("/drops", {"new": {"recorder_busy": 3}, "all": {"recorder_busy": 3}}, now_ns)
    return clock


@pytest.fixture(params=list(Codec))
def codec(request: pytest.FixtureRequest) -> Codec:
    return Codec(request.param)


@pytest.fixture
def rerun(tmp_path: Path) -> Any:
    def run(*arguments: str | Path) -> str:
        env = {**os.environ, "HOME": str(tmp_path), "NO_COLOR": "1"}
        done = subprocess.run([RERUN, *arguments], env=env, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        said = re.sub(r"\x1b\[[0-9;]*m", "", done.stdout + done.stderr)
        complaints = [line for line in said.splitlines() if re.search(r"\b(WARN|ERROR|PROBLEM)\b", line)]
        assert [line for line in complaints if "app_id" not in line] == []
        return said

    run("analytics", "disable")
    return run


def messages(path: Path) -> Iterator[tuple[str, int, Any, Any]]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert isinstance(reader, SeekingReader)
        for schema, channel, message in reader.iter_messages():
            yield channel.topic, message.log_time, schema, message


def decoded(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        return [message for *_, message in reader.iter_decoded_messages(topics=[topic])]


def test_rerun_has_nothing_to_complain_of_and_sees_pictures_points_and_today(
    codec: Codec, tmp_path: Path, rerun: Any
) -> None:
    path = tmp_path / "scan.mcap"
    write(path, codec)
    today = datetime.now(UTC).strftime("%Y-%m-%d")
    assert f"Start                    {today}" in rerun("mcap", "info", path)
    table = rerun("mcap", "check", "--full", path)
    assert len(re.findall(r"^ok +\d+ +\d+ +/", table, re.M)) >= 13
    rerun("mcap", "convert", "--application-id", "annulus", "-o", tmp_path / "scan.rrd", path)
    seen = rerun("rrd", "print", tmp_path / "scan.rrd")
    assert re.search(r"/points - .*Points3D:colors.*Points3D:positions", seen)
    assert re.search(r"/tf - .*Transform3D:translation", seen)
    assert re.search(r"/calibration/0 - .*Pinhole:image_from_camera", seen)
    assert re.search(r"/log - .*TextLog:level", seen)
    pictures = "frame" if codec is Codec.JPEG else "preview"
    for camera in (0, 3):
        assert re.search(rf"/{pictures}/{camera} - .*EncodedImage:blob", seen)


def test_the_strict_reader_and_ours_see_the_same(codec: Codec, tmp_path: Path) -> None:
    path = tmp_path / "scan.mcap"
    clock = write(path, codec)
    counted: Counter[str] = Counter()
    stamps: dict[str, list[int]] = {}
    for topic, log_time, _schema, message in messages(path):
        counted[topic] += 1
        stamps.setdefault(topic, []).append(log_time)
        assert message.publish_time == log_time
    recording = open_recording(path)
    assert not recording.torn and not recording.damage and not recording.check()
    for topic in recording.topics:
        assert counted[topic] == len(list(recording.notes(topic)))
    for camera in (0, 3):
        mine = [frame.timestamp_ns for frame in recording.frames if frame.camera == camera]
        assert mine == [clock.host_ns + index * PERIOD_NS + camera for index in range(FRAMES)]
        assert stamps[f"/frame/{camera}"] == [clock.utc(one) for one in mine]
        assert counted[f"/frame/{camera}"] == FRAMES
    assert counted[LABEL_TOPIC] == 2 * FRAMES and counted["/points"] == counted["/profile"] == FRAMES
    assert abs(stamps["/event"][0] - time.time_ns()) < 60e9


def test_what_viewers_are_told_is_in_metres_and_in_its_frame(tmp_path: Path) -> None:
    path = tmp_path / "scan.mcap"
    write(path, Codec.ZSTD)
    cloud = decoded(path, "/points")[5]
    points = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)[:, :12].copy().view("<f4")
    assert cloud.frame_id == "pipe" and np.allclose(np.hypot(points[:, 0], points[:, 1]), 0.1, atol=1e-6)
    assert np.allclose(points[:, 2], 1.005, atol=1e-6)
    places = [t for message in decoded(path, "/tf") for t in message.transforms if t.child_frame_id == "camera"]
    assert {one.parent_frame_id for one in places} == {"pipe"} and len(places) == 2 * FRAMES
    assert places[-1].translation.z == pytest.approx(1.019)
    assert 2 * np.degrees(np.arctan2(places[0].rotation.z, places[0].rotation.w)) == pytest.approx(30.0)
    (second,) = [t for m in decoded(path, "/tf") for t in m.transforms if t.child_frame_id == "camera/3"]
    # X of the first camera's frame is R X + t in the other's: the other's origin is at -R^T t there
    assert [second.translation.x, second.translation.y, second.translation.z] == pytest.approx([0.05, 0, 0])
    x, y, z, w = second.rotation.x, second.rotation.y, second.rotation.z, second.rotation.w
    turned = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w)], [2 * (x * z - y * w), 2 * (y * z + x * w)]])
    assert np.allclose(turned, [[0, 0], [1, 0]], atol=1e-9)  # rows 0 and 2 of R^T, first two columns
    (whole,), (half,) = decoded(path, "/calibration/0"), decoded(path, "/preview_calibration/0")
    assert (whole.width, whole.K[0], whole.K[2], whole.distortion_model) == (W, 40.0, 63.5, "plumb_bob")
    assert (half.width, half.K[0], half.K[2]) == (W // 2, 20.0, 31.5)
    assert decoded(path, "/calibration/3")[0].distortion_model == "kannala_brandt"
    picture = cv2.imdecode(np.frombuffer(decoded(path, "/preview/0")[0].data, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (H // 2, W // 2, 3) and abs(picture.mean() - 64.5) < 2
    logs = decoded(path, "/log")
    assert [one.message for one in logs[-2:]] == ["late", "3 recorder_busy"] and logs[1].level == 3
