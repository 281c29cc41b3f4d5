"""An update through the line a controller answers on, for heads whose USB socket nobody reaches.

    if not write_over_line(port, application(image), progress):     # AnnulusError: refused, or the line stays away
        ...                                                         # this firmware knows nothing of it

The controller keeps the new application beside the one that runs and starts it only when it is whole, so breaking off
at any moment costs nothing, and the next attempt goes on where this one ended. One chunk is under way at a time: while
the controller writes its flash it takes no bytes.
"""

import time
from collections.abc import Callable

from annulus_pipe.controller import UPDATE_CHUNK_BYTES
from annulus_pipe.flash.image import Application
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import (
    StatusCode,
    UpdateBegin,
    UpdateBeginReply,
    UpdateData,
    UpdateDataReply,
    UpdateEnd,
    UpdateRefusal,
)
from annulus_pipe.link.problems import refusal
from annulus_pipe.link.session import Answer
from annulus_pipe.vocabulary import AnnulusError

PATIENCE_S = 20.0  # with a line that went away, from the last chunk that got through
AGAIN_S = 0.2

Progress = Callable[[str, int, int], None]


class UpdateRefused(AnnulusError):
    """Trying again would not help."""


def write_over_line(port: str, new: Application, progress: Progress | None = None) -> bool:
    """Bring an application to the controller on a port and restart it; whoever comes up then is for the caller to ask.

    False: its firmware knows no updates over a line, and nothing was changed.
    Raises AnnulusError when it refuses, or the line stays away; the old application runs on then.
    """
    sending = _Sending(port, new, progress or (lambda what, done, total: None))
    until = time.monotonic() + PATIENCE_S
    while True:
        before = sending.next
        try:
            with Client(port, diagnostics=True) as client:
                return sending.run(client)
        except UpdateRefused:
            raise
        except AnnulusError as error:
            if sending.next != before:
                until = time.monotonic() + PATIENCE_S
            if not sending.begun:
                raise
            if time.monotonic() > until:
                raise AnnulusError(
                    f"{port}: the update broke off after {sending.next} of {len(new.data)} bytes ({error})."
                    " The head runs on as before. Flash again: it goes on from there."
                ) from None
            time.sleep(AGAIN_S)


class _Sending:
    """One update, over as many sessions as it takes."""

    def __init__(self, port: str, new: Application, progress: Progress) -> None:
        self._port, self._new, self._progress = port, new, progress
        self.begun = False
        self.next = 0

    def run(self, client: Client) -> bool:
        """Within one session, to the end. False: unknown to this firmware."""
        size = len(self._new.data)
        answer = client.ask(UpdateBegin(size, self._new.crc, self._new.board.encode().ljust(8, b"\0")))
        if answer is None and not self.begun:
            return False
        self.next = self._due(answer)
        self.begun = True
        while self.next < size:
            chunk = self._new.data[self.next : self.next + UPDATE_CHUNK_BYTES].ljust(UPDATE_CHUNK_BYTES, b"\xff")
            self.next = self._due(client.ask(UpdateData(self.next, chunk)))
            self._progress("sending", min(self.next, size), size)
        answer = client.ask(UpdateEnd())
        if answer is not None:  # without one it may have restarted: who answers then says it
            self._due(answer)
        return True

    def _due(self, answer: Answer | None) -> int:
        """Offset of the chunk that is due. AnnulusError where it pays to begin another session."""
        if answer is None:
            raise AnnulusError("no answer")
        reply, command = answer.reply, answer.command
        here = f"{self._port}: the head runs on as before"
        if reply.status is StatusCode.BAD_STATE:
            if isinstance(command, UpdateBegin):
                raise UpdateRefused(
                    f"{self._port}: something is armed or moves, expected a head at rest. See annulus head disarm."
                )
            if reply.detail == UpdateRefusal.FOREIGN:
                raise UpdateRefused(f"{here}: it found no application for its board in what was sent")
            if reply.detail == UpdateRefusal.DAMAGED:
                raise UpdateRefused(f"{here}: what it keeps has another CRC than what was sent. Flash again.")
            if reply.detail == UpdateRefusal.NOT_NOW:
                raise AnnulusError("another host identified meanwhile")
        elif reply.status is StatusCode.OUT_OF_RANGE and reply.detail == UpdateBegin.FIELDS.index("board"):
            raise UpdateRefused(f"{self._port}: the controller is for another board, the image for {self._new.board}")
        elif reply.status is StatusCode.OUT_OF_RANGE and reply.detail == UpdateBegin.FIELDS.index("size"):
            raise UpdateRefused(
                f"{here}: it has no room for {len(self._new.data)} bytes, as firmware from before two slots."
                " Flash it once over USB."
            )
        elif reply.status is StatusCode.SCHEMA:
            raise AnnulusError("another host has the session")
        elif reply.status is not StatusCode.OK:
            raise UpdateRefused(f"{self._port}: {refusal(answer)}")
        return reply.next if isinstance(reply, UpdateBeginReply | UpdateDataReply) else self.next
