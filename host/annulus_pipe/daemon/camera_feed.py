"""A camera's intake as the daemon sees it: slots go in, frames come out, and neither is ever waited for.

    feed = CameraFeed(0, config, account, observer)      # the process is on its way up, and looks at its camera
    width, height, encoding = feed.look()
    feed.join(ring, share)
    feed.stream()
    for one in feed.poll(): ...                          # Arrived, Began; each turn
    late = feed.rest(2.5)

The intake (camera.py) runs in a process of its own. One that dies or says nothing is killed, its slots are free again,
and another takes over: a spare, which is up and has opened nothing yet, for a camera has one user. A camera that the
caller made himself cannot go to another process: it is waited for in a thread of this one, which speaks the same words.
"""

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import msgpack

from annulus_pipe.capture.camera import CameraDriver
from annulus_pipe.capture.photometry import Light, Photometry
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.camera import PACKET_MAX, IntakeLoop, handed_in
from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.daemon.camera_state import BackOff, CameraState
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.stream.orphan import child
from annulus_pipe.stream.ring import FrameRing, RingSlot
from annulus_pipe.stream.workers import cannot_start, how_it_ended, process_state
from annulus_pipe.vocabulary import AnnulusError, CameraSequence

LOOK_S = 30.0  # to open a camera for the first time
OPEN_S = 15.0  # to open it again; some drivers take seconds to find their sensor
THREAD_SILENT_S = 2.5  # without a word of a camera of the caller's, which may wait so long by itself
HUNG_S = 1.0  # without a word, where one comes every 0.2 s
STOPPED_S = 0.4  # without a word, before the kernel is asked whether it is stopped, and between two questions
SPARE_S, SPARE_LAST_S = 1.0, 60.0  # between two starts of spares; of spares that die as they start
RESTART_LAST_S = 5.0  # between two starts of intakes that die as they start, each half a second of processor
FRUITFUL_S = 0.5  # of frames, and an intake has not died as it started
STALL_S = 0.1  # longer between two polls than this and it was us who did not listen
SEND_BYTES = 1 << 20  # of packets that wait for us, if the system lets them


@dataclass(frozen=True, slots=True)
class Arrived:
    """A frame, in its slot and held once; or without one, when none was free."""

    place: RingSlot | None
    sequence: CameraSequence | None
    timestamp_ns: int
    arrived_ns: int
    picture: Photometry
    metadata: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Began:
    """The camera begins to stream: it counts from the beginning, and what it missed it does not know."""

    since_ns: int  # it made no frame before; 0 where nobody can say


Happened = Arrived | Began


@dataclass(slots=True)
class _Spare:
    """An intake that nobody has told anything yet."""

    link: socket.socket
    process: subprocess.Popen[bytes]
    is_up: bool = False

    def look(self) -> bool:
        """Whether it lives, and is not stopped. Hears whether it is up."""
        try:
            self.is_up = bool(self.link.recv(PACKET_MAX, socket.MSG_DONTWAIT))
        except BlockingIOError:
            pass
        except OSError:
            self.is_up = False
        return self.process.poll() is None and process_state(self.process.pid) != "T"

    def close(self) -> None:
        self.link.close()
        self.process.kill()
        self.process.wait()


class CameraFeed:
    """All methods belong to one thread, which must outlive the process: the kernel ends it with the thread."""

    def __init__(
        self,
        number: int,
        config: CameraConfig,
        account: Account,
        observer: Observer,
        camera: CameraDriver | None = None,
        realtime: bool | None = False,
    ) -> None:
        """`camera`: the caller's own; None: what `config` says, in a process, with real-time priority as head.toml's
        `realtime` has it.
        """
        self.number, self.config = number, config
        self.state = CameraState.CLOSED
        self.ended = False  # the camera has no more frames
        self.problem = ""  # why not
        self.refused = ""  # why it could not be opened, as long as it has not been since `stream`
        self.trouble = ""  # what it lacks that may come back, one line
        self._camera, self._account, self._observer = camera, account, observer
        self._realtime = realtime
        self._ring: FrameRing | None = None
        self._share = 0
        self._lent: dict[int, RingSlot] = {}  # by stamp
        self._wanted = self._opened = False  # opened since it is wanted
        self._heeded = False  # what comes is of the stream that is wanted: it has begun
        self._since_s, self._troubled = 0.0, CameraState.CLOSED  # the trouble: since when, and of which kind
        self._entered: Counter[str] = Counter()  # by processes that are no more
        self._entered_now: Mapping[str, int] = {}
        self._back_off, self._fruitful = BackOff(RESTART_LAST_S), True  # whether the intake brought frames for a while
        self._first_s = 0.0  # when it brought the first; 0: none yet
        self._link: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None
        self._heard_s = self._polled_s = time.monotonic()
        self._start_s: float | None = None  # when the next process is started
        self._starting = True  # it has not said a word yet
        self._looked_s = 0.0  # whether it is stopped
        self._spare: _Spare | None = None
        self._spare_s, self._spare_back_off = 0.0, BackOff(SPARE_LAST_S)  # when it is looked after next
        self._start()
        self._say("look")

    @property
    def waitable(self) -> socket.socket | None:
        """Readable when there is something to poll."""
        return self._link

    @property
    def pid(self) -> int | None:
        return self._process.pid if self._process is not None else None

    @property
    def spare_pid(self) -> int | None:
        """Of the spare, once it is up."""
        return self._spare.process.pid if self._spare is not None and self._spare.is_up else None

    @property
    def is_open(self) -> bool:
        """Whether it streams, or has ended."""
        return self.ended or self.state in (CameraState.STREAMING, CameraState.SILENT)

    def numbers(self) -> dict[str, Any]:
        """For the telemetry."""
        entered = self._entered + Counter(dict(self._entered_now))
        return {"state": self.state.value, "entered": dict(entered), "slots_lent": len(self._lent)}

    def look(self) -> tuple[int, int, str]:
        """Width, height, encoding, once it is up. Raises AnnulusError when the camera is not there."""
        end = time.monotonic() + LOOK_S
        while self._link is not None and select.select([self._link], [], [], max(0.0, end - time.monotonic()))[0]:
            packet = self._link.recv(PACKET_MAX)
            if not packet:
                break
            kind, body = msgpack.unpackb(packet)
            if kind == "refused":
                raise AnnulusError(str(body[0]))
            if kind == "is":
                return int(body[0]), int(body[1]), str(body[2])
        raise AnnulusError(f"camera {self.number}: its process says nothing, expected the camera to be opened")

    def join(self, ring: FrameRing, share: int) -> None:
        """Frames go into this ring from now on; of its slots at most `share` are lent at a time."""
        self._ring, self._share = ring, share
        self._hand_over()

    def stream(self) -> None:
        """Frames from now on; `poll` brings them."""
        self._wanted = True
        self._opened, self.ended, self.problem, self.refused = False, False, "", ""
        self._heard_s = time.monotonic()
        self._say("stream")

    def rest(self, patience_s: float) -> list[Happened]:
        """No more frames; what was under way comes back. An intake that does not answer is killed."""
        self._wanted = False
        self._say("rest")
        happened: list[Happened] = []
        end = time.monotonic() + patience_s
        while self.state is not CameraState.CLOSED and self._link is not None and time.monotonic() < end:
            select.select([self._link], [], [], 0.05)
            happened += self.poll()
        if self.state is not CameraState.CLOSED and self._process is not None and self._link is not None:
            happened += self._replace(f"it did not stop within {patience_s:g} s")
        self.state, self.trouble, self._heeded = CameraState.CLOSED, "", False
        return happened

    def poll(self) -> list[Happened]:
        """What happened since the last call; never waits. Lends slots, replaces an intake that died or hangs."""
        now = time.monotonic()
        if now - self._polled_s > STALL_S:
            self._heard_s = now
        self._polled_s = now
        if self._start_s is not None and now >= self._start_s:
            self._start_again(now)
        happened, over = self._receive()
        silent_s = now - self._heard_s
        if over:
            happened += self._replace(self._how_it_ended())
        elif self._process is None and silent_s > THREAD_SILENT_S and self.state is CameraState.STREAMING:
            self._is_troubled(CameraState.SILENT, f"it said nothing for {silent_s:.1f} s")
        elif self._process is not None and self._link is not None and silent_s > self._patience_s:
            happened += self._replace(f"it said nothing for {silent_s:.1f} s")
        elif self._process is not None and silent_s > STOPPED_S and now > self._looked_s + STOPPED_S and self._wanted:
            self._looked_s = now
            if process_state(self._process.pid) == "T":
                happened += self._replace("its process was stopped by a signal")
        self._lend()
        if now >= self._spare_s and self._process is not None and self.state is CameraState.STREAMING:
            self._keep_spare(now)
        return happened

    def close(self) -> None:
        """Nothing of it is left; the caller's camera is."""
        self._wanted, self._start_s = False, None
        self._drop_spare()
        if self._link is not None:
            self._bury()
        if self._thread is not None:
            self._thread.join(THREAD_SILENT_S)

    # ---- the intake ----

    @property
    def _patience_s(self) -> float:
        if not self._wanted:
            return float("inf")
        slow = self._starting or self.state in (CameraState.CLOSED, CameraState.OPENING)
        return OPEN_S if slow else HUNG_S

    def _start(self) -> None:
        """Raises AnnulusError when no process can be started."""
        self._start_s, self._heard_s, self._starting = None, time.monotonic(), True
        if self._camera is not None:
            self._link, theirs = _link()
            loop = IntakeLoop(handed_in(self.config, self._camera), theirs)
            self._thread = threading.Thread(target=loop.run, name=f"camera {self.number}", daemon=True)
            self._thread.start()
            return
        if self._spare is not None and not self._spare.look():
            self._drop_spare()
        one, self._spare = self._spare or self._spawn(), None
        self._link, self._process = one.link, one.process

    def _start_again(self, now: float) -> None:
        """A machine without a process or a descriptor left may have one later: until then the camera is gone."""
        try:
            self._start()
        except AnnulusError as error:
            self._start_s = now + self._back_off.wait_s()
            if self._wanted:
                self._is_troubled(CameraState.GONE, str(error))
            return
        self._hand_over()
        if self._wanted:
            self._say("stream")

    def _spawn(self) -> _Spare:
        try:
            link, theirs = _link()
        except OSError as error:
            raise cannot_start(sys.executable, error) from None
        order = {
            "fd": theirs.fileno(),
            "parent": os.getpid(),
            "number": self.number,
            "camera": asdict(self.config),
            "realtime": self._realtime,
        }
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        with theirs:
            try:
                process = subprocess.Popen(
                    [*child("annulus_pipe.daemon.camera"), json.dumps(order)],
                    stdin=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(),),
                    process_group=0,  # the terminal's Ctrl-C is for the daemon
                    env=os.environ | one_thread,
                )
            except (OSError, MemoryError) as error:
                link.close()
                raise cannot_start(sys.executable, error) from None
        return _Spare(link, process)

    def _keep_spare(self, now: float) -> None:
        self._spare_s = now + SPARE_S
        if self._spare is None:
            with contextlib.suppress(AnnulusError):  # no more processes: it does without
                self._spare = self._spawn()
            return
        was_up = self._spare.is_up
        if not self._spare.look():
            self._drop_spare()
            self._spare_s = now + max(SPARE_S, self._spare_back_off.wait_s())
        elif was_up:  # and is, a look later
            self._spare_back_off.succeeded()

    def _drop_spare(self) -> None:
        if self._spare is not None:
            self._spare.close()
            self._spare = None

    def _hand_over(self) -> None:
        if self._link is not None and self._ring is not None:
            packet = msgpack.packb(["ring", [self._ring.frame_bytes]])
            socket.send_fds(self._link, [packet], [self._ring.fd])
            self._lend()

    def _how_it_ended(self) -> str:
        if self._process is None:
            return "its thread ended"
        code = self._process.wait()  # its socket closes a moment before it is gone
        return f"its process ended: {how_it_ended(code)}"

    def _replace(self, why: str) -> list[Happened]:
        """What it had said before it ended still counts."""
        happened = self._bury()
        self._account.lose("cameras_replaced")
        self._observer.event("camera_died", f"the intake of camera {self.number} is replaced: {why}")
        now = time.monotonic()
        self._start_s = now if self._fruitful else now + self._back_off.wait_s()
        self._fruitful, self._first_s = False, 0.0
        self._entered += Counter(dict(self._entered_now))
        self._entered_now = {}
        if self._wanted:
            self._is_troubled(CameraState.GONE, why)
        else:
            self.state = CameraState.CLOSED
        return happened

    def _bury(self) -> list[Happened]:
        assert self._link is not None
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        else:
            self._link.shutdown(socket.SHUT_WR)  # a thread cannot be killed: it ends when its camera lets it
        happened, _ = self._receive()
        self._link.close()
        self._link = None
        if self._ring is not None and self._process is not None:
            for place in self._lent.values():
                self._ring.give_back(place)
            self._lent.clear()
        return happened

    # ---- what is said ----

    def _say(self, kind: str, body: Any = None) -> bool:
        if self._link is None:
            return False
        try:
            self._link.send(msgpack.packb([kind, body]), socket.MSG_DONTWAIT)
        except OSError:  # it is dead, or stopped; `poll` sees to it
            return False
        return True

    def _lend(self) -> None:
        if self._link is None or self._ring is None:
            return
        new: list[RingSlot] = []
        while len(self._lent) + len(new) < self._share and (place := self._ring.lend()) is not None:
            new.append(place)
        if new and not self._say("slots", [[place.slot, place.stamp] for place in new]):
            for place in new:
                self._ring.give_back(place)
            return
        self._lent.update((place.stamp, place) for place in new)

    def _receive(self) -> tuple[list[Happened], bool]:
        """And whether its end has come."""
        happened: list[Happened] = []
        while self._link is not None:
            try:
                packet = self._link.recv(PACKET_MAX, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except ConnectionError:  # told once; what it had said can still be read
                continue
            if not packet:
                return happened, True
            self._heard_s, self._starting = self._polled_s, False
            kind, body = msgpack.unpackb(packet)
            match kind:
                case "frame":
                    happened += self._frame(*body)
                case "state":
                    happened += self._is_now(CameraState(body[0]), str(body[1]), body[2], body[3])
                case "remark":
                    self._observer.event("camera", str(body[0]))
                case "ended":
                    self.ended, self.problem = True, str(body[0])
        return happened, False

    def _frame(
        self,
        slot: int | None,
        stamp: int,
        sequence: int | None,
        timestamp_ns: int,
        arrived_ns: int,
        picture: dict[str, Any],
        metadata: Mapping[str, Any],
    ) -> list[Happened]:
        place = None
        if slot is not None and self._ring is not None:
            place = self._lent.pop(stamp)
            self._ring.filled(place)
        if not self._heeded:  # of a stream that was stopped
            if place is not None and self._ring is not None:
                self._ring.release(place)
            return []
        self._first_s = self._first_s or self._polled_s
        self._fruitful = self._fruitful or self._polled_s - self._first_s > FRUITFUL_S
        if self._fruitful:
            self._back_off.succeeded()
        if self.trouble:
            after_s = time.monotonic() - self._since_s
            self.trouble = ""
            self._observer.event("camera", f"camera {self.number} is back after {after_s:.1f} s")
        bands = tuple(Light(band) for band in picture["bands"])
        number = None if sequence is None else CameraSequence(sequence)
        measured = Photometry(**{**picture, "bands": bands})
        return [Arrived(place, number, timestamp_ns, arrived_ns, measured, metadata)]

    def _is_now(self, state: CameraState, why: str, entered: Mapping[str, int], since_ns: int) -> list[Happened]:
        before, self.state, self._entered_now = self.state, state, entered
        if before is CameraState.OPENING and state is CameraState.STREAMING:
            self._opened, self.refused = True, ""
            self._heeded = self._wanted
            return [Began(since_ns)]
        if state is CameraState.GONE and not self._opened:
            self.refused = why
        elif state in (CameraState.GONE, CameraState.SILENT):
            self._is_troubled(state, why)
        return []

    def _is_troubled(self, state: CameraState, why: str) -> None:
        """Told whenever it is another trouble than before; an attempt that ends as the last one did is only counted."""
        text = f"camera {self.number} is {state}: {why}"
        if not self.trouble:
            self._since_s = time.monotonic()
        if not self.trouble or self._troubled is not state:
            self._account.lose(f"camera_{state}")
        if self.trouble != text:
            self._observer.event("camera", f"{text}; it is tried again until it is back")
        self.state, self._troubled, self.trouble = state, state, text


def _link() -> tuple[socket.socket, socket.socket]:
    """Ours and theirs."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
    return ours, theirs
