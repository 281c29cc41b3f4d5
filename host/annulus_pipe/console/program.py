"""One console: everything that its routes know. Made once, closed once."""

import asyncio
import contextlib
import sys
import time
from collections.abc import Coroutine, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, Self

import zmq

from annulus_pipe import untrusted
from annulus_pipe.console import wire
from annulus_pipe.console.access import BrowserSession, Password, RequestOrigins, Sessions
from annulus_pipe.console.answers import Refusal
from annulus_pipe.console.commands import RENEW_S, Commands, Lease
from annulus_pipe.console.feed import LOST_S, Feed
from annulus_pipe.console.foxglove import Foxglove
from annulus_pipe.console.hub import STATUS, Hub, Viewer
from annulus_pipe.console.live import Live
from annulus_pipe.numeric.palette import DEVIATION, DEVIATION_LIVE_MM
from annulus_pipe.stream.access import ClientKeys

ALIVE_S = 0.5
ABOUT_S = 30.0  # asked again, where nothing told that it changed
ANSWERS_S = 5.0  # a page says something twice a second; one that does not is asleep
STUCK_S = 10.0  # a viewer that takes nothing for so long is cut off


@dataclass(frozen=True, slots=True)
class Daemon:
    """Where the daemon is, and how it knows us."""

    publish: str
    control: str
    publish_keys: ClientKeys | None = None
    control_keys: ClientKeys | None = None


@dataclass(frozen=True, slots=True)
class Door:
    """Where the page is, and who may come in. password: None where nobody logs in."""

    host: str = "127.0.0.1"
    port: int = 8600
    tls_cert: Path | None = None
    tls_key: Path | None = None
    names: tuple[str, ...] = ()  # by which it is reached, besides this machine's own
    password: Password | None = None

    @property
    def url(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'https' if self.tls_cert else 'http'}://{host}:{self.port}/"


class Program:
    """Feed, viewers, commands, sessions. Parts with routes of their own use `hub.tell`, `do`, `spawn`, `surveys`."""

    def __init__(self, daemon: Daemon, door: Door, *, demo: bool = False, surveys: Sequence[Path] = ()) -> None:
        """surveys : folders whose recordings and results are shown. Raises AnnulusError when an address is none."""
        self.daemon, self.door, self.demo, self.surveys = daemon, door, demo, tuple(surveys)
        self.static = Path(str(files("annulus_pipe.console"))) / "static"
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.feed = Feed(self._context, daemon.publish, daemon.publish_keys)
        self.hub = Hub()
        self.live = Live(self.feed, self.hub)
        self.commands = Commands(self._context, daemon.control, daemon.control_keys)
        self.lease = Lease(self.commands, self.answers)
        self.places = RequestOrigins(door.host, door.tls_cert is not None, door.names)
        self.sessions = Sessions(door.password is not None)
        self.sessions.in_use = lambda session: any(viewer.session == session.id for viewer in self.hub.viewers)
        self.cookie = f"{'__Host-' if door.tls_cert else ''}annulus-{door.port}"
        self.about: Mapping[str, Any] | None = None
        self.foxglove: Foxglove | None = None
        self.stuck: dict[Viewer, tuple[float, Any]] = {}  # since when one is being sent to, and what ends it
        self._tasks: set[asyncio.Task[None]] = set()
        self._ask_about = asyncio.Event()

    def spawn(self, work: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        """Beside everything else; ended with the program."""
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def do(self, asked: Mapping[str, Any], session: BrowserSession) -> Mapping[str, Any]:
        """A request of the control socket in this session's name. Raises Refusal."""
        who = self.who(session)
        answer = await self.commands.ask({**asked, "who": who})
        self.lease.heard(str(asked.get("do")), session.id, who)
        self.look()
        return answer

    def open_to_foxglove(self) -> None:
        """A second server, on loopback, for Foxglove's viewer. Raises AnnulusError."""
        self.foxglove = foxglove = Foxglove(self.feed)
        live, wants = self.feed.on_word, self.hub.on_wants

        def both(topic: str, body: Any, part: bytes) -> None:
            foxglove.hear(topic, body, part)
            live(topic, body, part)

        self.feed.on_word = both
        self.hub.on_wants = lambda wanted: wants(wanted | foxglove.wants)

    @staticmethod
    def who(session: BrowserSession) -> dict[str, str]:
        """As the daemon is told who asks."""
        identity = {"id": session.lease, "name": session.name or f"browser {session.id[:4]}"}
        return {**identity, "from": session.address} if session.address else identity

    def look(self) -> None:
        """What the daemon is about may have changed."""
        self._ask_about.set()

    def hello(self) -> bytes:
        body = {
            "version": version("annulus-pipe"),
            "demo": self.demo,
            "languages": self.languages(),
            "cameras": self.cameras,
            "deviation": {"colours": DEVIATION, "ends_mm": DEVIATION_LIVE_MM},
        }
        return wire.status("hello", body)

    def languages(self) -> list[str]:
        return sorted(path.stem for path in (self.static / "strings").glob("*.json"))

    @property
    def cameras(self) -> list[Any]:
        return self.live.cameras

    async def run(self) -> None:
        """Until cancelled."""
        self.feed.run(asyncio.get_running_loop())
        async with asyncio.TaskGroup() as group:
            group.create_task(self._beat())
            group.create_task(self._lease())
            group.create_task(self._follow())

    def close(self) -> None:
        """Safe to call twice."""
        for task in list(self._tasks):
            task.cancel()
        if self.foxglove is not None:
            self.foxglove.close()
            self.foxglove = None
        self.feed.close()
        self.commands.close()
        self._context.destroy(linger=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def answers(self, session: str) -> bool:
        """Whether a page of it is there, and awake."""
        now = time.monotonic()
        return any(one.session == session and now - one.answered_s < ANSWERS_S for one in self.hub.viewers)

    async def _beat(self) -> None:
        was_there = True
        while True:
            self.feed.listen()
            if self.foxglove is not None:
                self.hub.changed()
            alive = self.live.alive()
            if alive["daemon"] != was_there:
                say("the daemon is there" if alive["daemon"] else f"nothing is heard of the daemon for {LOST_S:g} s")
                was_there = alive["daemon"]
                self.look()
            now = time.monotonic()
            for viewer in list(self.hub.viewers):
                you = {"dropped": viewer.dropped, "commands": self.lease.holder == viewer.session != ""}
                viewer.newest("alive", STATUS, wire.status("alive", {**alive, "you": you}))
                since, end = self.stuck.get(viewer, (now, None))
                if now - since > STUCK_S:
                    say("a viewer that took nothing for 10 s was cut off")
                    end()
            await asyncio.sleep(ALIVE_S)

    async def _lease(self) -> None:
        while True:
            await asyncio.sleep(RENEW_S)
            await self.lease.renew()

    async def _follow(self) -> None:
        while True:
            self._ask_about.clear()
            if self.live.alive()["daemon"]:
                with contextlib.suppress(Refusal, ValueError):  # an older daemon does not know the question
                    answer = await self.commands.ask({"do": "about"})
                    about = untrusted.mapping(answer.get("about"), "about")
                    if about != self.about:
                        self.about = about
                        cameras = about.get("cameras")
                        self.live.cameras = list(cameras) if isinstance(cameras, list) else []
                        self.live.latest("about", about)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(ABOUT_S):  # wait_for may forget a cancellation
                    await self._ask_about.wait()
            await asyncio.sleep(0.1)  # several changes at once are one


def say(line: str) -> None:
    """To whoever watches the terminal."""
    print(untrusted.one_line(line), file=sys.stderr, flush=True)
