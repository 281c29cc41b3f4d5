"""`annulus tune` whose trial an operator had ended, or that had lapsed, stopped the scan he had begun since, and held
or lit another's trial: requests named no scan. Fails when `stop`, `hold` or `lamps` heed no number."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zmq

from annulus_pipe.daemon.control import ControlClient, ControlSocket
from annulus_pipe.daemon.observer import Observers
from annulus_pipe.daemon.operating import Operating
from annulus_pipe.daemon.state import State
from annulus_pipe.daemon.tuning import _trial
from annulus_pipe.stream.access import Doorkeeper
from annulus_pipe.vocabulary import AnnulusError


class Head:
    """Of a session what Operating asks of it."""

    line: Any = object()
    observers = Observers([])

    def __init__(self) -> None:
        self.scan: int | None = None
        self._number = 0

    @property
    def has_scan(self) -> bool:
        return self.scan is not None

    def require_scan(self) -> None:
        assert self.has_scan

    def start(self, record: bool) -> None:
        self._number += 1
        self.scan = self._number

    def stop(self) -> None:
        self.scan = None
        operating.ended()


operating: Operating


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Head, str]]:
    global operating
    head, ended = Head(), threading.Event()
    operating = Operating(head)  # type: ignore[arg-type]
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    control = ControlSocket(Doorkeeper(context), f"ipc://{tmp_path}/control", None)

    def serve() -> None:
        while not ended.wait(0.002):
            control.poll(operating.obey, lambda: State.IDLE)
        control.close()

    serving = threading.Thread(target=serve)
    serving.start()
    yield head, control.address
    ended.set()
    serving.join()
    context.destroy(linger=0)


def test_who_comes_late_neither_ends_nor_changes_what_another_began(served: tuple[Head, str]) -> None:
    head, address = served
    with ControlClient(address) as tuner, ControlClient(address) as operator:
        with _trial(tuner) as mine:
            assert mine == head.scan == 1
            tuner.hold(5.0, scan=mine)
            operator.stop()
            operator.trial(5.0)
            assert head.scan == 2
            with pytest.raises(AnnulusError, match="that this is about is over"):
                tuner.hold(5.0, scan=mine)
            with pytest.raises(AnnulusError, match="that this is about is over"):
                tuner.lamps(commit=True, trial=True, scan=mine, led_width_us=1.0)
        assert head.scan == 2, "it goes on"
        operator.stop(scan=2)
        assert head.scan is None
        with _trial(tuner):
            pass
        assert head.scan is None, "its own it ends"


def test_a_scan_s_number_is_checked(served: tuple[Head, str]) -> None:
    with ControlClient(served[1]) as client:
        for wrong in (-1, 1 << 32, "1", True, 1.0):
            with pytest.raises(AnnulusError, match=r"scan is .*, expected a whole number"):
                client.ask({"do": "stop", "scan": wrong})
        with pytest.raises(AnnulusError, match="expected nothing more"):
            client.ask({"do": "mark", "text": "x", "scan": 1, "width": 2})
