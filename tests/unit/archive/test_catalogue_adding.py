"""What is added to a catalogue comes out of it, whole and once, whoever else adds and whatever breaks."""

import math
import multiprocessing
import os
import shutil
import signal
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from annulus_pipe.archive.catalogue import Added, Refused, add, checked, listed, open_catalogue, results_of, store
from annulus_pipe.archive.catalogue.pieces import pack
from annulus_pipe.archive.catalogue.store import pack_folders, survey_folder, survey_ids
from annulus_pipe.job import JobSheet
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.speed.catalogue import results

MAY = datetime(2026, 5, 4, 8)


def season(folder: Path, count: int, stations: int = 5) -> list[Path]:
    return [
        results(folder / f"r{i}", f"P-{i}", MAY.replace(minute=i % 60, hour=i // 60), stations, i) for i in range(count)
    ]


def one(done: list[Added | Refused]) -> Added:
    (added,) = done
    assert isinstance(added, Added), added
    return added


def test_the_same_results_are_one_survey_wherever_they_lie(tmp_path: Path) -> None:
    (folder,) = season(tmp_path, 1)
    first = one(add(tmp_path / "archive", [folder]))
    copy = shutil.copytree(folder, tmp_path / "elsewhere")
    again = one(add(tmp_path / "archive", [copy]))
    assert first.new and not again.new and first.row["survey"] == again.row["survey"]
    assert len(listed(tmp_path / "archive")[0]) == 1


def test_results_made_anew_count_in_place_of_the_old_which_stay(tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    old = one(add(archive, [results(tmp_path / "a", "P-1", MAY, 5, 1)]))
    new = one(add(archive, [results(tmp_path / "b", "P-1", MAY, 5, 2, created="2026-06-01T00:00:00+00:00")]))
    assert new.new and new.supersedes == [old.row["survey"]]
    rows, hidden, _ = listed(archive)
    assert [row["survey"] for row in rows] == [new.row["survey"]] and hidden == 1
    both = {row["survey"]: row["superseded_by"] for row in listed(archive, superseded=True)[0]}
    assert both == {old.row["survey"]: new.row["survey"], new.row["survey"]: None}
    with open_catalogue(archive) as catalogue:
        count = catalogue.connection.execute(
            "SELECT (SELECT count(*) FROM stations), count(*) FROM all_stations"
        ).fetchone()
    assert count == (5, 10)


def test_older_results_added_later_do_not_count(tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    new = one(add(archive, [results(tmp_path / "b", "P-1", MAY, 5, 2, created="2026-06-01T00:00:00+00:00")]))
    old = one(add(archive, [results(tmp_path / "a", "P-1", MAY, 5, 1)]))
    assert old.superseded_by == new.row["survey"]


def test_scans_that_say_no_time_are_never_taken_for_one_another(tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    made = [results(tmp_path / n, "P-1", MAY, 5, i, origin={}) for i, n in enumerate("ab")]
    first, _ = add(archive, made)
    assert isinstance(first, Added) and len(listed(archive)[0]) == 2
    third = results(tmp_path / "c", "P-1", MAY, 5, 7, origin={}, created="2026-06-01T00:00:00+00:00")
    assert one(add(archive, [third], replaces=first.row["survey"])).supersedes == [first.row["survey"]]
    assert len(listed(archive)[0]) == 2
    with pytest.raises(AnnulusError, match="made before"):
        add(archive, [results(tmp_path / "d", "P-1", MAY, 5, 8, created="2020-01-01")], replaces=first.row["survey"])


def test_a_job_given_goes_over_what_the_results_say_and_the_results_are_still_found(tmp_path: Path) -> None:
    archive, (folder,) = tmp_path / "archive", season(tmp_path, 1)
    added = one(add(archive, [folder], JobSheet(pipe="main 7", date="2025-01-02", nominal_diameter_mm=150.0)))
    assert added.row["pipe"] == "main 7" and str(added.row["date"]) == "2025-01-02" and added.row["date_of"] == "job"
    for name in ("main 7", "main 7@2025", "main 7@2025-01-02", added.row["survey"], added.row["survey"][:6]):
        assert results_of(archive, name) == folder


def test_a_clock_that_was_never_set_gives_no_date(tmp_path: Path) -> None:
    folder = results(tmp_path / "a", "P-1", MAY, 5, origin={"begun_utc": "1970-01-01T00:03:00+00:00"})
    assert one(add(tmp_path / "archive", [folder])).row["date"] is None


def test_what_may_not_apply_to_a_scan_is_kept_with_what_it_hangs_on(tmp_path: Path) -> None:
    words = {"text": "diameters keep ± 0.1 %", "standing": "cannot be told", "reasons": ["the day is not known"]}
    stated = {"accuracy": {**words, "percent": 0.1}, "detection": [{"of": "detection of loss", **words}]}
    row = one(add(tmp_path / "archive", [results(tmp_path / "a", "P-1", MAY, 5, qualification=stated)])).row
    assert row["certificate"] == "diameters keep ± 0.1 % (if it is so: the day is not known)"
    assert row["detection"] == f"detection of loss: {row['certificate']}"


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("name", ["P-9", "P-0@2025", "ffff", "P-0@x", "", "'; DROP TABLE surveys", "\udc80"])
def test_a_survey_that_there_is_not_is_one_line(tmp_path: Path, name: str) -> None:
    add(tmp_path / "archive", season(tmp_path, 1))
    with pytest.raises(AnnulusError, match="no such survey"):
        results_of(tmp_path / "archive", name)


def test_results_that_are_others_by_now_or_gone_are_told(tmp_path: Path) -> None:
    archive, (folder,) = tmp_path / "archive", season(tmp_path, 1)
    add(archive, [folder])
    results(folder, "P-0", MAY, 5, seed=99)
    with pytest.raises(AnnulusError, match="other results"):
        results_of(archive, "P-0")
    shutil.rmtree(folder)
    with pytest.raises(AnnulusError, match="not there any more"):
        results_of(archive, "P-0")


def broken(folder: Path, **over: Any) -> Path:
    return results(folder, "P", MAY, 5, **over)


def rewritten(folder: Path, name: str, text: str) -> Path:
    (broken(folder) / name).write_text(text)
    return folder


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda f: f, "No such file"),
        (lambda f: rewritten(f, "summary.json", "{"), "not JSON"),
        (lambda f: rewritten(f, "summary.json", "[" * 100_000), "nested"),
        (lambda f: rewritten(f, "stations.csv", "z_mm\n1"), "no column"),
        (lambda f: rewritten(f, "stations.csv", "\0\1"), "stations.csv"),
        (lambda f: broken(f, format="annulus-summary/9"), "annulus-summary/9"),
        (lambda f: broken(f, scanned_mm={"from": 9, "to": 1}), "before it begins"),
        (lambda f: broken(f, origin={"begun_utc": "yesterday"}), "expected an ISO time"),
        (lambda f: broken(f, origin={"begun_utc": "0001-01-01T00:00:00+14:00"}), "expected an ISO time"),
        (lambda f: broken(f, job={"date": "0999-01-01"}), "expected a day of"),
        (lambda f: broken(f, defects=[{"kind": "loss"}]), "z_mm"),
        (lambda f: broken(f, defects={}), "must be a list"),
        (lambda f: broken(f, warnings=7), "warnings"),
        (lambda f: broken(f, points=-1), "points"),
        (lambda f: broken(f, source="x" * 3000), "source"),
        (lambda f: broken(f, origin={"calibration": {str(i): {"a": "b" * 900} for i in range(30)}}), "characters"),
    ],
)
def test_one_line_for_wrong_results_and_the_others_are_added(tmp_path: Path, make: Any, told: str) -> None:
    bad, (good,) = make(tmp_path / "bad"), season(tmp_path, 1)
    refused, added = add(tmp_path / "archive", [bad, good])
    assert isinstance(refused, Refused) and told in refused.why and "\n" not in refused.why
    assert isinstance(added, Added) and added.new


def test_a_folder_with_other_things_is_left_alone(tmp_path: Path) -> None:
    (folder,) = season(tmp_path, 1)
    with pytest.raises(AnnulusError, match="other things"):
        add(folder, [folder])
    with pytest.raises(AnnulusError, match="folder of this computer"):
        add(Path("s3://bucket/archive"), [folder])
    (tmp_path / "file").write_text("")
    with pytest.raises(AnnulusError, match="cannot be written"):
        add(tmp_path / "file" / "archive", [folder])


def test_a_catalogue_of_a_newer_annulus_is_not_touched(tmp_path: Path) -> None:
    archive, (folder,) = tmp_path / "archive", season(tmp_path, 1)
    add(archive, [folder])
    (archive / "catalogue.json").write_text('{"format": "annulus-catalogue/2"}')
    for act in (lambda: add(archive, [folder]), lambda: listed(archive), lambda: results_of(archive, "P-0")):
        with pytest.raises(AnnulusError, match=r"annulus-catalogue/2.*newer annulus"):
            act()


def test_packs_say_the_same_as_the_surveys_own_files(tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    add(archive, season(tmp_path, 12))
    ask = "SELECT survey, pipe, date, z_mm, diameter_mean_mm FROM all_stations ORDER BY ALL"
    with open_catalogue(archive) as catalogue:
        loose = catalogue.connection.execute(ask).fetchall()
    assert pack(archive, at=5) is not None and pack(archive, at=5) is None
    with open_catalogue(archive) as catalogue:
        assert len(catalogue.pieces.packs) == 1 and not catalogue.pieces.loose
        assert catalogue.connection.execute(ask).fetchall() == loose
        first = catalogue.connection.execute("SELECT survey FROM surveys ORDER BY survey").fetchone()
    shutil.rmtree(survey_folder(archive, first[0]))
    assert len(listed(archive)[0]) == 11
    with open_catalogue(archive) as catalogue:
        assert len(catalogue.connection.execute(ask).fetchall()) == len(loose) - 5


@pytest.mark.deep(gate="tests/unit/archive/test_catalogue_adding.py::test_packs_say_the_same_as_the_surveys_own_files")
def test_packs_stay_few(tmp_path: Path) -> None:
    archive, made = tmp_path / "archive", season(tmp_path, 24, stations=2)
    for i in range(0, 24, 3):
        add(archive, made[i : i + 3])
        assert pack(archive, at=3) is not None
        with open_catalogue(archive) as catalogue:
            sizes = [len(one.members) for one in catalogue.pieces.packs]
            assert sum(sizes) == i + 3 and len(sizes) <= 1 + math.log2(i + 3)
    young = len(pack_folders(archive))
    for _, folder in pack_folders(archive):
        os.utime(folder, (time.time() - 7200, time.time() - 7200))
    pack(archive)
    assert len(pack_folders(archive)) < young and len(listed(archive)[0]) == 24


def _add_all(archive: Path, folders: list[Path], go: Any) -> None:
    go.wait()
    add(archive, folders)


@pytest.mark.deep(gate="tests/unit/archive/test_catalogue_adding.py::test_a_disk_that_fills_up_leaves_nothing_half")
def test_two_who_add_at_once_lose_nothing(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    made, go = season(tmp_path, 20), context.Event()
    halves = [made[:14], made[6:]]  # eight are added by both
    both = [context.Process(target=_add_all, args=(tmp_path / "archive", half, go)) for half in halves]
    for process in both:
        process.start()
    go.set()
    for process in both:
        process.join(240)
        assert process.exitcode == 0
    rows, hidden, damage = listed(tmp_path / "archive")
    assert sorted(row["pipe"] for row in rows) == sorted(f"P-{i}" for i in range(20)) and not hidden and not damage
    assert not list(checked(tmp_path / "archive"))
    assert not list((tmp_path / "archive").rglob(".new-*"))


@pytest.mark.deep(gate="tests/unit/archive/test_catalogue_adding.py::test_a_disk_that_fills_up_leaves_nothing_half")
def test_who_is_killed_while_adding_leaves_nothing_half(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    archive, made, go = tmp_path / "archive", season(tmp_path, 40), context.Event()
    process = context.Process(target=_add_all, args=(archive, made, go))
    process.start()
    go.set()
    while process.is_alive() and len(survey_ids(archive)) < 3:
        time.sleep(0.005)
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    there = survey_ids(archive)
    assert not list(checked(archive)) and len(listed(archive)[0]) == len(there)
    for left in archive.rglob(".new-*"):
        os.utime(left, (time.time() - 7200, time.time() - 7200))
    again = add(archive, made)
    assert sum(isinstance(done, Added) and done.new for done in again) == 40 - len(there)
    assert len(listed(archive)[0]) == 40 and not list(archive.rglob(".new-*"))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("stage", ["_write", "_to_disk"])
def test_a_disk_that_fills_up_leaves_nothing_half(tmp_path: Path, stage: str, monkeypatch: pytest.MonkeyPatch) -> None:
    archive, made = tmp_path / "archive", season(tmp_path, 2)
    add(archive, made[:1])
    real, calls = getattr(store, stage), [0]

    def full(*given: Any) -> None:
        calls[0] += 1
        if calls[0] == 3:
            raise OSError(28, "No space left on device")
        real(*given)

    monkeypatch.setattr(store, stage, full)
    with pytest.raises(AnnulusError, match="No space left"):
        add(archive, made[1:])
    assert len(listed(archive)[0]) == 1 and not list(archive.rglob(".new-*"))


def test_a_damaged_survey_is_found_and_mended_by_adding_it_again(tmp_path: Path) -> None:
    archive, made = tmp_path / "archive", season(tmp_path, 3)
    survey = one(add(archive, made[:1])).row["survey"]
    add(archive, made[1:])
    file = survey_folder(archive, survey) / "stations.parquet"
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 0x40
    file.write_bytes(data)
    (line,) = checked(archive)
    assert survey in line
    assert one(add(archive, made[:1])).new
    assert not list(checked(archive)) and len(listed(archive)[0]) == 3


def test_a_file_of_another_survey_is_no_survey_of_this_one(tmp_path: Path) -> None:
    archive = tmp_path / "archive"
    first, second = (one(add(archive, [made])).row["survey"] for made in season(tmp_path, 2))
    shutil.copy(survey_folder(archive, first) / "stations.parquet", survey_folder(archive, second))
    (line,) = checked(archive)
    assert second in line and "not those that were added" in line


@pytest.mark.deep(
    gate="tests/unit/archive/test_catalogue_adding.py::test_scans_that_say_no_time_are_never_taken_for_one_another"
)
def test_names_that_are_sql_or_markup_do_no_harm(tmp_path: Path) -> None:
    archive = tmp_path / "archi've [1]*?"
    hostile = ["P'; DROP TABLE surveys; --", 'P"', "<script>", "[red]P[/red]", "P\\", "$(rm -rf /)"]
    for i, name in enumerate(hostile):
        add(archive, [results(tmp_path / f"{i}", name, MAY.replace(minute=i), 5, i)])
    pack(archive, at=3)
    assert sorted(row["pipe"] for row in listed(archive)[0]) == sorted(hostile)
    for i, name in enumerate(hostile):
        assert [row["pipe"] for row in listed(archive, pipe=name)[0]] == [name]
        assert results_of(archive, name) == tmp_path / f"{i}"
