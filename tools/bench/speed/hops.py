"""Where a frame is when, on its way from its camera to a viewer: the daemon's own processes, each stamping what passes.

    python -m tools.bench.speed.hops annulus_pipe.daemon.camera ARGUMENT   as python -m does, stamped
    stamps = Stamps.read(folder)                                         (process, what, key) -> time, ns

Stamps go into shared memory, a file a process in the folder that ANNULUS_HOPS names: a process that is killed leaves
them, and none waits for a disk. The key is the frame's arrived_ns, which no two frames share, or an edge's number.
"""

import functools
import mmap
import os
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ENVIRONMENT = "ANNULUS_HOPS"
STAMP = struct.Struct("<QQQ")  # what, key, ns
STAMPS_MAX = 1 << 17  # of one process: half an hour of 25 frames a second
WHAT = ("nothing", "read", "told", "had", "edge", "settled", "labelled", "sent", "taken", "published", "recorded")

Key = Callable[..., int]


class Stamping:
    """One process's stamps."""

    def __init__(self, folder: Path) -> None:
        path = folder / f"{os.getpid()}.stamps"
        with path.open("wb+") as file:
            file.truncate(STAMP.size * STAMPS_MAX)
            self._memory = mmap.mmap(file.fileno(), STAMP.size * STAMPS_MAX)
        self._count = 0

    def stamp(self, what: str, key: int) -> None:
        if self._count < STAMPS_MAX:
            STAMP.pack_into(self._memory, STAMP.size * self._count, WHAT.index(what), key, time.monotonic_ns())
            self._count += 1

    def before(self, owner: Any, name: str, what: str, key: Key) -> None:
        """Stamp each call of `owner.name` whose arguments have a key (not 0)."""
        call = getattr(owner, name)

        @functools.wraps(call)
        def stamped(*arguments: Any, **named: Any) -> Any:
            if found := key(*arguments, **named):
                self.stamp(what, found)
            return call(*arguments, **named)

        setattr(owner, name, stamped)

    def after(self, owner: Any, name: str, what: str, key: Key) -> None:
        """As `before`, when the call returns; `key` is also given what it returns, last."""
        call = getattr(owner, name)

        @functools.wraps(call)
        def stamped(*arguments: Any, **named: Any) -> Any:
            result = call(*arguments, **named)
            if found := key(*arguments, result):
                self.stamp(what, found)
            return result

        setattr(owner, name, stamped)


@dataclass(frozen=True, slots=True)
class Stamps:
    """By what, then by key: when, ns. The first of each."""

    of: Mapping[str, Mapping[int, int]]

    @staticmethod
    def read(folder: Path) -> "Stamps":
        of: dict[str, dict[int, int]] = {what: {} for what in WHAT}
        for path in folder.glob("*.stamps"):
            for what, key, at_ns in STAMP.iter_unpack(path.read_bytes()):
                if what:
                    of[WHAT[what]].setdefault(key, at_ns)
        return Stamps(of)

    def between(self, keys: Sequence[int], first: str, then: str) -> list[float]:
        """Milliseconds, in order of size, of the keys that have both."""
        one, other = self.of[first], self.of[then]
        return sorted((other[key] - one[key]) / 1e6 for key in keys if key in one and key in other)


def _camera(stamping: Stamping) -> None:
    from annulus_pipe.daemon import camera

    stamping.after(camera, "grab", "read", lambda _, frame: frame.arrived_ns)
    stamping.before(camera.IntakeLoop, "_say", "told", lambda _, kind, *body: body[4] if kind == "frame" else 0)


def _publisher(stamping: Stamping) -> None:
    from annulus_pipe.daemon import publisher

    def key(_: object, kind: str, body: Any, *more: object) -> int:
        return int(body[1]["arrived_ns"]) if kind == "label" else 0

    stamping.before(publisher.PublisherJob, "note", "taken", key)
    stamping.after(publisher.PublisherJob, "note", "published", key)


def _recorder(stamping: Stamping) -> None:
    from annulus_pipe.daemon import recorder

    stamping.after(recorder.RecorderJob, "frame", "recorded", lambda _, header, *more: header.arrived_ns)


def _daemon(stamping: Stamping) -> None:
    from annulus_pipe.daemon import camera_feed, intake, publishing
    from annulus_pipe.labelling import navigation
    from annulus_pipe.link.head import EdgeSeen

    def edge(_: object, event: object) -> int:
        return int(event.flash.edge) if isinstance(event, EdgeSeen) else 0

    stamping.before(camera_feed.CameraFeed, "_frame", "had", lambda *body: body[5])
    stamping.before(navigation.Navigation, "heard", "edge", edge)
    stamping.before(intake.Intake, "_label", "settled", lambda one: one._waiting[0].seen.arrived_ns)
    stamping.after(intake.Intake, "_label", "labelled", lambda one, result: result[0].arrived_ns)
    stamping.after(publishing.Publishing, "_send", "sent", lambda _, topic, body, none: body.get("arrived_ns", 0))
    run = subprocess.Popen

    def popen(command: Sequence[str], *more: Any, **how: Any) -> Any:
        if list(command[3:4]) and command[3] in STAMPED:  # as annulus_pipe.stream.orphan starts it
            command = [command[0], "-m", "tools.bench.speed.hops", *command[3:]]
        return run(command, *more, **how)

    subprocess.Popen = popen  # type: ignore[misc, assignment]


STAMPED: Mapping[str, Callable[[Stamping], None]] = {
    "annulus_pipe.daemon.camera": _camera,
    "annulus_pipe.daemon.publisher": _publisher,
    "annulus_pipe.daemon.recorder": _recorder,
    "annulus_pipe.cli": _daemon,
}


def main() -> None:
    """The module that the command line names, in this process, stamped."""
    name, *arguments = sys.argv[1:]
    STAMPED[name](Stamping(Path(os.environ[ENVIRONMENT])))
    sys.argv = [name, *arguments]
    if name == "annulus_pipe.cli":
        from annulus_pipe.cli import main as command

        sys.exit(command())
    module = sys.modules[name]
    if name == "annulus_pipe.daemon.camera":
        module.main(arguments[-1])
        return
    from annulus_pipe.stream.working import serve

    more = (module.REST_MS,) if hasattr(module, "REST_MS") else ()
    serve(arguments[-1], module._prepare, *more)


if __name__ == "__main__":
    main()
