"""Promises of a head with two cameras, from the sync line to the profile: the simulated head in real time."""

import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.session import Session
from annulus_pipe.demo import demo_config
from annulus_pipe.record.recording import open_recording
from annulus_pipe.twin.faults import NO_FAULTS, Faults
from annulus_pipe.twin.head import start_head
from annulus_pipe.twin.score import score_cloud
from annulus_pipe.twin.worlds import stereo_world
from annulus_pipe.vocabulary import Label
from annulus_pipe.wall.profile import Profile

pytestmark = [
    pytest.mark.alone,
    pytest.mark.deep(
        gate="tests/unit/daemon/test_flashes.py::test_no_pair_is_wrong_and_no_frame_is_lost_however_frames_drop_and_lag"
    ),
]

WORLD = stereo_world().scaled(832)
PROFILES = 30


class Kept(Observer):
    def __init__(self) -> None:
        self.profiles: list[Profile] = []

    def profile(self, profile: Profile) -> None:
        self.profiles.append(profile)


def test_a_pair_is_measured_together_and_alone_where_a_camera_lost_its_frame(tmp_path: Path) -> None:
    """One frame in ten of the second camera's is dropped: no wrong pair, and every loss stands under its camera."""
    kept = Kept()
    with start_head(WORLD, 3.0, NO_FAULTS, seed=5, speed_mm_s=9.0, others=[Faults(frames_dropped=0.1)]) as head:
        session = Session(demo_config(head, WORLD, tmp_path), observer=kept, name="scan")
        end = time.monotonic() + 150.0
        report = session.run(lambda: len(kept.profiles) >= PROFILES or time.monotonic() > end)
        assert head.counters()["lamps_on"] == []
        dropped = head.counters()["drivers"][1]["dropped"]
    assert len(kept.profiles) >= PROFILES
    assert not any(report.telemetry["in_hand"].values()) and not report.findings
    cameras = report.telemetry["cameras"]
    assert len(cameras) == 2 and cameras[1]["lost"]["camera"] >= 1 and dropped >= cameras[1]["lost"]["camera"]
    recording = open_recording(tmp_path / "scan.mcap")
    assert Counter(frame.camera for frame in recording.frames) == {
        number: sum(camera["frames"].values()) for number, camera in enumerate(cameras)
    }
    flashes: dict[int, dict[int, object]] = {}
    for frame in recording.frames:
        if frame.label is Label.PROJECTOR:
            flashes.setdefault(frame.index, {})[frame.camera] = recording.label(frame)["edge"], frame.z_mm
    assert all(len(set(flash.values())) == 1 for flash in flashes.values()), "one index, one flash"
    assert len({next(iter(flash.values())) for flash in flashes.values()}) == len(flashes), "one flash, one index"
    alone = [profile for profile in kept.profiles if "camera missing" in profile.rejected]
    missing = sum(camera["lost"].get("camera_missing", 0) for camera in cameras)
    assert missing == sum(profile.rejected["camera missing"] for profile in alone) > 0
    late = report.drops.get("camera_late", 0)
    assert sum(len(flashes[profile.frame]) == 2 for profile in alone) <= late, "alone only where the other's was lost"
    for profile in kept.profiles:
        assert profile.pose is not None and len(profile.points_mm) > 2000
        both = (profile.seen_by == 2).mean()
        assert (both == 0.0) if profile in alone else (both > 0.3)
    points = np.concatenate([profile.points_mm for profile in kept.profiles])
    scored = score_cloud(WORLD, points, np.concatenate([profile.ring for profile in kept.profiles]))
    assert scored.rms_mm < 0.25 and scored.gross_percent < 0.3
