"""Windows of a scan under fringes: the same bits wherever they are measured, kept, found again, and not believed."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from plates import LEFT
from results_hash import results_hash
from test_reconstruct import calibration, scan

from annulus_pipe.reprocess.executors import Executor, Processes, in_process
from annulus_pipe.reprocess.ranges import FOLDER
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.twin.scan import write_scan
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.heads import series_world
from annulus_pipe.wings.fringe.job import open_fringe
from annulus_pipe.wings.fringe.measure.plate import Plate
from annulus_pipe.wings.fringe.plate import measured_window, reconstruct_fringe
from annulus_pipe.wings.fringe.windows import FringeWindowWork
from tools.bench.dask_processes import Cluster

PLACES = np.cumsum([1.0, 0.9, 1.2, 1.1] * 9)[:30]  # mm; of a flash: two windows, of which 18 flashes are in both


def same(one: Plate, other: Plate) -> bool:
    names = [each.name for each in fields(Plate) if each.name not in ("timing_ms", "windows", "made")]
    pairs = [(getattr(one, name), getattr(other, name)) for name in names]
    return all(np.array_equal(a, b, equal_nan=True) if isinstance(a, np.ndarray) else a == b for a, b in pairs)


def test_a_window_is_the_same_bits_elsewhere_and_is_measured_once(tmp_path: Path) -> None:
    job = open_fringe(scan(tmp_path / "scan", PLACES.tolist(), heads=(LEFT,)), calibration(tmp_path))
    place = StoragePath(tmp_path / "kept")

    def measured(executor: Executor, place: StoragePath | None = None) -> tuple[Plate, int]:
        plate = reconstruct_fringe(job, None, executor, place)
        assert plate.windows == 2
        return plate, plate.made

    whole, _ = measured(in_process)
    apart, made = measured(Processes(1, apart=True), place)
    assert same(apart, whole) and made == 2
    first, second = place.names(f"{FOLDER}/")
    held = (tmp_path / "kept" / second).read_bytes()
    entry = held.index(b"PK\x01\x02")  # of the archive's directory; a flag there says that a member is encrypted
    locked = held[: entry + 8] + bytes([held[entry + 8] ^ 1]) + held[entry + 9 :]
    for content, new in ((held, 0), (held[:-500], 1), (locked, 1)):
        (tmp_path / "kept" / second).write_bytes(content)
        again, made = measured(in_process, place)
        assert same(again, whole) and made == new
    foreign = FringeWindowWork(job, measured_window, None, place, "another version")  # type: ignore[arg-type]
    with pytest.raises(AnnulusError, match="with other code"):
        foreign.ready()
    (tmp_path / "kept" / first).unlink()
    again, made = measured(in_process, place)
    assert same(again, whole) and made == 1


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with Cluster() as started:
        started.hire(2)
        yield started


@pytest.mark.timeout(900)
@pytest.mark.deep(
    gate="tests/wings/fringe/test_windows.py::test_a_window_is_the_same_bits_elsewhere_and_is_measured_once"
)
def test_reprocess_makes_one_hash_in_one_process_in_two_and_on_a_cluster(tmp_path: Path, cluster: Cluster) -> None:
    write_scan(series_world(travel_mm=46.0).scaled(320), tmp_path / "scan", 46)
    given = "--calibration", str(tmp_path / "scan/calibration.json")

    def command(*words: object) -> None:
        done = subprocess.run(
            [Path(sys.executable).with_name("annulus"), *map(str, words)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr

    command("reconstruct", tmp_path / "scan", *given, "-o", tmp_path / "warm")  # compiles
    command("reconstruct", tmp_path / "scan", *given, "-o", tmp_path / "whole")
    hashes = {"whole": results_hash(tmp_path / "whole")}
    engines = {
        "one": ("--workers", 1),
        "two": ("--workers", 2),
        "cluster": ("--engine", "dask", "--scheduler", cluster.url),
    }
    for name, engine in engines.items():
        command("reprocess", tmp_path / "scan", *given, "-o", tmp_path / name, *engine)
        hashes[name] = results_hash(tmp_path / name / "scan")
        assert len(StoragePath(tmp_path / name / "scan").names(f"{FOLDER}/")) > 1
    assert len(set(hashes.values())) == 1, hashes
