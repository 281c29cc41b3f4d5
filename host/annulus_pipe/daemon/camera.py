"""One camera's intake: waits for frames, writes each into a slot of the ring, measures it, and tells the daemon.

    python -m annulus_pipe.daemon.camera '{"fd": .., "parent": .., "number": .., "camera": {..}, "realtime": ..}'

It has nothing else to do, so a turn of the daemon that takes long costs no frame as long as there are slots, and
whatever a camera's driver does to its process (wait for ever, crash) it does not do to the daemon. Daemon and intake
talk over a socket of packets, each msgpack [kind, body], `camera_feed.CameraFeed` is the other end:

    heard:  look                    open the camera and say what it is
            ring [frame_bytes]      with the ring's descriptor
            slots [[slot, stamp]..] free slots, ours to write until they are told back
            stream, rest            begin and end to take frames; what is lost in between is opened again
    said:   up                      once, before all else
            is [width, height, encoding]; refused [why]      the answers to look
            frame [slot or nil, stamp, sequence, timestamp_ns, arrived_ns, picture, metadata]; nil: no slot was free
            state [state, why, entered, since_ns]; remark [text]; alive; ended [problem]

`since_ns` is when the stream was begun, host monotonic, before which its camera made no frame of it; 0 of a film, whose
frames are older than that.

Nothing is kept back here: a frame is told at once, or is the driver's. The end of the socket is the end of the intake.
"""

import contextlib
import json
import os
import select
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import msgpack

from annulus_pipe.capture.camera import CameraDriver, CapturedFrame, EndOfFrames, grab
from annulus_pipe.capture.photometry import GREEN_FIRST, measure
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.daemon.camera_config import FILES, CameraConfig
from annulus_pipe.daemon.camera_state import CameraEvent, CameraState, CameraWatch
from annulus_pipe.daemon.cameras import apply_controls, open_camera
from annulus_pipe.daemon.priority import raise_priority
from annulus_pipe.stream.orphan import end_with_parent
from annulus_pipe.stream.ring import RingSlot, RingWriter
from annulus_pipe.stream.working import keep_freed_memory, leave_uncollected
from annulus_pipe.vocabulary import AnnulusError

PACKET_MAX = 1 << 16  # bytes; 1024 slots are 10 kB
SILENT_S = 1.5  # without a frame, or ..
SILENT_PERIODS = 10  # .. so many periods, whichever is longer
ALIVE_S = 0.2  # between two words at most, while nothing else is to be said
PACED_S = 1.0  # a file's frame waits for its time, but no longer


@dataclass(frozen=True, slots=True)
class Source:
    """A camera that can be opened again and again."""

    config: CameraConfig
    open: Callable[[], CameraDriver]
    give_back: Callable[[CameraDriver], None]  # what `open` gave, stopped

    @property
    def live(self) -> bool:
        """A camera that is gone may come back; a file that is broken does not, and its end is one."""
        return self.config.kind not in FILES


def configured(config: CameraConfig, number: int) -> Source:
    """What head.toml asks for: opened and closed here."""
    return Source(config, lambda: open_camera(config, number), lambda camera: camera.close())


def handed_in(config: CameraConfig, camera: CameraDriver) -> Source:
    """A camera that the caller made, and closes."""
    return Source(config, lambda: camera, lambda camera: None)


class IntakeLoop:
    """Runs until its socket ends."""

    def __init__(self, source: Source, link: socket.socket) -> None:
        self._source, self._link = source, link
        period_s = source.config.timing.period_us / 1e6
        self._silent_s = max(SILENT_S, SILENT_PERIODS * period_s)
        self._watch = CameraWatch()
        self._camera: CameraDriver | None = None
        self._ring: RingWriter | None = None
        self._slots: deque[RingSlot] = deque()
        self._wanted = False
        self._due_s = 0.0  # when the next frame is overdue
        self._since_ns = 0
        self._over = False

    def run(self) -> None:
        try:
            self._say("up")
            while not self._over:
                self._hear(self._idle_s)
                if self._wanted and not self._over:
                    self._turn()
        except OSError:  # the daemon is gone
            pass
        finally:
            self._give_up()
            self._link.close()
            if self._ring is not None:
                self._ring.close()

    @property
    def _idle_s(self) -> float | None:
        """How long to listen: for ever with nothing to do, not at all with a frame to wait for."""
        if not self._wanted:
            return None
        if self._watch.state is CameraState.GONE:
            return min(ALIVE_S, self._watch.retry_in_s(time.monotonic()))
        return 0.0

    # ---- the daemon ----

    def _hear(self, wait_s: float | None) -> None:
        """Everything that was said, after waiting for the first word. `wait_s` None: as long as it takes."""
        while not self._over and select.select([self._link], [], [], wait_s)[0]:
            wait_s = 0.0
            packet, rights, _, _ = socket.recv_fds(self._link, PACKET_MAX, 1)
            if not packet:
                self._over = True
                return
            kind, body = msgpack.unpackb(packet)
            match kind:
                case "look":
                    self._look()
                case "ring":
                    self._ring = RingWriter(rights[0], body[0])
                    os.close(rights[0])
                case "slots":
                    self._slots.extend(RingSlot(*one) for one in body)
                case "stream" if not self._wanted:
                    self._wanted = True
                    self._happened(CameraEvent.OPEN)
                case "rest":
                    self._rest()

    def _say(self, kind: str, *body: Any) -> None:
        self._link.send(msgpack.packb([kind, body]))

    def _happened(self, event: CameraEvent, why: str = "") -> None:
        if self._watch.happened(event, time.monotonic(), why):
            entered = {state.value: count for state, count in self._watch.entered.items()}
            self._say("state", self._watch.state.value, why, entered, self._since_ns)

    # ---- the camera ----

    def _look(self) -> None:
        try:
            camera = self._open()
        except Exception as error:
            self._say("refused", _line(error))
            return
        self._say("is", camera.width, camera.height, camera.encoding)

    def _open(self) -> CameraDriver:
        if self._camera is None:
            self._camera = self._source.open()
        return self._camera

    def _rest(self) -> None:
        self._wanted = False
        if self._camera is not None:
            try:
                self._camera.stop()
            except Exception as error:
                self._say("remark", _line(error))
                self._give_up()
        self._happened(CameraEvent.CLOSE)

    def _give_up(self) -> None:
        """The camera as it is, whatever it is still good for."""
        camera, self._camera = self._camera, None
        if camera is not None:
            with contextlib.suppress(Exception):  # it is broken: that is why
                camera.stop()
            with contextlib.suppress(Exception):
                self._source.give_back(camera)

    def _turn(self) -> None:
        """One frame, or one step towards the next."""
        try:
            if self._watch.retry_in_s(time.monotonic()) == 0.0:
                self._give_up()
                self._happened(CameraEvent.RETRY)
            if self._watch.state is CameraState.OPENING:
                self._start()
            elif self._watch.state is CameraState.GONE:
                self._say("alive")
            else:
                self._frame()
        except EndOfFrames:
            self._end("")
        except OSError as error:
            if isinstance(error, BrokenPipeError | ConnectionError):
                raise  # the daemon's end of the socket
            self._lost(error)
        except Exception as error:
            self._lost(error)

    def _start(self) -> None:
        camera = self._open()
        self._since_ns = time.monotonic_ns() if self._source.live else 0
        camera.start()
        for remark in apply_controls(camera, self._source.config):
            self._say("remark", remark)
        self._due_s = time.monotonic() + self._silent_s
        self._happened(CameraEvent.OPENED)

    def _frame(self) -> None:
        assert self._camera is not None
        try:
            frame = grab(self._camera)
        except TimeoutError as error:
            if time.monotonic() > self._due_s:
                self._happened(CameraEvent.SILENCE, str(error))
            self._say("alive")
            return
        if not self._source.live:
            self._wait_for(frame.timestamp_ns)
            frame = replace(frame, arrived_ns=time.monotonic_ns())
        place = self._slots.popleft() if self._slots and self._ring is not None else None
        if place is not None and self._ring is not None:
            self._ring.write(place, frame.image)
        self._happened(CameraEvent.FRAME)
        self._due_s = time.monotonic() + self._silent_s
        self._say("frame", *_packet(frame, place))

    def _wait_for(self, moment_ns: int) -> None:
        """A file is read faster than it was filmed. What is said meanwhile is heard, but nothing taken."""
        end_ns = min(moment_ns, time.monotonic_ns() + round(PACED_S * 1e9))
        while self._wanted and not self._over and (left_s := (end_ns - time.monotonic_ns()) / 1e9) > 0.0:
            self._hear(min(ALIVE_S, left_s))
            self._say("alive")

    def _lost(self, error: Exception) -> None:
        self._give_up()
        if not self._source.live:
            self._end(_line(error))
            return
        self._happened(CameraEvent.LOST, _line(error))

    def _end(self, problem: str) -> None:
        self._say("ended", problem)
        self._rest()


def _packet(frame: CapturedFrame, place: RingSlot | None) -> list[Any]:
    picture = asdict(measure(frame.image, green_first=frame.encoding in GREEN_FIRST))
    where = [None, 0] if place is None else [place.slot, place.stamp]
    return [*where, frame.sequence, frame.timestamp_ns, frame.arrived_ns, picture, _plain(frame.metadata)]


def _plain(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """What can be sent: libcamera's own types cannot."""
    plain = bool | int | float | str | None
    return {key: value for key, value in metadata.items() if isinstance(value, plain)}


def _line(error: Exception) -> str:
    return str(error) if isinstance(error, AnnulusError) else f"camera: {type(error).__name__}: {error}"


def main(argument: str) -> None:
    link: Mapping[str, Any] = json.loads(argument)
    # Killed, not asked: there is nothing here to be closed, and one that is stopped hears nothing else.
    end_with_parent(link["parent"], signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_freed_memory()
    leave_uncollected()
    cv2.setNumThreads(1)
    raise_priority(link["realtime"])  # what is refused the daemon has told of itself
    plain: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in link["camera"].items()
    }
    plain["timing"] = FrameTiming(**plain["timing"])
    config = CameraConfig(**plain)
    IntakeLoop(configured(config, link["number"]), socket.socket(fileno=link["fd"])).run()


if __name__ == "__main__":
    main(sys.argv[-1])
