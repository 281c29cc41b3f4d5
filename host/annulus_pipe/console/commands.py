"""What viewers ask for, to the daemon's control socket; and whose command is renewed.

Each request has a socket of its own, so that an answer which comes late is never taken for another's. Who commands is
the daemon's to say: the console renews the command of a browser only while that browser's page answers, and never holds
a trial for it.
"""

import asyncio
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import msgpack
import zmq

from annulus_pipe import untrusted
from annulus_pipe.console.answers import Refusal
from annulus_pipe.console.feed import Context
from annulus_pipe.daemon.command import COMMAND_S
from annulus_pipe.stream.access import ClientKeys, connected

ANSWER_MAX = 1 << 16  # bytes
ANSWER_S: Mapping[str, float] = {"stop": 35.0, "start": 15.0, "resume": 15.0}  # a stop waits for workers and recorder
USUAL_S = 5.0
AT_ONCE = 8
RENEW_S = 3.0
LIT = ("start", "resume")  # what lights the lamps wants the second step


class Commands:
    """The control socket of one daemon."""

    def __init__(self, context: Context, address: str, keys: ClientKeys | None = None) -> None:
        self.address, self._context, self._keys = address, context, keys
        self._threads = ThreadPoolExecutor(AT_ONCE, "command")
        self._asking = 0

    async def ask(self, request: Mapping[str, Any], timeout_s: float | None = None) -> Mapping[str, Any]:
        """The daemon's answer, where it says yes. Raises Refusal with its reason, or that it says nothing."""
        wait_s = timeout_s or ANSWER_S.get(str(request.get("do")), USUAL_S)
        if self._asking >= AT_ONCE:
            raise Refusal(429, f"{AT_ONCE} requests wait for the daemon, expected fewer at once")
        self._asking += 1
        try:
            answer = await asyncio.get_running_loop().run_in_executor(self._threads, self._ask, request, wait_s)
        finally:
            self._asking -= 1
        if answer.get("ok") is not True:
            raise Refusal(409, untrusted.one_line(str(answer.get("error"))))
        return answer

    def close(self) -> None:
        self._threads.shutdown(wait=False, cancel_futures=True)

    def _ask(self, request: Mapping[str, Any], timeout_s: float) -> Mapping[str, Any]:
        try:
            packed = msgpack.packb(dict(request))
        except (ValueError, TypeError, OverflowError) as error:
            raise Refusal(400, f"what is asked cannot be passed on: {untrusted.one_line(str(error))}") from None
        socket = connected(self._context, zmq.DEALER, self.address, self._keys, ANSWER_MAX)
        try:
            socket.send(packed, zmq.NOBLOCK)
            if not socket.poll(int(1000 * timeout_s)):
                raise Refusal(504, f"no answer from the daemon within {timeout_s:g} s. Is it running, with [control]?")
            return untrusted.mapping(untrusted.unpack(socket.recv(), ANSWER_MAX), "answer")
        except (ValueError, zmq.ZMQError) as error:
            raise Refusal(504, f"the daemon's answer cannot be read: {untrusted.one_line(str(error))}") from None
        finally:
            socket.close(0)


class Lease:
    """Which of our sessions commands, as far as the daemon agreed; renewed while `answers` says that its page is there.

    A lapse is not mended by itself: whoever was away takes the command again on purpose.
    """

    def __init__(self, commands: Commands, answers: Callable[[str], bool]) -> None:
        self._commands, self._answers = commands, answers
        self._holder: tuple[str, Mapping[str, Any]] | None = None  # the session's id, and as the daemon knows it
        self._renewed_s = 0.0

    @property
    def holder(self) -> str | None:
        """The id of the session; None when none of ours."""
        return None if self._holder is None else self._holder[0]

    def heard(self, do: str, session: str, who: Mapping[str, Any]) -> None:
        """The daemon said yes to this session's request."""
        if do == "command":
            self._holder, self._renewed_s = (session, who), time.monotonic()
        elif do == "release" and self.holder == session:
            self._holder = None

    async def renew(self) -> None:
        """Call every RENEW_S."""
        holder = self._holder
        if holder is None:
            return
        if time.monotonic() - self._renewed_s > COMMAND_S:
            self._holder = None
        elif self._answers(holder[0]):
            asked = time.monotonic()
            try:
                await self._commands.ask({"do": "command", "who": dict(holder[1])})
                self._renewed_s = asked
            except Refusal as refusal:
                if refusal.status == 409 and self._holder is holder:  # another took it
                    self._holder = None
