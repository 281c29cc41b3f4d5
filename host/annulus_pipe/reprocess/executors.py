"""Where the work is done: in this process or in local ones; `cluster` has the place on other machines. All are of one
form, and what comes out is the same whichever it is.

    for number, outcome in executor(work, items): ...  # in any order, each number once

What a worker sets up once is in `work`; items and outcomes are small plain values, for they travel. An item that
raises, or kills its worker, is tried again on whatever worker is free; after `tries` it has failed, and the others go
on. Whose outcome is a failure says so by `Failed`: whether that ends the run is for the caller to say.
"""

import contextlib
import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Protocol, TypeVar

import cv2

from annulus_pipe.vocabulary import AnnulusError

Item = TypeVar("Item")
ItemIn = TypeVar("ItemIn", contravariant=True)
Result = TypeVar("Result")
ResultOut = TypeVar("ResultOut", covariant=True)

STILLBORN_MOST = 3  # workers in a row that end before they can be given anything: the fault is no item's
# mallopt(3): arrays of so many bytes go back as they end (long_scan.py), smaller ones with the item: until then one
# frame's memory is the next one's. New pages for each frame take 0.5 ms.
M_MMAP_THRESHOLD, GIVEN_BACK = -3, 1 << 21
M_TRIM_THRESHOLD, KEPT = -1, 1 << 24
LEAVE_S = 5.0  # for a worker to clear away what it has begun
# Where nobody said how many: a worker's start takes 0.6 s of a processor, as 30 frames do. Guarded by test_executors.
FEW = 100  # items: one worker begins, the others come when they are worth their start
SOME = 3  # outcomes that tell how long others will take
WORTH_S = 1.5  # of work that one worker has left, or is at, for the others to come


class Work(Protocol[ItemIn, ResultOut]):
    """What is to be done with every item; a small value that can be pickled."""

    def ready(self) -> Callable[[ItemIn], ResultOut]:
        """Set up what all items need, once a worker."""
        ...


@dataclass(frozen=True, slots=True)
class Failed:
    """What became of an item that could not be done. why : one line. error : what it raised; None: its worker died."""

    why: str
    tries: int
    error: Exception | None = None

    def raised(self) -> Exception:
        """For a caller that does not go on without the item."""
        return self.error or AnnulusError(f"{self.why}. Out of memory? Try fewer.")


class Executor(Protocol):
    """(work, items) -> (number of the item, its outcome), in any order."""

    def __call__(self, work: Work[Item, Result], items: Sequence[Item]) -> Iterator[tuple[int, Result | Failed]]: ...


def in_process(
    work: Work[Item, Result], items: Sequence[Item], tries: int = 1
) -> Iterator[tuple[int, Result | Failed]]:
    """One item after another, here."""
    do = work.ready()
    for number, item in enumerate(items):
        yield number, _tried(do, item, tries)


def _tried(do: Callable[[Item], Result], item: Item, tries: int) -> Result | Failed:
    for left in reversed(range(tries)):
        try:
            return do(item)
        except Exception as error:
            if not left:
                return failure(error, tries)
    raise ValueError("an item is tried at least once")


def failure(error: Exception, tries: int) -> Failed:
    """What raised is told as people can read it."""
    why = str(error) if isinstance(error, AnnulusError) else f"{type(error).__name__}: {error}"
    return Failed(str(AnnulusError(why)), tries, error)


@dataclass(frozen=True, slots=True)
class Processes:
    """Worker processes on this machine; where their number is None one a core, or fewer for what is soon done.

    tries : of an item before it has failed. apart : one worker alone is a process of its own, too, so that an item
    that kills it does not kill the command; otherwise one alone works in this process.
    """

    workers: int | None = None
    tries: int = 1
    apart: bool = False

    def __call__(self, work: Work[Item, Result], items: Sequence[Item]) -> Iterator[tuple[int, Result | Failed]]:
        workers = min(self.workers or os.cpu_count() or 1, len(items))
        if workers <= 1 and not self.apart:
            yield from in_process(work, items, self.tries)
            return
        crew = _Crew(work, items, self.tries)
        try:
            yield from crew.work(workers, min(workers, 1) if self.workers is None and len(items) <= FEW else workers)
        finally:
            crew.leave()


@dataclass(slots=True)
class _Hand:
    """A worker process, its line, and the number of the item it is at."""

    process: SpawnProcess
    line: Connection
    at: int | None = None
    alive: bool = False  # it has said so: if it dies from now on, its item is to blame


@dataclass(slots=True)
class _Crew:
    """Workers, each with one item at a time: whichever dies, it is known of what, and no other loses anything."""

    job: Work[Any, Any]
    items: Sequence[Any]
    tries: int
    hands: list[_Hand] = field(default_factory=list)
    tried: Counter[int] = field(default_factory=Counter)
    stillborn: int = 0
    reported_s: list[float] = field(default_factory=list)  # when there was a worker, and then each outcome

    def work(self, workers: int, at_first: int) -> Iterator[tuple[int, Any]]:
        todo = deque(range(len(self.items)))
        self.hands += [self._hired() for _ in range(at_first)]
        while todo or any(hand.at is not None for hand in self.hands):
            short = len(self.hands) < workers
            if short and self._slow(len(todo)):
                self._hire_others(workers, len(todo))
            heard = wait([hand.line for hand in self.hands], WORTH_S if short else None)
            outcomes: list[tuple[int, Any]] = []
            for hand in [hand for hand in self.hands if hand.line in heard]:
                outcome = self._heard(hand)
                if outcome is not None:
                    number, result = outcome
                    if isinstance(result, Failed) and result.tries < self.tries:
                        todo.append(number)
                    else:
                        outcomes.append(outcome)
                if hand in self.hands and hand.at is None and todo:  # before anybody does anything with an outcome
                    self._give(hand, todo)
            for hand in self.hands:  # what had to be tried again, by whom nothing was left for
                if hand.alive and hand.at is None and todo:
                    self._give(hand, todo)
            yield from outcomes

    def _slow(self, left: int) -> bool:
        """Whether so many items would take the workers there are long: by the time from outcome to outcome, which the
        first does not tell, for a worker sets itself up with it."""
        if not left or not self.reported_s:
            return False
        since, done = time.monotonic() - self.reported_s[min(1, len(self.reported_s) - 1)], len(self.reported_s) - 2
        return since > WORTH_S if done < SOME else since / done * left > WORTH_S

    def _hire_others(self, workers: int, left: int) -> None:
        coming = sum(not hand.alive for hand in self.hands)
        more = min(workers - len(self.hands), left - coming) if self.stillborn < STILLBORN_MOST else 0
        with contextlib.suppress(OSError):  # no memory or process left for them: who is there goes on
            for _ in range(more):
                self.hands.append(self._hired())

    def _hired(self) -> _Hand:
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe()
        process = context.Process(target=_work, args=(self.job, there, os.getpid()), name="reprocess", daemon=True)
        process.start()
        there.close()
        return _Hand(process, here)

    def _give(self, hand: _Hand, todo: deque[int]) -> None:
        number = todo.popleft()
        with contextlib.suppress(OSError):  # it has just died: heard of next
            hand.line.send((number, self.items[number]))
        hand.at = number

    def _heard(self, hand: _Hand) -> tuple[int, Any] | None:
        """What came of an item; None where a worker has only said that it is there, or has died of nothing."""
        try:
            number, result = hand.line.recv()
        except (EOFError, OSError):
            return self._dead(hand)
        hand.alive, self.stillborn = True, 0
        self.reported_s.append(time.monotonic())
        if number is None:
            return None
        hand.at = None
        if isinstance(result, Failed):
            self.tried[number] += 1
            result = replace(result, tries=self.tried[number])
        return number, result

    def _dead(self, hand: _Hand) -> tuple[int, Any] | None:
        hand.line.close()
        hand.process.join()
        self.hands.remove(hand)
        if not hand.alive:
            self.stillborn += 1
            if self.stillborn >= STILLBORN_MOST and any(other.alive for other in self.hands):
                return None  # who is there goes on
            if self.stillborn >= STILLBORN_MOST:
                raise AnnulusError(f"worker processes end as they begin (exit status {hand.process.exitcode}).")
        number = hand.at
        if number is None:
            self.hands.append(self._hired())
            return None
        self.tried[number] += 1
        self.hands.append(self._hired())
        return number, Failed("a worker process died while reconstructing", self.tried[number])

    def leave(self) -> None:
        """All workers ended: those with nothing to do by the end of their line, others, who are at an item or only
        begin, as by Ctrl-C."""
        for hand in self.hands:
            if hand.at is not None or not hand.alive:
                hand.process.terminate()
            hand.line.close()
        for hand in self.hands:
            hand.process.join(LEAVE_S)
            if hand.process.is_alive():
                hand.process.kill()
                hand.process.join()


def _work(job: Work[Any, Any], line: Connection, parent: int) -> None:
    """A worker's life."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # what is half written is cleared away
    libc = ctypes.CDLL(None)
    libc.mallopt(M_MMAP_THRESHOLD, GIVEN_BACK)
    libc.mallopt(M_TRIM_THRESHOLD, KEPT)
    libc.prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: never outlive the command
    if os.getppid() != parent:
        os._exit(1)
    cv2.setNumThreads(1)
    do: Callable[[Any], Any] | None = None
    with contextlib.suppress(EOFError, OSError):  # the line's end is the work's
        line.send((None, None))
        while True:
            number, item = line.recv()
            try:
                do = do or job.ready()
                result = do(item)
            except Exception as error:
                result = replace(failure(error, 1), error=_portable(error))
            line.send((number, result))
            del result, item
            libc.malloc_trim(0)  # a window's memory goes back before the next takes its own


def _portable(error: Exception) -> Exception:
    """The same as it can travel, with where it was raised."""
    portable = error
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # whatever its author did not think of
        portable = RuntimeError(f"{type(error).__name__}: {error}")
    portable.add_note(traceback.format_exc())
    return portable
