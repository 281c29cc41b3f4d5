"""Where the work is done: in this process or in local ones. Another place is another function of the same form."""

import ctypes
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

import cv2

from annulus.reprocess.job import Job, Measured
from annulus.vocabulary import AnnulusError

# (job, chunks of frame numbers) -> (number of the chunk, its frames' results), in any order.
Executor = Callable[[Job, Sequence[Sequence[int]]], Iterator[tuple[int, list[Measured]]]]


def in_process(job: Job, chunks: Sequence[Sequence[int]]) -> Iterator[tuple[int, list[Measured]]]:
    """One chunk after another, here."""
    work = job.worker()
    for number, chunk in enumerate(chunks):
        yield number, work(chunk)


@dataclass(frozen=True, slots=True)
class Processes:
    """Worker processes on this machine, one a core where their number is None; one alone works in this process."""

    workers: int | None = None

    def __call__(self, job: Job, chunks: Sequence[Sequence[int]]) -> Iterator[tuple[int, list[Measured]]]:
        workers = min(self.workers or os.cpu_count() or 1, len(chunks))
        if workers <= 1:
            yield from in_process(job, chunks)
            return
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(workers, context, _start_worker, (job, os.getpid()))
        try:
            futures = {pool.submit(_work, chunk): number for number, chunk in enumerate(chunks)}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise AnnulusError("a worker process died while reconstructing. Out of memory? Try fewer.") from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


_worker: Callable[[Sequence[int]], list[Measured]] | None = None  # one a worker process, set when it starts


def _start_worker(job: Job, parent: int) -> None:
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: never outlive the command
    if os.getppid() != parent:
        os._exit(1)
    cv2.setNumThreads(1)
    _worker = job.worker()


def _work(chunk: Sequence[int]) -> list[Measured]:
    assert _worker is not None
    return _worker(chunk)
