"""What viewers ask for, to the daemon's control socket: one socket a request, so that an answer which comes late is
never taken for another's.
"""

import asyncio
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import msgpack
import zmq

from annulus import untrusted
from annulus.console.feed import connected
from annulus.daemon.control import ClientKeys
from annulus.vocabulary import AnnulusError

ANSWER_MAX = 1 << 16  # bytes
ANSWER_S = 35.0  # a stop waits for workers and recorder
AT_ONCE = 8


class NoDaemon(AnnulusError):
    """Nobody answers."""


class Commands:
    """The control socket of one daemon."""

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", address: str, keys: ClientKeys | None = None) -> None:
        self.address, self._context, self._keys = address, context, keys
        self._threads = ThreadPoolExecutor(AT_ONCE, "command")

    async def ask(self, request: Mapping[str, Any], timeout_s: float = ANSWER_S) -> Mapping[str, Any]:
        """The daemon's answer, also one that refuses. Raises NoDaemon."""
        return await asyncio.get_running_loop().run_in_executor(self._threads, self._ask, request, timeout_s)

    def close(self) -> None:
        self._threads.shutdown(wait=False, cancel_futures=True)

    def _ask(self, request: Mapping[str, Any], timeout_s: float) -> Mapping[str, Any]:
        socket = connected(self._context, zmq.DEALER, self.address, self._keys)
        try:
            socket.send(msgpack.packb(dict(request)))
            if not socket.poll(int(1000 * timeout_s)):
                raise NoDaemon(f"{self.address}: no answer within {timeout_s:g} s. Is a daemon with [control] running?")
            return untrusted.mapping(untrusted.unpack(socket.recv(), ANSWER_MAX), "answer")
        except ValueError as error:
            raise NoDaemon(f"{self.address}: {error}") from None
        finally:
            socket.close(0)
