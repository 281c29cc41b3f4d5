"""Promises of a dask cluster: the same bits as in one process, whatever dies meanwhile, and nothing measured twice.

One cluster for all: a worker takes seconds of processor before it can do anything. Its scheduler gives an item up at
the first death (four by default), so that few workers have to die.
"""

import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from results_hash import results_hash
from toil import Toil

from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.report import ScanAccount, write
from annulus_pipe.reprocess.cluster import Dask, Tls
from annulus_pipe.reprocess.engine import Reprocessed, reprocess
from annulus_pipe.reprocess.executors import Failed, Processes, in_process
from annulus_pipe.reprocess.gather import gathered, in_ranges
from annulus_pipe.reprocess.job import Job, open_job
from annulus_pipe.reprocess.ranges import FOLDER
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import WorldFeature, clean_world
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wall.profile import Profile
from tools.bench.dask_processes import Cluster

pytestmark = [
    pytest.mark.timeout(900),
    pytest.mark.deep(
        gate="tests/unit/reprocess/test_desk.py::test_every_item_comes_back_once_whatever_asking_for_some_of_them_raises"
    ),
]
FRAMES = 60  # 48 of the projector: six ranges of one chunk
RANGES = 6


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pocket = WorldFeature("pocket", z_mm=90.0, length_mm=24.0, depth_mm=3.0, clock_deg=80.0, arc_deg=30.0)
    world = replace(clean_world(travel_mm=100.0).scaled(416), features=(pocket,), roll_deg=10.0)
    path, renderer = tmp_path_factory.mktemp("scan") / "scan.mcap", Renderer(world)
    size = world.camera.width, world.camera.height
    with RecordingWriter(path, calibration=world.calibration().to_dict(), configuration={}, now_ns=0) as writer:
        for i, z in enumerate(np.linspace(0.0, world.travel_mm, FRAMES)):
            pose, label = world.pose(z), Label.LED if i % 5 == 4 else Label.PROJECTOR
            raw = renderer.render(pose, z, float(label is Label.PROJECTOR), float(label is Label.LED), seed=i)
            roll = float(np.degrees(pose.roll or 0.0)) if i % 3 == 0 else None
            header = FrameHeader(i, None, i * 10**7, label, "", None, None, None, float(z), "bayer_rggb8", *size, roll)
            writer.frame(header.to_dict(), raw, i * 10**7)
    return path


@pytest.fixture(scope="module")
def job(scan: Path) -> Job:
    return open_job(scan)


@pytest.fixture(scope="module")
def whole(job: Job) -> Reprocessed:
    """What annulus reconstruct makes of it."""
    return reprocess(job)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    environment = {"PYTHONPATH": os.fspath(Path(__file__).parent), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    with Cluster(environment=environment) as started:
        started.hire(2)
        yield started


def digest(profiles: tuple[Profile, ...]) -> str:
    told = [replace(profile, timing_ms={}).to_dict() for profile in profiles]
    return hashlib.sha256(repr(told).encode()).hexdigest()


def written(done: Reprocessed, folder: Path) -> str:
    folder.mkdir(exist_ok=True)
    write(done.survey(), ScanAccount("scan", done.frames, done.drops, done.timing_ms, done.findings), folder)
    return results_hash(folder)


def test_local_workers_make_the_same_bits_and_resume_what_is_sound(
    job: Job, whole: Reprocessed, tmp_path: Path
) -> None:
    place = StoragePath(tmp_path)
    alone = in_ranges(job, place, in_process, chunks=1)
    assert [one.made for one in alone.facts] == [True] * RANGES
    assert digest(gathered(alone, place, 0.0).profiles) == digest(whole.profiles)
    names = place.names(f"{FOLDER}/")
    torn, gone, wrong = names[1], names[3], names[4]
    held = (tmp_path / wrong).read_bytes()
    (tmp_path / torn).write_bytes((tmp_path / torn).read_bytes()[:-500])
    (tmp_path / gone).unlink()
    (tmp_path / wrong).write_bytes(held[:2000] + bytes([held[2000] ^ 1]) + held[2001:])
    again = in_ranges(job, place, Processes(2), chunks=1)
    assert [one.made for one in again.facts] == [name in (torn, gone, wrong) for name in names]
    assert digest(gathered(again, place, 0.0).profiles) == digest(whole.profiles)


def _another_scipy(folder: Path) -> Path:
    """What a worker imports before the true one, and says that it is another version."""
    (folder / "sitecustomize.py").write_text("import scipy; scipy.__version__ = '0.0'")
    return folder


def test_what_cannot_be_done_is_left_out_and_a_worker_with_other_libraries_is_refused(
    cluster: Cluster, tmp_path: Path
) -> None:
    """4 (a bug) and 9 always raise."""
    said: list[str] = []
    usual = cluster.environment["PYTHONPATH"]
    cluster.environment["PYTHONPATH"] = f"{_another_scipy(tmp_path)}:{usual}"
    cluster.hire(1)  # a stranger
    cluster.environment["PYTHONPATH"] = usual
    work, items = Toil(tmp_path, raises=frozenset({4, 9})), range(60)
    told = dict(Dask(cluster.url, tries=2, say=said.append)(work, items))
    bug, known = told.pop(4), told.pop(9)
    assert told == {n: n * n for n in items if n not in (4, 9)}
    assert isinstance(bug, Failed) and bug.why == "TwoPartError: item 4 is a bug" and bug.tries == 2
    assert isinstance(known, Failed) and known.why == "item 9 cannot be done"
    assert work.tried(9) == 2
    while not any("refused" in line for line in said):  # it may have come late
        assert dict(Dask(cluster.url, say=said.append)(Toil(tmp_path), range(20, 30)))
    assert sum("refused, it has scipy 0.0 for" in line for line in said) == len(said)
    cluster.kill(2)


def test_one_hash_with_a_worker_killed_and_the_scheduler_begun_anew(
    cluster: Cluster, job: Job, whole: Reprocessed, tmp_path: Path
) -> None:
    place, said, seen = StoragePath(tmp_path / "place"), [], []

    def progress(stage: str, done: int, total: int) -> None:
        seen.append(done)
        if len(seen) == 2:
            cluster.kill(0)
            cluster.hire(1)
        if len(seen) == 4:
            cluster.end()
            cluster.begin()
            cluster.hire(2)

    ranged = in_ranges(job, place, Dask(cluster.url, say=said.append), progress, chunks=1)
    assert len(ranged.facts) == RANGES and not ranged.left_out and seen[-1] == len(whole.profiles)
    assert any("lost. Its" in line for line in said)
    done = gathered(ranged, place, 0.0)
    assert digest(done.profiles) == digest(whole.profiles)
    assert written(done, tmp_path / "here") == written(whole, tmp_path / "there")
    again = in_ranges(job, place, Dask(cluster.url), chunks=1)
    assert again.made == 0 and digest(gathered(again, place, 0.0).profiles) == digest(whole.profiles)


def test_the_commands_make_one_hash_with_one_two_and_five_workers_here_and_of_a_cluster(
    cluster: Cluster, scan: Path, tmp_path: Path
) -> None:
    living = [n for n, worker in enumerate(cluster.workers) if worker.poll() is None]
    for number in living[1:]:
        cluster.kill(number)
    if not living:
        cluster.hire(1)
    command("reconstruct", scan, "-o", tmp_path / "reference", "--workers", 1)
    hashes = {"reconstruct": results_hash(tmp_path / "reference")}
    for workers, more in ((1, 0), (2, 1), (5, 3)):
        cluster.hire(more)
        for engine in (("--workers", workers), ("--engine", "dask", "--scheduler", cluster.url)):
            out = tmp_path / f"{engine[-1]}-{workers}".replace("/", "-")
            command("reprocess", scan, "-o", out, *engine)
            hashes[out.name] = results_hash(out / "scan")
    assert len(hashes) == 7 and len(set(hashes.values())) == 1, hashes


def command(*arguments: object) -> None:
    done = subprocess.run(
        [Path(sys.executable).with_name("annulus"), *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_what_kills_every_worker_is_given_up_and_the_rest_is_done(cluster: Cluster, tmp_path: Path) -> None:
    work = Toil(tmp_path, kills=frozenset({5}))
    told = {}
    for number, outcome in Dask(cluster.url)(work, range(12)):
        told[number] = outcome
        if number == 0:
            cluster.hire(2)  # who keeps a cluster puts others in place of the dead
    failed = told.pop(5)
    assert isinstance(failed, Failed) and "died" in failed.why
    assert told == {n: n * n for n in range(12) if n != 5}


def test_over_tls_both_sides_are_known_by_their_certificates(tmp_path: Path) -> None:
    key, cert = tmp_path / "key.pem", tmp_path / "cert.pem"
    made = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-days",
        "2",
    ]
    subprocess.run(
        [*made, "-keyout", key, "-out", cert, "-subj", "/CN=127.0.0.1", "-addext", "subjectAltName=IP:127.0.0.1"],
        check=True,
        capture_output=True,
    )
    files = ("--tls-ca-file", os.fspath(cert), "--tls-cert", os.fspath(cert), "--tls-key", os.fspath(key))
    with Cluster(files, environment={"PYTHONPATH": os.fspath(Path(__file__).parent)}) as cluster:
        cluster.hire(1)
        (tmp_path / "work").mkdir()
        told = dict(Dask(cluster.url, Tls(cert, cert, key))(Toil(tmp_path / "work"), range(5)))
        assert told == {n: n * n for n in range(5)}
        with pytest.raises(AnnulusError, match="no scheduler answers"):
            dict(Dask(cluster.url.replace("tls", "tcp"), patience_s=1.0)(Toil(tmp_path / "work"), range(5)))
