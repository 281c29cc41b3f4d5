"""Promises of the one engine on a scan of the twin: the same to the bit everywhere, and the manual's ten lines."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.reprocess import survey_of
from annulus_pipe.reprocess.engine import CHUNK, measure, reprocess
from annulus_pipe.reprocess.executors import Processes, in_process
from annulus_pipe.reprocess.job import Job, Measured, open_job
from annulus_pipe.reprocess.method import method_for
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World, WorldFeature, clean_world
from annulus_pipe.vocabulary import Label
from annulus_pipe.wall.profile import Profile

PYTHON = Path(__file__).parents[3] / "docs/manual/python.md"
FRAMES = 24


@pytest.fixture(scope="module")
def world() -> World:
    pocket = WorldFeature("pocket", z_mm=120.0, length_mm=24.0, depth_mm=3.0, clock_deg=80.0, arc_deg=30.0)
    return replace(clean_world(travel_mm=60.0).scaled(832), features=(pocket,), roll_deg=10.0)


@pytest.fixture(scope="module")
def folder(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording named as in the manual, alone in its folder; every third frame has a roll."""
    folder = tmp_path_factory.mktemp("scan")
    renderer, size = Renderer(world), (world.camera.width, world.camera.height)
    with RecordingWriter(
        folder / "scan.mcap", calibration=world.calibration().to_dict(), configuration={}, now_ns=0
    ) as writer:
        for i, z in enumerate(np.linspace(0.0, world.travel_mm, FRAMES)):
            pose, label = world.pose(z), Label.LED if i % 5 == 4 else Label.PROJECTOR
            raw = renderer.render(pose, z, float(label is Label.PROJECTOR), float(label is Label.LED), seed=i)
            roll = float(np.degrees(pose.roll or 0.0)) if i % 3 == 0 else None
            header = FrameHeader(i, None, i * 10**7, label, "", None, None, None, float(z), "bayer_rggb8", *size, roll)
            writer.frame(header.to_dict(), raw, i * 10**7)
    return folder


@pytest.fixture(scope="module")
def job(folder: Path) -> Job:
    return open_job(folder / "scan.mcap")


def backwards(job: Job, chunks: Sequence[Sequence[int]]) -> Iterator[tuple[int, list[Measured]]]:
    """A cluster's way: chunks as they come, each on a machine of its own."""
    for number in reversed(range(len(chunks))):
        yield number, job.ready()(chunks[number])


def same(one: Profile, other: Profile) -> bool:
    """To the bit, the clock's readings left out."""
    return replace(one, timing_ms={}).to_dict() == replace(other, timing_ms={}).to_dict()


@pytest.mark.deep(gate="tests/scenes/reprocess/test_engine.py::test_the_account_counts_what_the_recording_holds")
@pytest.mark.parametrize("executor", [Processes(2), Processes(3), backwards])
def test_profiles_are_the_same_to_the_bit_wherever_they_are_made(job: Job, executor) -> None:
    which = job.which(Label.PROJECTOR)
    assert len(which) > 2 * CHUNK
    here, there = measure(job, which, in_process), measure(job, which, executor)
    assert [profile.frame for profile, _ in here] == [job.scan.frames[i].index for i in which]
    assert all(profile.pose is not None for profile, _ in here)
    assert all(same(a, b) and one == other for (a, one), (b, other) in zip(here, there, strict=True))


def test_frames_that_were_missed_live_get_the_roll_of_their_neighbours(job: Job) -> None:
    """The demo's late frames once had neither roll nor seed."""
    late = [i for i in job.which(Label.PROJECTOR) if i % 3]
    known = open_scan(job.scan.path).frames
    assert all(known[i].roll_deg is None for i in late)
    for profile, _ in measure(job, late[:CHUNK]):
        assert profile.pose is not None and profile.pose.roll is not None


def test_a_frame_live_and_on_disk_has_one_profile(job: Job) -> None:
    """The worker that sees a frame's header and the engine that sees its row call the same function."""
    i = job.which(Label.PROJECTOR)[0]
    row = job.scan.frames[i]
    camera = job.calibration.camera
    header = FrameHeader(
        row.index, None, 0, row.label, "", None, None, None, row.z_mm, "bgr8", camera.width, camera.height, row.roll_deg
    )
    method, image = method_for(job.calibration), job.read(i)
    image.flags.writeable = False  # as out of shared memory
    assert same(method(header, {0: image}, None), measure(job, [i])[0][0])


def test_the_account_counts_what_the_recording_holds(job: Job) -> None:
    done = reprocess(job)
    assert done.frames == {"projector": 20, "led": 4, "unknown": 0}
    assert done.drops == {"frames_unknown": 0, "profiles_without_pose": 0, "recording_torn": 0, "frames_damaged": 0}
    assert done.findings == () and done.timing_ms["total"] > 0


def test_frames_whose_picture_shows_another_lamp_are_said_and_left_out(job: Job) -> None:
    """Four wrong labels in a table were passed without a word; two pictures of rings stood in the wall's texture."""
    wrong = {4: Label.PROJECTOR, 9: Label.PROJECTOR, 12: Label.LED, 13: Label.LED}
    frames = tuple(replace(one, label=wrong.get(one.index, one.label)) for one in job.scan.frames)
    done = reprocess(replace(job, scan=replace(job.scan, frames=frames)))
    assert [one.frames for one in done.findings if one.kind == "lamp"] == [(4, 9)]
    assert [one.frames for one in done.survey().findings if one.kind == "lamp"] == [(12, 13)]


@pytest.mark.deep(gate="tests/scenes/reprocess/test_engine.py::test_the_account_counts_what_the_recording_holds")
def test_the_manuals_ten_lines_do_what_they_say(folder: Path) -> None:
    found = re.search(r"```python\n(.*?)```", PYTHON.read_text(), re.DOTALL)
    assert found is not None
    code = found.group(1)
    assert len(code.splitlines()) <= 10
    shown = code.replace("plt.show()", "print(plt.gca().images[0].get_array().count())")
    for text in (code, shown):
        done = subprocess.run(
            [sys.executable, "-c", text],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=240,
            env={**os.environ, "MPLBACKEND": "agg"},
        )
        assert done.returncode == 0, done.stderr
        assert [path.name for path in folder.iterdir()] == ["scan.mcap"], "no file written"
    line, cells = done.stdout.splitlines()
    said = re.fullmatch(r"loss of (\d\.\d\d) ± (\d\.\d\d) mm \(k=2\) at (\d+) mm, clock (\S+)", line)
    assert said is not None, line
    depth, k2, z = (float(said.group(i)) for i in (1, 2, 3))
    assert abs(depth - 3.0) <= max(k2, 0.1) and abs(z - 120) < 4 and said.group(4) in ("2:35", "2:40", "2:45")
    assert int(cells) == survey_of(folder / "scan.mcap").wall.seen.sum()


@pytest.mark.deep(gate="tests/scenes/reprocess/test_engine.py::test_a_frame_live_and_on_disk_has_one_profile")
def test_damaged_frames_are_left_out_counted_and_named(job: Job, tmp_path: Path) -> None:
    recording = job.scan.recording
    assert recording is not None
    data = bytearray(job.scan.path.read_bytes())
    for index in (0, 9, 12):  # the first of all, an LED frame, one in the middle
        frame = recording.frames[index]
        assert frame.chunk is not None
        data[frame.chunk.offset + frame.chunk.length // 2] ^= 0x40
    (tmp_path / "damaged.mcap").write_bytes(data)
    done = reprocess(open_job(tmp_path / "damaged.mcap"), Processes(2))
    assert done.drops == {"frames_unknown": 0, "profiles_without_pose": 0, "recording_torn": 0, "frames_damaged": 3}
    assert [profile.frame for profile in done.profiles] == [i for i in range(1, FRAMES) if i % 5 != 4 and i != 12]
    (finding,) = done.findings
    assert finding.frames == (0, 9, 12) and "3 frames are damaged and left out" in finding.text
    assert done.survey().wall.seen.any()
