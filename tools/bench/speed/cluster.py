"""What a cluster costs: a task in scheduler, client and worker, its bytes, and a scan against the serial run.

    python -m tools.bench speed cluster

Scheduler and workers are dask's programs on loopback, one thread each, BLAS and OpenCV too. Processor time is what
counts: it is the same on a machine that others use, while the clock is not. Frames are the head's own, ranges those of
every scan. The last rows are arithmetic, not measured: how many workers one core of each kind would keep busy.
"""

import os
import pickle
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.reprocess.cluster import Dask, packed
from annulus_pipe.reprocess.engine import measure
from annulus_pipe.reprocess.executors import Executor, Failed, Processes, in_process
from annulus_pipe.reprocess.job import Job, open_job
from annulus_pipe.reprocess.ranges import CHUNK, Facts, Range, Ranges, measuring
from annulus_pipe.reprocess.versions import measured_with
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import clean_world
from annulus_pipe.vocabulary import Label
from tools.bench.dask_processes import Cluster
from tools.bench.table import ROOT, Row

TASKS, TASK_MS = 500, 10.0
DRAWN, TIMES = 16, 32  # pictures, and how often each is in the scan
CHUNKS = 16  # of a range: 128 flashes, as everywhere
READ_MB = 16.0  # of a request at most, storage/remote.py
AGAIN = 2  # runs, of which the least counts: another's work in the caches costs the same run a tenth more
OVERHEAD = 0.10  # of the serial run's processor
NOTE = (
    "Processor time of all processes that have a part. A task that does nothing carries the row of a real range of 128 "
    "frames and gives back its facts. Serial: `measure` in one process, no files."
)


@dataclass(frozen=True, slots=True)
class Nothing:
    """Work that only travels."""

    facts: Facts

    def ready(self) -> Callable[[Range], Facts]:
        return lambda one: self.facts


@dataclass(frozen=True, slots=True)
class Same:
    """One range, as often as one likes."""

    one: Range
    times: int

    def __len__(self) -> int:
        return self.times

    def __getitem__(self, number: int) -> Range:
        if number >= self.times:
            raise IndexError(number)
        return self.one


@dataclass(slots=True)
class _Task:
    """What one costs, ms of processor, and what one range's frames do."""

    scheduler_ms: float = 0.0
    client_ms: float = 0.0
    worker_ms: float = 0.0
    frame_ms: float = 0.0
    kept_kb: float = 0.0


def rows() -> list[Row]:
    with tempfile.TemporaryDirectory() as name, Cluster(environment={"PYTHONPATH": str(ROOT)}) as cluster:
        folder = Path(name)
        cluster.hire(2)
        job = _scan(folder / "scan.mcap")
        spent = _Task()
        tasks, scans = [*_tasks(job, folder, cluster, spent)], [*_scans(job, folder, cluster, spent)]
        return [*tasks, *scans, *_model(job, spent)]


def _scan(path: Path) -> Job:
    world = clean_world(travel_mm=60.0)
    renderer, size = Renderer(world), (world.camera.width, world.camera.height)
    places = np.linspace(0.0, world.travel_mm, DRAWN)
    raws = [renderer.render(world.pose(z), z, 1.0, 0.0, seed=i) for i, z in enumerate(places)]
    with RecordingWriter(path, calibration=world.calibration().to_dict(), configuration={}, now_ns=0) as writer:
        for i in range(DRAWN * TIMES):
            z = float(places[i % DRAWN] + (i // DRAWN) * 60.0)
            header = FrameHeader(
                i, None, i * 10**7, Label.PROJECTOR, "", None, None, None, z, "bayer_rggb8", *size, None
            )
            writer.frame(header.to_dict(), raws[i % DRAWN], i * 10**7)
    return open_job(path)


def _tasks(job: Job, folder: Path, cluster: Cluster, told: _Task) -> Iterator[Row]:
    one = Ranges(job)[0]
    facts = measuring(job, StoragePath(folder / "one")).ready()(one)
    work, many = Nothing(facts), Same(one, TASKS)
    list(Dask(cluster.url)(work, Same(one, 20)))  # workers there, and all imported
    assert cluster.scheduler is not None
    before, client, clock = _spent(cluster), time.process_time(), time.perf_counter()
    done = sum(not isinstance(outcome, Failed) for _, outcome in Dask(cluster.url)(work, many))  # type: ignore[arg-type]
    wall, client = time.perf_counter() - clock, time.process_time() - client
    scheduler, *workers = ((b - a) / TASKS * 1e3 for a, b in zip(before, _spent(cluster), strict=True))
    worker, client = sum(workers), client / TASKS * 1e3
    whole = scheduler + client + worker
    told.scheduler_ms, told.client_ms, told.worker_ms = scheduler, client, worker
    there = len(pickle.dumps(work)) - len(pickle.dumps(facts)) + len(pickle.dumps(measuring(job, StoragePath(folder))))
    item, back = len(packed((measured_with(), one))), len(packed(facts))
    ok, load = whole <= TASK_MS and done == TASKS, os.getloadavg()[0]
    yield Row("a task: processor in all", "-", f"<= {TASK_MS:g} ms", f"{whole:.2f} ms", ok)
    yield Row("a task: in scheduler, client, worker", "-", "-", f"{scheduler:.2f}, {client:.2f}, {worker:.2f} ms")
    yield Row("a task: by the clock, two workers", "-", "-", f"{wall / TASKS * 1e3:.1f} ms, load {load:.0f}")
    yield Row("one scheduler's core", "-", "-", f"{1e3 / scheduler:.0f} tasks/s; one client's {1e3 / client:.0f}")
    yield Row(
        "a task: bytes there (work, range of 128 frames), back", "-", "-", f"{there + item} ({there}, {item}), {back}"
    )


def _scans(job: Job, folder: Path, cluster: Cluster, told: _Task) -> Iterator[Row]:
    which = job.flashes(Label.PROJECTOR)
    measure(job, which[:CHUNK])

    def alone() -> tuple[float, float]:
        start, clock = time.process_time(), time.perf_counter()
        measure(job, which)
        return time.process_time() - start, time.perf_counter() - clock

    serial, took = min(alone() for _ in range(AGAIN))
    told.frame_ms = serial / len(which) * 1e3
    said = f"{told.frame_ms:.1f} ms a frame ({len(which)} frames, {took:.0f} s by the clock)"
    yield Row("serial", "-", "-", said)

    def row(what: str, cost: tuple[float, float], bound: bool = True) -> Row:
        over = cost[0] / serial - 1
        asked, ok = (f"<= {OVERHEAD:.0%} over", over <= OVERHEAD) if bound else ("-", None)
        return Row(what, "-", asked, f"{over:+.1%}, {cost[1]:.0f} s by the clock", ok)

    def ranged(executor: Executor, others: Callable[[], float]) -> tuple[float, float]:
        """Processor of this process and the others, and by the clock, s: the least of some runs."""
        found = []
        for _ in range(AGAIN):
            before, start = others(), time.process_time()
            with tempfile.TemporaryDirectory(dir=folder) as name:
                took = _ranges(job, Path(name), executor)
            found.append((time.process_time() - start + others() - before, took))
        return min(found)

    yield row("in ranges, in process", ranged(in_process, lambda: 0.0))
    here = folder / "here"
    _ranges(job, here, in_process)
    told.kept_kb = sum(file.stat().st_size for file in here.rglob("*.parquet")) / len(which) / 1e3
    yield Row("profiles of a frame in their file", "-", "-", f"{told.kept_kb:.0f} kB")
    start = time.process_time()
    _ranges(job, here, in_process)
    yield Row("found again, not measured", "-", "-", f"{(time.process_time() - start) / serial:.1%} of serial")
    yield row("Processes(2), their start with it", ranged(Processes(2, apart=True), _children), bound=False)
    list(Dask(cluster.url)(measuring(job, StoragePath(folder / "warm")), [*Ranges(job, which[: 8 * CHUNK], 1)]))
    for workers in (2, 1):
        if workers == 1:
            cluster.kill(1)
        cost = ranged(Dask(cluster.url), lambda: sum(_spent(cluster)))
        yield row(f"dask, {workers} workers, scheduler and client with it", cost)


def _model(job: Job, one: _Task) -> Iterator[Row]:
    """Ranges come as fast as N workers measure them; a core is full where each costs it as long as the next takes to
    come. Frames of the head are read at their own size."""
    frames = CHUNKS * CHUNK
    range_ms = frames * one.frame_ms + one.worker_ms
    mb = job.calibration.camera.width * job.calibration.camera.height / 1e6 * 5 / 4  # an LED frame lies between four
    yield Row("model: one core of the client keeps busy", "-", "-", f"{range_ms / one.client_ms:.0f} workers")
    yield Row("model: one core of the scheduler keeps busy", "-", "-", f"{range_ms / one.scheduler_ms:.0f} workers")
    for workers in (100, 1000):
        tasks = workers / range_ms * 1e3
        reads = tasks * frames * mb
        text = f"{tasks:.0f} tasks/s; client {tasks * one.client_ms / 10:.0f} %, scheduler "
        text += f"{tasks * one.scheduler_ms / 10:.0f} % of a core; read {reads / 1e3:.1f} GB/s ({reads / READ_MB:.0f} "
        text += f"requests/s), written {tasks * frames * one.kept_kb / 1e3:.0f} MB/s"
        yield Row(f"model: {workers} workers", "-", "-", text)


def _ranges(job: Job, folder: Path, executor: Executor) -> float:
    """By the clock, s."""
    began = time.perf_counter()
    outcomes = [outcome for _, outcome in executor(measuring(job, StoragePath(folder)), Ranges(job, chunks=CHUNKS))]
    assert all(isinstance(outcome, Facts) for outcome in outcomes)
    return time.perf_counter() - began


def _spent(cluster: Cluster) -> list[float]:
    """Processor of scheduler and workers that live, s."""
    assert cluster.scheduler is not None
    return [cluster.processor_s(one) for one in (cluster.scheduler, *cluster.workers) if one.poll() is None]


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
