"""A head at the bench, and what tests do with it."""

import contextlib
import time
from dataclasses import dataclass
from typing import TypeVar

from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import RESET_MAGIC, Command, Commit, Event, Reset, Stage, StatusCode
from annulus_pipe.link.session import EventReceived
from annulus_pipe.selftest.scope import Scope
from annulus_pipe.vocabulary import AnnulusError

RESTART_S = 0.05
BACK_S = 5.0  # until a port over USB has been made anew
E = TypeVar("E", bound=Event)


@dataclass
class Bench:
    """A head, and what a test does with it. Time is the port's: virtual on a simulated head."""

    url: str
    client: Client
    scope: Scope

    def status_of(self, command: Command) -> StatusCode:
        answer = self.client.ask(command)
        assert answer is not None
        return answer.reply.status

    def configure(self, stage: Stage) -> None:
        for command in (stage, Commit(stage.generation)):
            assert self.status_of(command) is StatusCode.OK

    def restart(self) -> None:
        """A reset by the host, and the client that finds it again."""
        self.client.ask(Reset(RESET_MAGIC))
        with contextlib.suppress(AnnulusError):  # a port over USB goes away
            self.scope.quiet(RESTART_S)
        self.client.close()
        end = time.monotonic() + BACK_S
        while True:
            try:
                self.client = Client(self.url)
                break
            except AnnulusError:
                if time.monotonic() > end:
                    raise
                time.sleep(RESTART_S)
        self.scope = Scope(self.client, self.url)

    def heard(self, kind: type[E]) -> list[E]:
        """Events of a kind since the last `scope.heard.clear()`."""
        return [h.event for h in self.scope.heard if isinstance(h, EventReceived) and isinstance(h.event, kind)]
