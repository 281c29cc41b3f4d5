"""Work on the machines of a dask cluster that somebody else keeps: an executor of the form of `executors`.

A task carries the work, one item, and what the sender measures with; what comes back is small. So the scheduler sees
some tens of kilobytes a task, and this process holds what is in flight and no more: twice as many tasks as there are
workers' threads. A worker that dies costs what it was at. A scheduler that dies or begins anew costs what was in
flight: all of that is sent again, and what had been done meanwhile is found by its address and not done twice.

A task that arrives where code or libraries are others is not done: that worker is named once, and given no more.
Dask hands Python objects to whoever can connect, so anything but loopback is spoken to over TLS, both sides by their
certificates.
"""

import asyncio
import concurrent.futures
import contextlib
import functools
import io
import itertools
import logging
import os
import pickle
import queue
import threading
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from hashlib import sha256
from operator import attrgetter
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from annulus_pipe.extras import need
from annulus_pipe.reprocess.executors import Failed, Item, Result, Work, failure
from annulus_pipe.reprocess.versions import differing, measured_with
from annulus_pipe.stream.access import is_loopback
from annulus_pipe.vocabulary import AnnulusError

LOOK_S = 2.0  # between two looks whether the scheduler is there, and who works
ANSWER_S = 15.0  # for a scheduler to say who it is
CLOSE_S = 2.0
DEEP, LOW = 4, 2  # tasks a thread of a worker: it is given more, some at a time, when there are so few
LINGER_S = 0.05  # after a first outcome, for others to be fetched with it
LEAST = 4  # in flight, while no worker has come
LOST_MOST = 2  # times that a scheduler gives an item up: each time it had killed four workers
KEPT = 4  # works that a worker keeps ready
LOST = (
    OSError,
    TimeoutError,
    RuntimeError,
    concurrent.futures.CancelledError,
    asyncio.CancelledError,
)  # what a client raises without its scheduler
QUIET_S = 10.0  # without any worker before it is said


@dataclass(frozen=True, slots=True)
class Tls:
    """Files of a client: who it believes, its own certificate and key."""

    ca: Path
    cert: Path
    key: Path


@dataclass(frozen=True)
class Dask:
    """scheduler : tcp://host:port on loopback, tls://host:port anywhere. tries : of an item that raises. patience_s :
    without a scheduler, or without a worker, before it is given up. say : is given a line now and then.

    Raises AnnulusError, one line, where the scheduler may not be or cannot be spoken to.
    """

    scheduler: str
    tls: Tls | None = None
    tries: int = 3
    patience_s: float = 300.0
    say: Callable[[str], None] = field(default=lambda line: None, compare=False)

    def __post_init__(self) -> None:
        address = urlsplit(self.scheduler)
        try:
            port = address.port
        except ValueError:
            port = None
        if address.scheme not in ("tcp", "tls") or not address.hostname or port is None:
            raise AnnulusError(
                f"{self.scheduler}: no address of a scheduler. Expected tcp://HOST:PORT or tls://HOST:PORT."
            )
        if address.scheme == "tcp" and not is_loopback(self.scheduler):
            raise AnnulusError(
                f"{self.scheduler}: not loopback, and not encrypted: whoever is on the way could run what they like on "
                "every worker. Expected tls:// and its files."
            )
        if (address.scheme == "tls") != (self.tls is not None):
            raise AnnulusError(f"{self.scheduler}: files of TLS go with tls://, and tls:// does not go without them.")

    def __call__(self, work: Work[Item, Result], items: Sequence[Item]) -> Iterator[tuple[int, Result | Failed]]:
        desk = _Desk(self, pickle.dumps(work), items)
        try:
            yield from desk.work()
        finally:
            desk.leave()

    def security(self) -> Any:
        if self.tls is None:
            return None
        for path in (self.tls.ca, self.tls.cert, self.tls.key):
            if not os.access(path, os.R_OK):
                raise AnnulusError(f"{path}: cannot be read. Expected a file of TLS, PEM.")
        return need("distributed.security").Security(
            tls_ca_file=str(self.tls.ca),
            tls_client_cert=str(self.tls.cert),
            tls_client_key=str(self.tls.key),
            require_encryption=True,
        )


@dataclass(frozen=True, slots=True)
class _Stranger:
    """A worker that measures with something else."""

    worker: str
    why: str


@dataclass(slots=True)
class _Desk:
    """What is in flight, and with whom."""

    to: Dask
    job: bytes
    items: Sequence[Any]
    client: Any = None
    met: str = ""  # the scheduler's own name for itself: another one has none of our tasks
    looked_s: float = 0.0
    quiet_since_s: float | None = None
    lost_since_s: float | None = None
    at: dict[int, Any] = field(default_factory=dict)  # futures, by number
    only: dict[int, frozenset[str]] = field(default_factory=dict)  # workers that may do it, where not all may
    workers: Mapping[str, int] = field(default_factory=dict)  # threads, by address
    strangers: dict[str, str] = field(default_factory=dict)
    tried: Counter[int] = field(default_factory=Counter)
    given_up: Counter[int] = field(default_factory=Counter)
    outcomes: list[tuple[int, Any]] = field(default_factory=list)
    heard: "queue.SimpleQueue[tuple[int, Any]]" = field(default_factory=queue.SimpleQueue)

    def work(self) -> Iterator[tuple[int, Any]]:
        distributed = need("distributed")
        for name in [one for one in logging.root.manager.loggerDict if one.partition(".")[0] == "distributed"]:
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what its end of a line says, we say ourselves
        todo = deque(range(len(self.items)))
        while todo or self.at:
            try:
                if self.client is None:
                    self._connect(distributed)
                self._alive()
                self._look(todo)
                self._send(todo)
                self._hear(distributed, todo)
            except (*LOST, distributed.client.ClosedClientError) as error:
                self._lost(error, todo)
            outcomes, self.outcomes = self.outcomes, []  # also what was heard before the line was lost
            yield from outcomes

    def _connect(self, distributed: Any) -> None:
        self.client = distributed.Client(
            self.to.scheduler,
            security=self.to.security(),
            set_as_default=False,
            timeout=f"{ANSWER_S:g}s",
            name="annulus",
        )
        self.met, self.looked_s = "", 0.0

    def _lost(self, error: BaseException, todo: "deque[int]") -> None:
        """The scheduler, and with it all that was in flight; waits a moment."""
        now = time.monotonic()
        if self.lost_since_s is None:
            self.lost_since_s = now
            if self.met:
                self.to.say(f"{self.to.scheduler}: lost. Its {len(self.at)} tasks are sent again when it is back.")
        if now - self.lost_since_s > self.to.patience_s or (not self.met and self._is_tls(error)):
            raise AnnulusError(
                f"{self.to.scheduler}: no scheduler answers ({error}). Expected one of dask's."
            ) from None
        todo.extendleft(sorted(self.at, reverse=True))
        self._close()
        time.sleep(min(1.0, self.to.patience_s / 10))

    @staticmethod
    def _is_tls(error: BaseException) -> bool:
        """A certificate that is not believed will not be a minute later."""
        return "certificate" in str(error).lower() or "ssl" in str(error).lower()

    def _look(self, todo: "deque[int]") -> None:
        """Now and then: whether the scheduler is the one we met, and who works."""
        now = time.monotonic()
        if now - self.looked_s < LOOK_S:
            return
        identity = self.client.sync(self.client.scheduler.identity, n_workers=-1, callback_timeout=ANSWER_S)
        if self.met and identity["id"] != self.met:
            raise OSError("another one answers")
        self.met, self.lost_since_s, self.looked_s = identity["id"], None, now
        self.workers = {name: int(one["nthreads"]) for name, one in identity["workers"].items()}
        mine = self.workers.keys() - self.strangers.keys()
        for number, only in [*self.only.items()]:
            if not only & mine:  # it would wait for ever
                future = self.at.pop(number, None)
                del self.only[number]
                if future is not None:
                    future.cancel()
                    todo.appendleft(number)
        self._patience(bool(mine), now)

    def _patience(self, any_worker: bool, now: float) -> None:
        if any_worker:
            self.quiet_since_s = None
            return
        if self.workers:
            name, why = next((n, w) for n, w in self.strangers.items() if n in self.workers)
            raise AnnulusError(f"{self.to.scheduler}: no worker that may work on this. {name} has {why}.")
        if self.quiet_since_s is None:
            self.quiet_since_s = now
        if now - self.quiet_since_s > self.to.patience_s:
            raise AnnulusError(f"{self.to.scheduler}: has no workers. Expected some within {self.to.patience_s:g} s.")
        if QUIET_S <= now - self.quiet_since_s < QUIET_S + 1.5 * LOOK_S:
            self.to.say(f"{self.to.scheduler}: has no workers; waiting for some")

    def _send(self, todo: "deque[int]") -> None:
        mine = frozenset(self.workers.keys() - self.strangers.keys())
        threads = sum(self.workers[name] for name in mine)
        if not todo or len(self.at) > max(LEAST // 2, LOW * threads):
            return
        sent = [*itertools.islice(todo, max(LEAST, DEEP * threads) - len(self.at))]
        tasks = [packed((measured_with(), self.items[number])) for number in sent]
        only = {"workers": sorted(mine), "allow_other_workers": False} if self.strangers else {}
        futures = self.client.map(_do, [self.job] * len(tasks), tasks, pure=False, **only)
        for number, future in zip(sent, futures, strict=True):
            self.at[todo.popleft()] = future
            if only:
                self.only[number] = mine
            future.add_done_callback(lambda one, number=number: self.heard.put((number, one)))

    def _hear(self, distributed: Any, todo: "deque[int]") -> None:
        """What has been done; waits a moment for the first one, and for those that come with it."""
        answers: list[tuple[int, Any]] = []
        try:
            answers.append(self.heard.get(timeout=LOOK_S))
            until = time.monotonic() + LINGER_S
            while True:
                answers.append(self.heard.get(timeout=max(0.0, until - time.monotonic())))
        except queue.Empty:
            pass
        answers = [(number, future) for number, future in answers if self.at.get(number) is future]  # not of a lost one
        done = [one for one in answers if one[1].status == "finished"]
        others = [one for one in answers if one not in done]
        try:
            fetched = self._fetched([future for _, future in done], todo)
        except LOST:
            raise
        except Exception:  # one went with its worker, and killed others since: by now its own state says so
            others += [one for one in done if one[1].status != "finished"]
            for one in [one for one in done if one not in others]:
                self.heard.put(one)
            done, fetched = [], []
        for (number, future), data in zip(done, fetched, strict=True):
            if self.at.get(number) is not future:  # its workers were gone, and it is sent again
                continue
            self._forget(number)
            self._sort(number, pickle.loads(data), todo)
        for number, future in others:
            error = future.exception(timeout=ANSWER_S) if future.status == "error" else None
            self._forget(number)
            if error is None:
                todo.appendleft(number)
                continue
            self.given_up[number] += 1
            if isinstance(error, distributed.KilledWorker) and self.given_up[number] < LOST_MOST:
                todo.append(number)
            elif isinstance(error, distributed.KilledWorker):
                self.outcomes.append((number, Failed("every worker that it was given to died", self.given_up[number])))
            else:  # not raised by the work: that comes as an outcome
                self.outcomes.append((number, failure(error, self.given_up[number])))

    def _fetched(self, futures: Sequence[Any], todo: "deque[int]") -> list[bytes]:
        """What came of them. A worker that died with an outcome has it made again; a scheduler that died has not, and a
        client waits for its outcomes for ever: OSError."""
        gathered = asyncio.run_coroutine_threadsafe(
            self.client.gather(futures, asynchronous=True), self.client.loop.asyncio_loop
        )
        while True:
            done, _ = concurrent.futures.wait([gathered], timeout=LOOK_S)
            if done:
                return list(gathered.result())
            self._alive()
            self._look(todo)

    def _alive(self) -> None:
        if self.client.status != "running":
            raise OSError("its line is closed")

    def _sort(self, number: int, outcome: Any, todo: "deque[int]") -> None:
        if isinstance(outcome, _Stranger):
            if outcome.worker not in self.strangers:
                self.to.say(f"{outcome.worker}: refused, it has {outcome.why}")
            self.strangers[outcome.worker] = outcome.why
            self.looked_s = 0.0
            todo.appendleft(number)
        elif isinstance(outcome, Failed):
            self.tried[number] += 1
            if self.tried[number] < self.to.tries:
                todo.append(number)
            else:
                self.outcomes.append((number, replace(outcome, tries=self.tried[number])))
        else:
            self.outcomes.append((number, outcome))

    def _forget(self, number: int) -> None:
        self.at.pop(number).release()
        self.only.pop(number, None)

    def leave(self) -> None:
        """Nothing of ours is done any more, and nobody waits for it."""
        if self.client is not None and self.at:
            with contextlib.suppress(Exception):  # of whatever state it is in
                self.client.cancel([*self.at.values()], force=True)
        self._close()

    def _close(self) -> None:
        client, self.client = self.client, None
        self.at.clear()
        self.only.clear()
        if client is not None:
            with contextlib.suppress(Exception):  # of whatever state it is in
                client.close(timeout=CLOSE_S)


class _Packer(pickle.Pickler):
    """Of hundreds of small dataclasses, as a range has: three times as fast as their own way, which asks for the names
    of their fields each time."""

    def reducer_override(self, value: Any) -> Any:
        kind: Any = type(value)
        names = _names(kind)
        return NotImplemented if names is None else (kind, names(value))


@functools.cache
def _names(kind: Any) -> Callable[[Any], tuple[Any, ...]] | None:
    """What a dataclass is made from; None where it is not made from its fields, or from too few to be worth it."""
    if not is_dataclass(kind) or not all(one.init and not one.kw_only for one in fields(kind)):
        return None
    names = [one.name for one in fields(kind)]
    return attrgetter(*names) if len(names) > 1 else None


def packed(value: Any) -> bytes:
    held = io.BytesIO()
    _Packer(held, pickle.HIGHEST_PROTOCOL).dump(value)
    return held.getvalue()


_ready = threading.local()  # what a worker's thread has set up, by the work's digest


def _do(job: bytes, task: bytes) -> bytes:
    """On a worker: the outcome of one item."""
    sent, item = pickle.loads(task)
    unlike = differing(sent, measured_with())
    if unlike:
        return pickle.dumps(_Stranger(need("distributed").get_worker().address, unlike))
    import cv2

    cv2.setNumThreads(1)
    try:
        return packed(_work(job)(item))
    except Exception as error:
        return pickle.dumps(replace(failure(error, 1), error=None if not isinstance(error, AnnulusError) else error))


def _work(job: bytes) -> Callable[[Any], Any]:
    kept: OrderedDict[str, Callable[[Any], Any]] = _ready.__dict__.setdefault("kept", OrderedDict())
    name = sha256(job).hexdigest()
    if name not in kept:
        kept[name] = pickle.loads(job).ready()
        if len(kept) > KEPT:
            kept.popitem(last=False)
    return kept[name]
