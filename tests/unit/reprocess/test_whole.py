"""A scan too long to be held says the same whichever way its frames went, and leaves files that lead to each other."""

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.cli.results import ReportContext, WindowFiles, write_results
from annulus_pipe.job import Observation, Origin
from annulus_pipe.reprocess.executors import Executor, Processes, in_process
from annulus_pipe.reprocess.job import open_job
from annulus_pipe.reprocess.whole import Surveyed, surveyed
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.wall.joined import Joined
from tools.bench.speed.long_scan import STEP_MM, drawn_scan

pytestmark = pytest.mark.deep(
    gate="tests/unit/reprocess/test_desk.py::test_every_item_comes_back_once_whatever_asking_for_some_of_them_raises"
)

FRAMES = 300  # 0.75 m
MOST = 300_000  # points of a window: there are half a million
CONTENT = ("cloud.ply", "mesh.ply", "stations.csv", "wall.npz", "unwrapped.png", "texture.png", "centreline.json")


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("long") / "scan"
    drawn_scan(folder, FRAMES, scale=0.25)
    return folder


def reconstructed(scan: Path, out: Path, executor: Executor = in_process, keep: bool = False) -> Surveyed:
    marked = Observation(300.0, "a stain", 90.0)
    told, place = ReportContext("a long scan", Origin(observations=(marked,))), StoragePath(out)
    out.mkdir(exist_ok=True)
    job = open_job(scan, scan / "calibration.json")
    done = surveyed(job, place, executor, WindowFiles(told, place), keep=keep, points_max=MOST)
    write_results(done, told, place)
    return done


def hashed(out: Path) -> dict[str, str]:
    """Of every file whose content is the scan's alone."""
    files = sorted(one for one in out.rglob("*") if one.name in CONTENT)
    return {str(one.relative_to(out)): hashlib.sha256(one.read_bytes()).hexdigest() for one in files}


@pytest.fixture(scope="module")
def held(scan: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("held")
    done = reconstructed(scan, out)
    assert isinstance(done.survey, Joined) and len(done.windows) >= 2
    return out


def test_the_same_bits_held_or_by_files_by_one_or_by_two_and_again(scan: Path, held: Path, tmp_path: Path) -> None:
    first = reconstructed(scan, tmp_path / "a", Processes(2), keep=True)
    assert first.ranges == first.made == 2
    assert hashed(tmp_path / "a") == hashed(held) and len(hashed(held)) == 5 + 7 * len(first.windows)
    (stale := tmp_path / "a/windows/0099").mkdir()
    (stale / "summary.json").write_text("{}")
    clouds = [tmp_path / f"a/windows/{n + 1:04d}/cloud.ply" for n in first.windows]
    before = [one.stat().st_mtime_ns for one in clouds]
    altered = tmp_path / "a/windows/0002/wall.npz"
    altered.write_bytes(altered.read_bytes()[:-1] + b"?")
    again = reconstructed(scan, tmp_path / "a", keep=True)
    assert again.ranges == 2 and again.made == 0, "what was measured is found"
    written = [one.stat().st_mtime_ns != was for one, was in zip(clouds, before, strict=True)]
    assert written == [number == 1 for number in again.windows], "a window is found, and what was altered made anew"
    assert hashed(tmp_path / "a") == hashed(held) and not stale.exists(), "windows of a scan before do not stay"


def test_the_whole_leads_to_its_windows_and_says_what_they_say(held: Path) -> None:
    summary = json.loads((held / "summary.json").read_text())
    windows = summary["windows"]
    assert [one["folder"] for one in windows] == sorted(
        path.relative_to(held).as_posix() for path in (held / "windows").iterdir()
    )
    assert summary["points"] == sum(one["points"] for one in windows)
    page = (held / "report.html").read_text()
    links = set(re.findall(r'href="(windows/[^"]+)"', page))
    assert links == {f"{one['folder']}/report.html" for one in windows} and all((held / one).is_file() for one in links)
    assert abs(summary["diameter_mm"]["mean"] - 152.4) < 0.3
    assert {one["kind"] for one in summary["warnings"]} <= {"ring lost", "frames-thinned"}, (
        "so small pictures, so close"
    )
    marked = [one for one in windows if json.loads((held / one["folder"] / "summary.json").read_text())["observations"]]
    assert len(marked) == 1 and marked[0]["from_mm"] <= 300.0 < marked[0]["to_mm"], "a mark stands where it was made"


def test_the_wall_of_the_whole_has_every_row(held: Path) -> None:
    with np.load(held / "wall.npz") as whole:
        z, deviation, sigma = whole["z_mm"], whole["deviation_um"], whole["sigma_um"]
        assert (np.diff(z) == whole["z_step_mm"]).all() and deviation.shape == sigma.shape == (len(z), 360)
    parts = [np.load(path)["deviation_um"] for path in sorted((held / "windows").glob("*/wall.npz"))]
    assert np.array_equal(np.concatenate(parts), deviation)
    stations = (held / "stations.csv").read_text().splitlines()
    assert len(stations) > 0.9 * (z[-1] - z[0]) / 5.0 and z[-1] > 0.9 * FRAMES * STEP_MM
