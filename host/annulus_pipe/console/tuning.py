"""A lamp tuned from the page: the daemon's driver in a thread, for as long as the page that asked for it is there.

It holds a trial meanwhile, so it ends as a trial of the page's own does: when the page goes, or somebody cancels, lamps
are dark and the former times are back within a second; when this program goes, the daemon does that by itself.
"""

import asyncio
import threading
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from annulus_pipe import untrusted
from annulus_pipe.console.access import BrowserSession
from annulus_pipe.console.answers import Refusal, accepted, asked_for
from annulus_pipe.console.program import Program
from annulus_pipe.daemon.command import Operator
from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

LAMPS = ("projector", "led")
TELL_S = 0.25


class Tuning:
    """At most one. Its `state` is told as status `tune`: running, done, failed or cancelled."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._state: dict[str, Any] = {"state": "never"}
        self._cancelled = threading.Event()
        self._told_s = 0.0

    @property
    def is_running(self) -> bool:
        return bool(self._state["state"] == "running")

    def cancel(self) -> None:
        if not self.is_running:
            raise AnnulusError("nothing is being tuned that could be cancelled")
        self._cancelled.set()

    def begin(self, lamp: str, session: BrowserSession) -> None:
        if self.is_running:
            raise AnnulusError("a lamp is being tuned, expected its end or a cancel first")
        self._cancelled = threading.Event()
        self._tell(state="running", lamp=lamp, what="", done=0, total=1, proposed={}, remarks=[], error="")
        self._program.spawn(self._run(lamp, session, self._cancelled))

    async def _run(self, lamp: str, session: BrowserSession, cancelled: threading.Event) -> None:
        from annulus_pipe.daemon.tuning import Cancelled

        loop = asyncio.get_running_loop()

        def progress(what: str, done: int, total: int) -> None:
            loop.call_soon_threadsafe(self._progress, untrusted.one_line(what), done, total)

        watching = asyncio.create_task(self._watch(session, cancelled))
        try:
            found = await asyncio.to_thread(self._tune, lamp, session, progress, cancelled)
            remarks = [untrusted.one_line(line) for line in found.remarks]
            self._tell(state="done", proposed=dict(found.proposed), remarks=remarks)
        except Cancelled:
            self._tell(state="cancelled")
        except AnnulusError as error:
            self._tell(state="failed", error=untrusted.one_line(str(error)))
        except Exception as error:
            self._tell(state="failed", error=f"internal error, {type(error).__name__}")
            raise
        finally:
            cancelled.set()  # also when this program ends: the thread sees it before its next step
            watching.cancel()
            self._program.look()

    async def _watch(self, session: BrowserSession, cancelled: threading.Event) -> None:
        """Lamps do not stay on for a page that is gone."""
        while self._program.answers(session.id):
            await asyncio.sleep(TELL_S)
        cancelled.set()

    def _tune(self, lamp: str, session: BrowserSession, progress: Any, cancelled: threading.Event) -> Any:
        from annulus_pipe.daemon.tuning import tune

        daemon = self._program.daemon
        who = self._program.who(session)
        with ControlClient(
            daemon.control, daemon.control_keys, Operator(who["id"], who["name"], who.get("from", ""))
        ) as client:
            return tune(
                client, daemon.publish, lamp, keys=daemon.publish_keys, progress=progress, cancelled=cancelled.is_set
            )

    def _progress(self, what: str, done: int, total: int) -> None:
        now = time.monotonic()
        self._state |= {"what": what, "done": done, "total": total}
        if self.is_running and now - self._told_s >= TELL_S:
            self._told_s = now
            self._tell()

    def _tell(self, **changed: Any) -> None:
        self._state = {**self._state, **changed}
        self._program.live.latest("tune", self._state)


def routes(program: Program) -> list[Any]:
    from starlette.routing import Route

    tuning = Tuning(program)

    async def begin(request: "Request") -> "Response":
        asked: Mapping[str, Any] = await asked_for(request)
        mine: BrowserSession = request.state.session
        lamp = asked.get("lamp")
        if lamp not in LAMPS:
            raise Refusal(400, f"lamp is {untrusted.shown(lamp)}, expected one of {', '.join(LAMPS)}")
        if not mine.confirm(asked.get("confirm"), time.monotonic()):
            raise Refusal(403, "not confirmed: lamps come on after a second step, within 10 s of the first")
        if not program.answers(mine.id):
            raise Refusal(409, "no page of yours is open that would see the lamps come on")
        tuning.begin(lamp, mine)
        return accepted()

    async def cancel(request: "Request") -> "Response":
        tuning.cancel()
        return accepted()

    return [Route("/api/tune", begin, methods=["POST"]), Route("/api/tune/cancel", cancel, methods=["POST"])]
