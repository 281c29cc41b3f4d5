"""Promises of what is in flight at a cluster, with a client that fails at will: every item comes back, each once."""

import asyncio
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from toil import Toil

from annulus_pipe.reprocess import cluster
from annulus_pipe.reprocess.cluster import Dask

ITEMS = 20


class KilledWorker(Exception):
    pass


class Future:
    """Done as it is asked for. fault : what asking for its outcome raises, once."""

    def __init__(self, data: bytes, fault: Exception | None) -> None:
        self.data, self.fault, self.status = data, fault, "finished"

    def add_done_callback(self, call: Callable[["Future"], None]) -> None:
        call(self)

    def exception(self, timeout: float) -> Exception:
        raise TimeoutError("no answer")

    def release(self) -> None: ...

    def cancel(self) -> None: ...


class Client:
    """One of dask's, as far as it is used; says of every third task what `script` has next."""

    status = "running"
    scheduler = SimpleNamespace(identity=None)

    def __init__(self, loop: asyncio.AbstractEventLoop, script: Iterator[str]) -> None:
        self.loop, self.script, self.tasks = SimpleNamespace(asyncio_loop=loop), script, 0

    def sync(self, *_: Any, **__: Any) -> dict[str, Any]:
        return {"id": "a scheduler", "workers": {"a worker": {"nthreads": 2}}}

    def map(
        self, do: Callable[[bytes, bytes], bytes], works: list[bytes], tasks: list[bytes], **_: Any
    ) -> list[Future]:
        out = []
        for work, task in zip(works, tasks, strict=True):
            self.tasks += 1
            what = next(self.script, "") if self.tasks % 3 == 0 else ""
            future = Future(do(work, task), KilledWorker() if what == "killed" else None)
            if what == "no answer":
                future.status = "error"
            if what == "gone":
                future.status = "cancelled"
            out.append(future)
        return out

    async def gather(self, futures: list[Future], asynchronous: bool) -> list[bytes]:
        for future in futures:
            if future.fault is not None:
                error, future.fault, future.status = future.fault, None, "lost"
                raise error
        return [future.data for future in futures]

    def cancel(self, futures: list[Future], force: bool) -> None: ...

    def close(self, timeout: float) -> None: ...


@pytest.fixture
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    made = asyncio.new_event_loop()
    thread = threading.Thread(target=made.run_forever, daemon=True)
    thread.start()
    yield made
    made.call_soon_threadsafe(made.stop)
    thread.join()
    made.close()


@pytest.mark.parametrize("script", ["no answer", "killed", "gone", "killed,no answer,gone,gone,killed,no answer"])
def test_every_item_comes_back_once_whatever_asking_for_some_of_them_raises(
    script: str, loop: asyncio.AbstractEventLoop, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    said = iter(script.split(","))
    library = SimpleNamespace(
        Client=lambda *_, **__: Client(loop, said),
        client=SimpleNamespace(ClosedClientError=OSError),
        KilledWorker=KilledWorker,
    )
    monkeypatch.setattr(cluster, "need", lambda name: library)
    monkeypatch.setattr(cluster, "LINGER_S", 0.001)
    told = [*Dask("tcp://127.0.0.1:8786", patience_s=0.1)(Toil(tmp_path), range(ITEMS))]
    assert sorted(told) == [(n, n * n) for n in range(ITEMS)]
