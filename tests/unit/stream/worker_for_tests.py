"""A worker that does as the frame's `extra` says."""

import os
import signal
import sys
import time
from typing import Any

from annulus_pipe.stream.working import serve
from annulus_pipe.vocabulary import AnnulusError


class Obedient:
    def __init__(self, setup: Any) -> None:
        self.setup, self.told, self.reported = setup, [], False

    def frame(self, header, image, extra) -> Any:
        if extra == "raise":
            raise RuntimeError("asked to")
        if extra == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if extra == "hang":
            time.sleep(1000)
        return [int(image.sum()), extra]

    def note(self, kind, body) -> None:
        self.told.append([kind, body])

    def idle(self):
        report, self.told = self.told or None, []
        return report

    def close(self):
        return self.setup


class OfFlashes(Obedient):
    def flash(self, frames, extra) -> Any:
        self.frame(*frames[0], extra)
        return [[header.camera, int(image.sum())] for header, image in frames]


def prepare(setup: Any) -> Obedient:
    if setup == "broken":
        raise AnnulusError("/etc/x: mend it")
    if setup == "stillborn":
        sys.exit(3)
    return OfFlashes(setup) if setup == "flashes" else Obedient(setup)


serve(sys.argv[-1], prepare)
