"""The simulated head in real time, as its own process: a controller on a serial line and a camera on a socket.

    with start_head(demo_world(), fps=15.0) as head:
        client = Client(head.port_url)                # as for a real controller
        camera = RemoteCamera(head.camera_address)      # as for a real camera

The head's process runs the firmware in virtual time slaved to the monotonic clock, natively behind a pty or as the
shipped image on an emulated board behind TCP. It renders what the lamps lit and puts the frames into an anonymous
memory file that `RemoteCamera` receives over its socket: nothing has a name in the file system, nothing can be left
behind. A frame that cannot be rendered in time is the driver's drop: a hole in the sequence.
"""

import array
import contextlib
import json
import math
import mmap
import os
import queue
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from annulus.capture.camera import BAYER_RGGB8
from annulus.capture.remote import MESSAGE_MAX
from annulus.capture.timing import FrameTiming
from annulus.controller import PIN_LED, PIN_PROJECTOR, TICK_NS, TICK_S
from annulus.twin.emulated import open_board
from annulus.twin.line import Line, PtyLine, TcpLine
from annulus.twin.render import Renderer
from annulus.twin.sensor import Exposure, Faults, HostClock, LossyLine, Sensor, load_faults
from annulus.twin.worlds import World, demo_world
from annulus.vocabulary import AnnulusError

SLOTS = 6  # frames between head and camera
EMULATOR_WARM_TICKS = 50_000_000  # node compiles what runs often
SETTLE_S = 2.0  # from the camera's start to the cable's, time to calibrate and arm
MM_PER_FRAME = 3.0
READOUT_MAX_US = 28_000.0  # of the sensor at 1664x1232
SLACK_US = 2_000.0  # exposure ends this much short of the frame period
BOOT_WATCHDOG = 1  # messages.BootCause
COUNTED = (
    "frames", "rendered", "dropped_on_purpose", "driver_dropped_no_buffer", "driver_dropped_too_slow", "resets",
    "pulls", "serial_overflow", "camera_closed",
)  # fmt: skip
_START_S = 90.0  # the first start of a fresh clone compiles the renderer


def head_timing(fps: float) -> FrameTiming:
    """The twin camera's mode at a frame rate: exposure 2 ms short of the period, readout 28 ms or less."""
    period = 1e6 / fps
    exposure = period - min(SLACK_US, 0.05 * period)
    return FrameTiming(fps, exposure, min(READOUT_MAX_US, 0.7 * period))


@dataclass
class HeadHandle:
    """A running head, seen from the process that started it. Close it, or use it as a context."""

    port_url: str
    camera_address: str
    timing: FrameTiming
    process: "subprocess.Popen[bytes]" = field(repr=False)
    _lines: "queue.SimpleQueue[bytes]" = field(repr=False)

    def counters(self) -> dict[str, Any]:
        """What the head counts: frames, rendered, driver drops by reason, events lost on purpose, z_mm, lamps_on,
        behind_ms: how far the world fell behind the clock at worst; a head that needs more than this machine has is
        no head to judge a host by.
        """
        return cast(dict[str, Any], self._ask({"do": "counters"}))

    def pull(self, speed_mm_s: float) -> None:
        """Let the cable move at this speed from now on; 0 stops it."""
        self._ask({"do": "pull", "speed_mm_s": speed_mm_s})

    def close(self) -> None:
        """End the head. Safe to call twice."""
        if self.process.stdin is not None:
            with contextlib.suppress(OSError):
                self.process.stdin.close()
        try:
            self.process.wait(3.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def _ask(self, question: Mapping[str, Any]) -> Any:
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(question).encode() + b"\n")
            self.process.stdin.flush()
            answer = json.loads(self._lines.get(timeout=5.0))
        except (OSError, ValueError, queue.Empty):
            raise AnnulusError("twin head: does not answer, expected it to run until closed") from None
        return answer

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def start_head(
    world: World,
    fps: float,
    faults: Faults | str | Path | None = None,
    *,
    timing: FrameTiming | None = None,
    seed: int = 0,
    speed_mm_s: float | None = None,
    drift_ppm: float = 30.0,
    threads: int | None = None,
    board: str = "native",
) -> HeadHandle:
    """Start a head in its own process and wait until it can be talked to.

    fps : of the camera, which runs at once and for ever. timing : exposure and readout, by default `head_timing(fps)`.
    speed_mm_s : of the cable, which starts 2 s after the camera was first started; None: 3 mm a frame, 0: not before
    `pull`. drift_ppm : of the head's crystal against this machine's clock. threads : that render, by default one a
    core, two at most. board : native or emulated, the shipped image.

    Raises AnnulusError when the head does not come up, with the last thing it said.
    """
    mode = timing or head_timing(fps)
    order = {
        "world": world.to_dict(),
        "timing": asdict(mode),
        "faults": asdict(faults if isinstance(faults, Faults) else load_faults(faults)),
        "seed": seed,
        "speed_mm_s": MM_PER_FRAME * fps if speed_mm_s is None else speed_mm_s,
        "drift_ppm": drift_ppm,
        "threads": threads or default_threads(),
        "board": board,
    }
    process = subprocess.Popen(
        [sys.executable, "-c", "from annulus.twin.head import main; main()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdin is not None and process.stdout is not None and process.stderr is not None
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    said: list[bytes] = []
    listeners = [
        threading.Thread(target=_collect, args=(stream, keep), daemon=True)
        for stream, keep in ((process.stdout, lines.put), (process.stderr, said.append))
    ]
    for listener in listeners:
        listener.start()
    try:
        process.stdin.write(json.dumps(order).encode() + b"\n")
        process.stdin.flush()
        up = json.loads(lines.get(timeout=_START_S))
        return HeadHandle(up["port"], up["camera"], mode, process, lines)
    except BaseException as error:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1.0)  # what broke it is still being said
        process.kill()
        process.wait()
        if isinstance(error, queue.Empty | OSError | ValueError | KeyError):
            listeners[1].join(1.0)
            spoken = [line for line in said if line.strip()]
            last = spoken[-1].decode(errors="replace").strip() if spoken else "it said nothing"
            raise AnnulusError(f"twin head: did not start ({last})") from None
        raise


def default_threads() -> int:
    return max(1, min(2, os.cpu_count() or 1))


def _collect(stream: IO[bytes], keep: Any) -> None:
    with contextlib.suppress(OSError, ValueError):
        for line in stream:
            keep(line)
    keep(b"")


def run_head(fps: float, seed: int, faults: Path | None, board: str = "native") -> None:
    """A head on the demo's world until Ctrl-C, for a daemon or `annulus head` in another terminal."""
    with start_head(demo_world(seed), fps, faults, seed=seed, board=board) as head:
        print(f'controller  {head.port_url}\ncamera      {head.camera_address}   (camera kind "twin" in head.toml)')
        print(f"timing      {head.timing}\nCtrl-C ends it.", flush=True)
        try:
            while head.process.poll() is None:
                time.sleep(0.2)
        except KeyboardInterrupt:
            return
    raise AnnulusError("twin head: ended by itself")


def sustainable_fps(world: World, threads: int | None = None, frames: int = 8) -> float:
    """Projector frames a second that this machine renders now, on as many threads as the head would use.

    Measured over the world's whole travel, after a first frame that may compile. It leaves nothing for anybody else.
    """
    renderer = Renderer(world)
    renderer.render(world.pose(0.0), 0.0, 1.0)
    threads = threads or default_threads()
    stations = np.linspace(0.0, world.travel_mm, frames * threads)

    def work(mine: NDArray[np.float64]) -> None:
        for z in mine:
            renderer.render(world.pose(float(z)), float(z), 1.0)

    crew = [threading.Thread(target=work, args=(stations[i::threads],)) for i in range(threads)]
    start = time.perf_counter()
    for thread in crew:
        thread.start()
    for thread in crew:
        thread.join()
    return len(stations) / (time.perf_counter() - start)


# ---- the head's process ------------------------------------------------------------------------------------------
def main() -> None:
    """The head's process: an order on stdin, addresses on stdout, questions and answers; the end of stdin ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the daemon's, which disarms the lamps through this head
    try:
        order = json.loads(sys.stdin.buffer.readline())
        head = _Head(order)
    except AnnulusError as error:
        sys.exit(str(error))
    try:
        head.run()
    finally:
        head.close()


class _Head:
    """Board, sensor, camera socket and pty on one loop; rendering on threads that hold no lock of Python's."""

    def __init__(self, order: Mapping[str, Any]) -> None:
        self.world = World.from_dict(order["world"])
        faults = order["faults"]
        self.faults = Faults(**{**faults, "resets": tuple(faults["resets"])})
        self.timing = FrameTiming(**order["timing"])
        self.counts = Counter({name: 0 for name in COUNTED})
        self.renderer = Renderer(self.world)
        self.renderer.render(self.world.pose(0.0), 0.0, 1.0, rows=(0, 8))  # compile before time starts
        self.board = open_board(str(order["board"]))
        self.boot = 1 + int(order["seed"]) % 200
        self.board.power_on(self.boot)
        self.line = LossyLine(self.faults, int(order["seed"]))
        self.speed_mm_s = float(order["speed_mm_s"])
        self.pull_at: int | None = None
        is_native = order["board"] == "native"
        self.serial: Line = PtyLine() if is_native else TcpLine()
        self.patience_s = (2e-4, 1e-3) if is_native else (5e-4, 3e-3)  # a look at the emulator costs 0.2 ms
        self.behind_ms = 0.0  # at worst, the world against the clock
        self.to_host = bytearray()
        height, width = self.renderer.height, self.renderer.width
        self.memory_fd = os.memfd_create("annulus-twin", os.MFD_CLOEXEC)
        os.ftruncate(self.memory_fd, SLOTS * height * width)
        self.memory = mmap.mmap(self.memory_fd, 0)
        self.slots = np.frombuffer(self.memory, np.uint8).reshape(SLOTS, height, width)
        self.free = list(range(SLOTS))
        self.held: set[int] = set()  # slots the camera was given and has not released
        self.address = f"annulus-twin-{os.getpid()}"
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self.listener.bind("\0" + self.address)
        self.listener.listen(1)
        self.viewer: socket.socket | None = None
        self.streaming = False
        self.generation = 0  # of the stream: frames of an earlier one are not delivered
        self.jobs: queue.Queue[tuple[int, int, Exposure]] = queue.Queue(int(order["threads"]))
        self.done: queue.SimpleQueue[tuple[int, int, Exposure]] = queue.SimpleQueue()
        self.waiting: list[int] = []  # sequences in rendering, oldest first
        self.rendered: dict[int, tuple[int, int, Exposure]] = {}
        self.wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        for _ in range(int(order["threads"])):
            threading.Thread(target=self._render, daemon=True).start()
        if not is_native:
            self.board.run_until(self.board.tick + EMULATOR_WARM_TICKS)
        start = self.board.tick
        clock = HostClock(time.monotonic_ns() - start * TICK_NS, float(order["drift_ppm"]))
        self.sensor = Sensor(
            self.world, self.timing, self.faults, seed=int(order["seed"]), clock=clock, start_tick=start
        )
        period = self.timing.period_us * 100
        self.resets = [self.sensor.edge(frame) + round(period * 0.4) for frame in sorted(self.faults.resets)]

    def run(self) -> None:
        """Until stdin ends."""
        sys.stdout.write(json.dumps({"port": self.serial.url, "camera": "@" + self.address}) + "\n")
        sys.stdout.flush()
        os.set_blocking(sys.stdin.fileno(), False)
        asked = b""
        busy_until = 0.0
        while True:
            viewer = [self.viewer] if self.viewer else []
            # while the host talks, answer soon; else a tenth of a frame will do
            patience = self.patience_s[0 if time.monotonic() < busy_until else 1]
            readable, _, _ = select.select(
                [*self.serial.waitables(), self.listener, sys.stdin, self.wake, *viewer], [], [], patience
            )
            self._advance()
            if heard := self.serial.read():
                self.board.serial_write(heard)
                busy_until = time.monotonic() + 3e-3
            if sys.stdin in readable:
                more = os.read(sys.stdin.fileno(), MESSAGE_MAX)
                if not more:
                    return
                *questions, asked = (asked + more).split(b"\n")
                for question in questions:
                    sys.stdout.write(json.dumps(self._answer(json.loads(question))) + "\n")
                    sys.stdout.flush()
            if self.viewer and self.viewer in readable:
                self._hear()
            if self.listener in readable:
                self._admit()
            if self.wake in readable:
                with contextlib.suppress(BlockingIOError):
                    os.eventfd_read(self.wake)
            self._deliver()

    def close(self) -> None:
        for _ in range(8):  # threads are daemons, but let none write into memory that goes away
            with contextlib.suppress(queue.Full):
                self.jobs.put_nowait((-1, 0, cast(Exposure, None)))
        if self.viewer:
            self.viewer.close()
        self.listener.close()
        self.serial.close()
        self.board.close()

    # ---- time ----
    def _advance(self) -> None:
        """Bring the firmware's world to now."""
        now = self.sensor.clock.tick(time.monotonic_ns())
        while self.resets and self.resets[0] <= now:
            self._run_to(self.resets[0])
            self.resets.pop(0)
            self.boot = self.boot % 255 + 1
            self.board.power_on(self.boot, BOOT_WATCHDOG)
            self.counts["resets"] += 1
        self._run_to(now)
        self.behind_ms = max(self.behind_ms, (self.sensor.clock.tick(time.monotonic_ns()) - now) * 1e3 * TICK_S)
        if self.pull_at is not None and now >= self.pull_at:
            self.sensor.pull(now + 1, self.speed_mm_s)
            self.pull_at = None
        self.to_host += self.line.carry(self.board.serial_read())
        if self.to_host:
            del self.to_host[: self.serial.write(bytes(self.to_host))]
            if len(self.to_host) > 65536:  # nobody reads: a real line would have lost it too
                self.counts["serial_overflow"] += len(self.to_host)
                self.to_host.clear()

    def _run_to(self, tick: int) -> None:
        for at, pin, level in self.sensor.stimuli(tick):
            self.board.input(max(at, self.board.tick), pin, level)
        self.board.run_until(tick)
        for exposure in self.sensor.exposures(tick, self.board.pins()):
            self._order(exposure)

    def _order(self, exposure: Exposure) -> None:
        """Have a frame rendered, or drop it as a driver without a free buffer does."""
        self.counts["frames"] += 1
        if not self.streaming:
            return
        if exposure.dropped:
            self.counts["dropped_on_purpose"] += 1
        elif not self.free:
            self.counts["driver_dropped_no_buffer"] += 1
        else:
            slot = self.free.pop()
            try:
                self.jobs.put_nowait((slot, self.generation, exposure))
                self.waiting.append(exposure.sequence)
            except queue.Full:
                self.free.append(slot)
                self.counts["driver_dropped_too_slow"] += 1

    def _render(self) -> None:
        while True:
            slot, generation, exposure = self.jobs.get()
            if slot < 0:
                return
            self.renderer.render(
                exposure.pose, exposure.z_mm, exposure.projector, exposure.led, seed=exposure.sequence,
                out=self.slots[slot],
            )  # fmt: skip
            self.done.put((slot, generation, exposure))
            os.eventfd_write(self.wake, 1)

    # ---- camera ----
    def _deliver(self) -> None:
        """Hand rendered frames to the camera in order."""
        while not self.done.empty():
            item = self.done.get()
            self.rendered[item[2].sequence] = item
        while self.waiting and self.waiting[0] in self.rendered:
            slot, generation, exposure = self.rendered.pop(self.waiting.pop(0))
            self.counts["rendered"] += 1
            if self.viewer is None or not self.streaming or generation != self.generation:
                self.free.append(slot)
                continue
            told = {
                "slot": slot,
                "SensorTimestamp": exposure.timestamp_ns,
                "FrameSequence": exposure.sequence,
                "ExposureTime": round(self.timing.exposure_us),
                "FrameDuration": round(self.timing.period_us),
            }
            try:
                self.viewer.send(json.dumps(told).encode())
                self.held.add(slot)
            except BlockingIOError:
                self.free.append(slot)
                self.counts["driver_dropped_no_buffer"] += 1
            except OSError:
                self.free.append(slot)
                self._leave()

    def _admit(self) -> None:
        with contextlib.suppress(OSError):
            viewer, _ = self.listener.accept()
            credentials = viewer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
            if self.viewer is not None or int.from_bytes(credentials[4:8], sys.byteorder) != os.getuid():
                viewer.close()  # a camera has one user, and it is ours
                return
            viewer.setblocking(False)
            hello = {
                "width": self.renderer.width, "height": self.renderer.height, "encoding": BAYER_RGGB8,
                "timing": asdict(self.timing),
            }  # fmt: skip
            rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [self.memory_fd]))]
            viewer.sendmsg([json.dumps(hello).encode()], rights)
            self.viewer = viewer

    def _hear(self) -> None:
        assert self.viewer is not None
        try:
            while told := self.viewer.recv(MESSAGE_MAX):
                message = json.loads(told)
                if message["do"] == "release":
                    self.held.remove(message["slot"])
                    self.free.append(message["slot"])
                else:
                    self.streaming = message["do"] == "start"
                    self.generation += 1
                    if self.streaming and self.pull_at is None and self.speed_mm_s and not self.counts["pulls"]:
                        self.counts["pulls"] += 1
                        self.pull_at = self.sensor.clock.tick(time.monotonic_ns()) + round(SETTLE_S / TICK_S)
            self._leave()
        except BlockingIOError:
            pass
        except (OSError, ValueError, KeyError):
            self._leave()

    def _leave(self) -> None:
        """The camera was closed: its buffers are ours again."""
        if self.viewer is not None:
            self.viewer.close()
        self.viewer, self.streaming = None, False
        self.generation += 1
        self.free += sorted(self.held)
        self.held.clear()
        self.counts["camera_closed"] += 1

    def _answer(self, question: Mapping[str, Any]) -> dict[str, Any]:
        now = self.sensor.clock.tick(time.monotonic_ns())
        if question.get("do") == "pull":
            self.speed_mm_s = float(question["speed_mm_s"])
            self.pull_at = now if math.isfinite(self.speed_mm_s) else None
            self.counts["pulls"] += 1
            return {}
        on = [name for name, pin in (("projector", PIN_PROJECTOR), ("led", PIN_LED)) if self.board.level(pin)]
        return {
            **self.counts,
            "events_lost": self.line.events_lost,
            "bytes_flipped": self.line.bytes_flipped,
            "z_mm": self.sensor.z_mm(now),
            "lamps_on": on,
            "behind_ms": self.behind_ms,
        }
