"""Promises of the Surveys tab's server side: what lies in the folders is listed cheaply and given out by name only, and
a reconstruction is a child that can be watched, given up, and leaves nothing half done.
"""

import asyncio
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from starlette.applications import Starlette
from starlette.testclient import TestClient

from annulus_pipe.console import shelf as room
from annulus_pipe.console.answers import refused
from annulus_pipe.console.shelf import Shelf
from annulus_pipe.console.surveys import routes
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.parts import Part, part_path
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.vocabulary import AnnulusError

CHILD = """
import json, pathlib, subprocess, sys, time
scan, out = pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[4])
out.mkdir()
(out / "half").write_text("half")
print("compiling the measuring loops, once", file=sys.stderr, flush=True)
for done in range(0, 101, 20):
    print(json.dumps({"what": "frames", "done": done, "total": 100}), file=sys.stderr, flush=True)
    time.sleep(0.01)
if "slow" in scan.name:
    grandchild = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    (scan.parent / "pids").write_text(f"{grandchild.pid}")
    time.sleep(60)
if "bad" in scan.name:
    print(f"annulus: {scan.name}: no calibration fits. Expected one.", file=sys.stderr)
    sys.exit(1)
(out / "half").unlink()
said = {"format": "annulus-summary/1", "source": str(scan), "argv": sys.argv[1:]}
(out / "summary.json").write_text(json.dumps(said))
(out / "report.html").write_text("<h1>report</h1>")
"""


def record(path: Path, part: Part | None = None, calibration: dict[str, Any] | None = None, close: bool = True) -> Path:
    writer = RecordingWriter(
        path,
        calibration=calibration,
        configuration={"job": {"pipe": "P-1", "site": "Elm <b>Street</b>"}},
        now_ns=0,
        codec=Codec.RAW,
        clock=Clock(0, 1_800_000_000_000_000_000),
        part=part,
    )
    for index in range(5):
        label = {
            "index": index,
            "label": "projector",
            "z_mm": 10.0 * index,
            "encoding": "mono8",
            "width": 32,
            "height": 32,
            "timestamp_ns": index,
        }
        writer.frame(label, np.zeros((32, 32), np.uint8), index * 40_000_000)
    writer.flush()
    if close:
        writer.close()
    return path


def result(folder: Path, **more: Any) -> Path:
    folder.mkdir(parents=True)
    summary = {
        "format": "annulus-summary/1",
        "source": "/data/a.mcap",
        "created": "2026-11-25T06:29:48+00:00",
        "job": {"pipe": "P-1"},
        "scanned_mm": {"from": 0.0, "to": 401.0, "length": 401.0},
        "diameter_mm": {"mean": 152.4, "k2": 0.1},
        "defects": [{"depth_mm": 2.0}, {"depth_mm": 4.0}],
        "warnings": [],
        "conformity": {"decision": "accepted"},
        **more,
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    (folder / "report.html").write_text("<h1>report</h1>")
    return folder


def aged(path: Path, by_s: float = 3600.0) -> None:
    at = time.time() - by_s
    os.utime(path, (at, at))


class Program:
    """What routes need of one."""

    def __init__(self, *surveys: Path) -> None:
        self.surveys = surveys
        self.told: list[tuple[str, Any]] = []
        self.hub = SimpleNamespace(tell=lambda topic, body: self.told.append((topic, body)))
        self._tasks: set[Any] = set()

    def spawn(self, work: Any) -> Any:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        return task


async def wrong(request: Any, error: Exception) -> Any:
    return refused(str(error), getattr(error, "status", 409))


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Callable[..., tuple[TestClient, Program]]]:
    opened: list[TestClient] = []

    def make(*folders: Path) -> tuple[TestClient, Program]:
        program = Program(*folders)
        app = Starlette(routes=routes(program, (sys.executable, "-c", CHILD)), exception_handlers={AnnulusError: wrong})
        client = TestClient(app)
        client.__enter__()
        opened.append(client)
        return client, program

    yield make
    for one in opened:
        one.__exit__(None, None, None)


def by_name(client: TestClient, name: str) -> dict[str, Any]:
    return next(one for one in client.get("/api/surveys").json()["entries"] if one["name"] == name)


def settled(client: TestClient, number: str, state: str) -> dict[str, Any]:
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        job = next(one for one in client.get("/api/surveys").json()["jobs"] if one["id"] == number)
        if job["state"] == state:
            return job
        time.sleep(0.02)
    raise AssertionError(job)


def test_recordings_scans_results_and_calibrations_are_listed(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", Part("s", 1), {"format": "annulus-calibration/1"})
    record(part_path(tmp_path / "a.mcap", 2), Part("s", 2))
    result(tmp_path / "deep/er/a-results")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder/frames.csv").write_text("index,file,light,z_mm\n0,0.png,led,5\n1,1.png,led,105.5\n")
    (tmp_path / "folder/job.toml").write_text('pipe = "P-7"\n')
    made = {"camera": {"utc": "2026-01-01T00:00:00+00:00"}}
    (tmp_path / "head.json").write_text(json.dumps({"format": "annulus-calibration/1", "provenance": made}))
    listing = Shelf([tmp_path]).look()
    found = {one.path.name: one.to_dict() for one in listing.entries}
    assert set(found) == {"a.mcap", "a-results", "folder"}
    a, results, folder = (found[name] for name in ("a.mcap", "a-results", "folder"))
    assert (a["kind"], a["parts"], a["frames"], a["length_mm"], a["job"]["pipe"]) == ("recording", 2, 10, 40.0, "P-1")
    assert a["state"] == "whole" and a["utc"].startswith("2027-01-15") and a["seconds"] == pytest.approx(0.16)
    assert (results["defects"], results["worst_mm"], results["verdict"]) == (2, 4.0, "accepted")
    assert (results["of"], results["files"], results["length_mm"]) == ("a.mcap", ["report.html", "summary.json"], 401.0)
    assert (folder["kind"], folder["frames"], folder["length_mm"], folder["job"]["pipe"]) == ("scan", 2, 100.5, "P-7")
    (calibration,) = listing.calibrations
    assert calibration.to_dict()["age_days"] > 300


def test_a_torn_recording_is_told_from_one_that_is_being_made(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", close=False)
    shelf = Shelf([tmp_path])
    assert shelf.look().entries[0].details["state"] == "open"
    aged(path)
    assert shelf.look().entries[0].details["state"] == "torn"


def test_what_did_not_change_is_not_looked_at_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in "abc":
        aged(record(tmp_path / f"{name}.mcap"))
    shelf, looked = Shelf([tmp_path]), []
    real = room.glance
    monkeypatch.setattr(room, "glance", lambda path: looked.append(path.name) or real(path))
    shelf.look()
    assert sorted(looked) == ["a.mcap", "b.mcap", "c.mcap"]
    record(tmp_path / "d.mcap")
    shelf.look()
    shelf.look()
    assert looked[3:] == ["d.mcap"]


def test_who_knows_the_list_is_not_sent_it_again(tmp_path: Path, client: Any) -> None:
    result(tmp_path / "a-results")
    web, _ = client(tmp_path)
    stamp = web.get("/api/surveys").json()["stamp"]
    assert web.get(f"/api/surveys?known={stamp}").json() == {"ok": True, "same": True, "stamp": stamp, "jobs": []}
    result(tmp_path / "b-results")
    assert len(web.get(f"/api/surveys?known={stamp}").json()["entries"]) == 2


def test_the_list_is_bounded_and_newest_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "ENTRIES_MAX", 3)
    for age, name in enumerate(("new", "newer", "old", "older", "oldest")):
        aged(result(tmp_path / name) / "summary.json", 100.0 * (age + 1))
    listing = Shelf([tmp_path]).look()
    assert [one.path.name for one in listing.entries] == ["new", "newer", "old"]
    assert listing.left_out == 2


def test_what_is_malformed_or_a_link_is_left_out(tmp_path: Path) -> None:
    outside = result(tmp_path / "outside/secret")
    folder = tmp_path / "shown"
    folder.mkdir()
    (folder / "link").symlink_to(outside)
    (folder / "x.mcap").write_bytes(b"not one")
    result(folder / "bad")
    (folder / "bad/summary.json").write_text('{"format": [' * 50)
    (folder / "gone.json").symlink_to("/etc/passwd")
    listing = Shelf([folder, tmp_path / "is-not-there"]).look()
    assert not listing.entries and not listing.calibrations


def test_only_what_is_on_the_list_is_given_out(tmp_path: Path, client: Any) -> None:
    folder = result(tmp_path / "shown/a-results")
    (tmp_path / "secret").write_text("secret")
    (folder / "secret").write_text("secret")
    (folder / "texture.png").symlink_to(tmp_path / "secret")
    web, _ = client(tmp_path / "shown")
    one = by_name(web, "a-results")
    report = web.get(f"/api/surveys/file/{one['id']}/report.html")
    assert report.status_code == 200 and report.text == "<h1>report</h1>"
    assert report.headers["content-type"] == "text/html; charset=utf-8"
    saved = web.get(f"/api/surveys/file/{one['id']}/summary.json")
    assert saved.headers["content-disposition"].startswith("attachment")
    for name in (
        "secret",
        "texture.png",
        "..%2fsecret",
        "%2e%2e/secret",
        "../secret",
        "..%2f..%2fsecret",
        "report.pdf",
    ):
        assert web.get(f"/api/surveys/file/{one['id']}/{name}").status_code == 404
    for number in ("nobody", "..", str(tmp_path)):
        assert web.get(f"/api/surveys/file/{number}/report.html").status_code == 404


def test_a_reconstruction_is_watched_and_lies_beside_its_scan(tmp_path: Path, client: Any) -> None:
    record(tmp_path / "a.mcap")
    (tmp_path / "head.json").write_text(json.dumps({"format": "annulus-calibration/1"}))
    result(tmp_path / "a-results")
    web, program = client(tmp_path)
    one = by_name(web, "a.mcap")
    without = web.post("/api/surveys/reconstruct", json={"scan": one["id"]})
    assert without.status_code == 409 and "carries no calibration" in without.json()["error"]
    (calibration,) = web.get("/api/surveys").json()["calibrations"]
    asked = web.post("/api/surveys/reconstruct", json={"scan": one["id"], "calibration": calibration["id"]})
    job = settled(web, asked.json()["id"], "done")
    assert (job["place"], job["done"], job["total"], job["error"]) == ("a-results-2", 100, 100, "")
    argv = json.loads((tmp_path / "a-results-2/summary.json").read_text())["argv"]
    assert argv[-2:] == ["--calibration", str(tmp_path / "head.json")] and argv[4:6] == ["--progress", "json"]
    told = [body["jobs"][0] for topic, body in program.told if topic == "reconstruct"]
    assert [told[0]["state"], told[-1]["state"]] == ["waiting", "done"]
    assert not list(tmp_path.glob(".*"))


def test_one_that_fails_says_why_in_one_line_and_leaves_nothing(tmp_path: Path, client: Any) -> None:
    record(tmp_path / "bad.mcap", calibration={})
    web, _ = client(tmp_path)
    asked = web.post("/api/surveys/reconstruct", json={"scan": by_name(web, "bad.mcap")["id"]})
    job = settled(web, asked.json()["id"], "failed")
    assert job["error"] == "bad.mcap: no calibration fits. Expected one."
    assert [path.name for path in tmp_path.iterdir()] == ["bad.mcap"]


def test_one_that_is_given_up_ends_with_all_it_started_and_the_next_begins(tmp_path: Path, client: Any) -> None:
    record(tmp_path / "slow.mcap", calibration={})
    record(tmp_path / "b.mcap", calibration={})
    web, _ = client(tmp_path)
    slow, other = by_name(web, "slow.mcap")["id"], by_name(web, "b.mcap")["id"]
    numbers = [web.post("/api/surveys/reconstruct", json={"scan": one}).json()["id"] for one in (slow, other, other)]
    settled(web, numbers[0], "running")
    while not (tmp_path / "pids").is_file() or not (tmp_path / "pids").read_text():
        time.sleep(0.01)
    assert web.post("/api/surveys/cancel", json={"id": numbers[2]}).status_code == 200
    assert web.post("/api/surveys/cancel", json={"id": numbers[0]}).status_code == 200
    settled(web, numbers[0], "cancelled")
    settled(web, numbers[2], "cancelled")
    settled(web, numbers[1], "done")
    assert not list(tmp_path.glob(".*")) and not (tmp_path / "slow-results").exists()
    state = Path(f"/proc/{(tmp_path / 'pids').read_text()}/stat")
    assert not state.exists() or state.read_text().rsplit(") ", 1)[1][0] in "ZX"
    assert web.post("/api/surveys/cancel", json={"id": numbers[0]}).status_code == 409


def test_few_wait_and_what_is_being_recorded_is_not_reconstructed(tmp_path: Path, client: Any) -> None:
    record(tmp_path / "slow.mcap", calibration={})
    record(tmp_path / "open.mcap", close=False)
    web, _ = client(tmp_path)
    under_way = web.post("/api/surveys/reconstruct", json={"scan": by_name(web, "open.mcap")["id"]})
    assert under_way.status_code == 409 and "is being recorded" in under_way.json()["error"]
    slow = by_name(web, "slow.mcap")["id"]
    first = web.post("/api/surveys/reconstruct", json={"scan": slow}).json()["id"]
    settled(web, first, "running")
    answers = [web.post("/api/surveys/reconstruct", json={"scan": slow}).status_code for _ in range(6)]
    assert answers == [200] * 4 + [409] * 2
    for job in web.get("/api/surveys").json()["jobs"]:
        web.post("/api/surveys/cancel", json={"id": job["id"]})
    settled(web, first, "cancelled")


@pytest.mark.parametrize("asked", [{}, {"scan": 7}, {"scan": "../a"}, {"scan": None, "calibration": []}, [1]])
def test_what_is_malformed_is_refused(tmp_path: Path, client: Any, asked: Any) -> None:
    web, _ = client(tmp_path)
    answer = web.post("/api/surveys/reconstruct", json=asked)
    assert answer.status_code in (400, 404) and "\n" not in answer.json()["error"]
