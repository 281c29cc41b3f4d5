"""One odd file in a surveys folder took the list from everybody: a field of over 128 KiB in a frames.csv (csv.Error is
no ValueError), a pipe by a file's name; and what lay beyond 20 000 names, or took long, was not said."""

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from annulus_pipe.console import shelf as room
from annulus_pipe.console.shelf import Listing, Shelf

HEAD = "index,file,light,z_mm\n"


def written(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def piped(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    os.mkfifo(path)


def results(folder: Path, text: str) -> None:
    written(folder / "report.html", "")
    written(folder / "summary.json", text)


def looked(*folders: Path) -> Listing:
    """Within a time, or not at all."""
    found: list[Listing] = []
    thread = threading.Thread(target=lambda: found.append(Shelf(folders).look()), daemon=True)
    thread.start()
    thread.join(30)
    assert found, "it hangs, or raised"
    return found[0]


ODD: dict[str, Callable[[Path], object]] = {
    "a long field": lambda at: written(at / "frames.csv", f"{HEAD}0,{'a' * 200_000},led,1\n"),
    "a pipe for a table": lambda at: piped(at / "frames.csv"),
    "a quote that never closes": lambda at: written(at / "frames.csv", f'{HEAD}0,"' + "a\n" * 100_000),
    "a long name of a column": lambda at: written(at / "frames.csv", "a" * 200_000 + "\n1\n"),
    "a pipe for a job": lambda at: (written(at / "frames.csv", HEAD), piped(at / "job.toml")),
    "a pipe for a calibration": lambda at: (written(at / "frames.csv", HEAD), piped(at / "calibration.json")),
    "a pipe for a recording": lambda at: piped(at / "a.mcap"),
    "a pipe for a part": lambda at: (written(at / "a.mcap", "x"), piped(at / "a-002.mcap")),
    "a pipe for a summary": lambda at: (written(at / "report.html", ""), piped(at / "summary.json")),
    "a number of 400 digits": lambda at: results(at, f'{{"format": "annulus-x", "job": 1{400 * "0"}}}'),
    "a time at the end of time": lambda at: written(
        at / "c.json", json.dumps({"format": "annulus-calibration/1", "provenance": {"a": {"utc": "0001-01-01"}}})
    ),
    "lists in lists": lambda at: results(at, "[" * 100_000),
}


@pytest.mark.deep(but=2)
@pytest.mark.parametrize("what", ODD)
def test_the_others_are_listed(what: str, tmp_path: Path) -> None:
    ODD[what](tmp_path / "odd")
    written(tmp_path / "whole/frames.csv", f"{HEAD}0,a.png,led,1\n1,b.png,led,3\n")
    listing = looked(tmp_path)
    (whole,) = [one for one in listing.entries if one.path.name == "whole"]
    assert (whole.details["frames"], whole.details["from_mm"], whole.details["to_mm"]) == (2, 1.0, 3.0)
    assert all(one.details.get("frames") in (None, 0, 1) for one in listing.entries if one.path.name == "odd")


def test_what_is_beyond_the_bound_is_counted_and_costs_the_next_folder_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "SEEN_MAX", 20)
    (tmp_path / "many").mkdir()
    for n in range(50):
        (tmp_path / f"many/{n}").touch()
    written(tmp_path / "few/a/frames.csv", HEAD)
    listing = looked(tmp_path / "many", tmp_path / "few")
    assert listing.left_out == 30 and [one.path.name for one in listing.entries] == ["a"]


def test_a_look_takes_a_bounded_time_and_says_what_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "LOOK_S", 0.0)
    for n in range(4):
        written(tmp_path / f"{n}/frames.csv", HEAD)
        os.utime(tmp_path / f"{n}/frames.csv", (1000 + n, 1000 + n))
    shelf = Shelf([tmp_path])
    seen = [(len(listing.entries), listing.waiting) for listing in (shelf.look() for _ in range(5))]
    assert seen == [(1, 3), (2, 2), (3, 1), (4, 0), (4, 0)]
    assert [one.path.name for one in shelf.listing.entries] == ["3", "2", "1", "0"]


def test_many_recordings_of_one_folder_are_named_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """1600 took 21 s a look: for each the whole folder was listed, twice."""
    for n in range(200):
        (tmp_path / f"{n}.mcap").touch()
    listed = []
    real = os.listdir
    monkeypatch.setattr(os, "listdir", lambda path: listed.append(path) or real(path))
    monkeypatch.setattr(Path, "glob", lambda *_: pytest.fail("a folder is listed for each recording"))
    looked(tmp_path)
    assert len(listed) < 10
