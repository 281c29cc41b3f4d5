"""The id of who commands was published: any viewer who may ask could command as him. And nobody knew who did what."""

import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq

from annulus_pipe.daemon.command import Operator
from annulus_pipe.daemon.config import HeadConfig, LogConfig
from annulus_pipe.daemon.control import ControlSocket
from annulus_pipe.daemon.logfile import LogFile
from annulus_pipe.daemon.observer import Commanded, Observer, Observers
from annulus_pipe.daemon.operating import WRITTEN_MAX, Operating
from annulus_pipe.daemon.request import Request
from annulus_pipe.daemon.state import State
from annulus_pipe.job import JobSheet
from annulus_pipe.stream.access import Doorkeeper
from annulus_pipe.vocabulary import AnnulusError

ANNA = {"id": "annas-own-secret", "name": "Anna", "from": "10.0.0.9"}


@dataclass
class Told(Observer):
    """All that is told to whoever looks on, as text."""

    published: list[str] = field(default_factory=list)
    commanded_: list[Commanded] = field(default_factory=list)

    def event(self, kind: str, text: str) -> None:
        self.published.append(text)

    def job(self, sheet: JobSheet) -> None:
        self.published.append(json.dumps(sheet.to_dict()))

    def commanded(self, what: Commanded) -> None:
        self.commanded_.append(what)


class Idle:
    """As much of a session as these requests need."""

    line, has_scan, scan, state = None, False, None, State.IDLE

    def __init__(self, *more: Observer) -> None:
        self.config, self.told = HeadConfig(), Told()
        self.observers = Observers([self.told, *more])
        self.stopped_after: list[str] = []

    def require_scan(self) -> None:
        if not self.has_scan:
            raise AnnulusError("no scan is under way, the head is idle")

    def stop(self) -> None:
        self.stopped_after = [str(one.asked["do"]) for one in self.told.commanded_]


def asked(do: str, who: object = ANNA, **more: Any) -> Request:
    return Request.from_dict({"do": do, "who": who, **more})


def test_nothing_that_is_published_makes_anybody_the_holder() -> None:
    session = Idle()
    operating = Operating(session)  # type: ignore[arg-type]
    operating.obey(asked("command"))
    seen = json.dumps(operating.numbers()) + "".join(session.told.published) + repr(asked("command"))
    assert ANNA["id"] not in seen and "Anna" in seen
    public = operating.numbers()["command"]["id"]
    assert operating.numbers()["command"]["id"] == public, "others can tell two of one name apart"
    for forged in (public, ANNA["name"], "", ANNA["id"][:8]):
        if forged:
            with pytest.raises(AnnulusError, match="Anna commands"):
                operating.obey(asked("job", {"id": forged, "name": "Anna"}, job={"client": "x"}))
    operating.obey(asked("job", job={"client": "The Waterworks"}))
    other = Operating(Idle())  # type: ignore[arg-type]
    other.obey(asked("command"))
    assert other.numbers()["command"]["id"] != public, "nobody can try out short ids against it"


def test_who_did_what_from_where_and_what_became_of_it_is_written_down(tmp_path: Path) -> None:
    log = LogFile(LogConfig(tmp_path / "head.log"))
    session = Idle(log)
    operating = Operating(session)  # type: ignore[arg-type]
    operating.obey(asked("command"))
    operating.obey(asked("command"))  # a renewal
    operating.obey(asked("state"))
    operating.obey(asked("job", job={"client": "Secret Customer"}))
    with pytest.raises(AnnulusError):
        operating.obey(asked("zero", {"id": "bens", "name": "Ben"}))
    with pytest.raises(AnnulusError):
        operating.obey(asked("stop", None))
    session.has_scan = True
    operating.obey(asked("stop"))
    assert session.stopped_after[-1] == "stop", "written down while the recording is open"
    log.close()
    lines = [(one.asked["do"], one.name, one.outcome) for one in session.told.commanded_]
    assert lines == [
        ("command", "Anna", "done"),
        ("job", "Anna", "done"),
        ("zero", "Ben", "Anna commands; take the command to change things yourself"),
        ("stop", "", "no scan is under way, the head is idle"),
        ("stop", "Anna", "done"),
    ]
    text = (tmp_path / "head.log").read_text()
    assert text.count(" asked ") == 5 and "from 10.0.0.9" in text and "somebody" in text
    for secret in (ANNA["id"], "bens", "Secret Customer"):
        assert secret not in text + json.dumps([one.to_dict() for one in session.told.commanded_])


def test_a_flood_of_requests_is_counted_and_not_written() -> None:
    session = Idle()
    operating = Operating(session)  # type: ignore[arg-type]
    begun = time.monotonic()
    for _ in range(1000):
        with pytest.raises(AnnulusError):
            operating.obey(asked("stop", None))
    seconds = int(time.monotonic() - begun) + 2
    written = session.told.commanded_
    assert len(written) <= WRITTEN_MAX * seconds
    assert len(written) + sum(one.left_out for one in written) + operating._left_out == 1000


def test_the_socket_says_from_which_address_it_was_asked() -> None:
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = ControlSocket(Doorkeeper(context), "tcp://127.0.0.1:*", None)
    heard: list[Request] = []
    asking = context.socket(zmq.REQ)
    asking.connect(socket.address)
    asking.send(msgpack.packb({"do": "state"}))
    end = time.monotonic() + 30.0
    while not heard and time.monotonic() < end:
        socket.poll(lambda request: heard.append(request), lambda: State.IDLE)  # type: ignore[func-returns-value]
    assert heard[0].peer == "127.0.0.1"
    asking.close(0)
    socket.close()
    context.destroy(linger=0)
    assert "secret" not in repr(Operator("secret", "Anna"))
