"""Frames drawn on threads, without Python's lock, and handed back in the order they were asked for."""

import contextlib
import os
import queue
import threading
from typing import NamedTuple

from annulus_pipe.numeric.arrays import Image
from annulus_pipe.twin.driver import Delivered
from annulus_pipe.twin.render import Renderer


class DrawingJob(NamedTuple):
    slot: int
    generation: int
    frame: Delivered


class Drawing:
    """As many frames at once as there are threads, and as many more that wait."""

    def __init__(self, renderer: Renderer, slots: Image, threads: int) -> None:
        """slots : (N, H, W), where frames go."""
        self._renderer, self._slots = renderer, slots
        self._jobs: queue.Queue[DrawingJob | None] = queue.Queue(threads)
        self._done: queue.SimpleQueue[DrawingJob] = queue.SimpleQueue()
        self._order: list[int] = []  # frames asked for, oldest first
        self._drawn: dict[int, DrawingJob] = {}
        self.wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)  # readable when something may be in order
        for _ in range(threads):
            threading.Thread(target=self._draw, daemon=True).start()

    def order(self, job: DrawingJob) -> bool:
        """False where every thread has enough to do."""
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            return False
        self._order.append(job.frame.number)
        return True

    def finished(self) -> list[DrawingJob]:
        """Those drawn by now whose elders are too, oldest first."""
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self.wake)
        while not self._done.empty():
            job = self._done.get()
            self._drawn[job.frame.number] = job
        out = []
        while self._order and self._order[0] in self._drawn:
            out.append(self._drawn.pop(self._order.pop(0)))
        return out

    def close(self) -> None:
        for _ in range(8):  # threads are daemons, but let none write into memory that goes away
            with contextlib.suppress(queue.Full):
                self._jobs.put_nowait(None)

    def _draw(self) -> None:
        while (job := self._jobs.get()) is not None:
            slot = self._slots[job.slot]
            for part in job.frame.parts:  # of a torn picture more than one
                if part.bottom <= part.top:
                    slot[:] = 0
                    continue
                exposure = part.exposure
                whole = self._renderer.render(
                    exposure.pose,
                    exposure.z_mm,
                    exposure.projector,
                    exposure.led,
                    slot=exposure.slides[0] if exposure.slides else None,
                    seed=exposure.sequence,
                    out=slot if part.top == 0.0 else None,
                )
                rows = slice(round(part.top * len(slot)), round(part.bottom * len(slot)))
                slot[rows] = whole[rows]
            self._done.put(job)
            os.eventfd_write(self.wake, 1)
