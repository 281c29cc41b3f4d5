"""The head's process: board, camera, sensors and serial line on one loop, slaved to the monotonic clock."""

import contextlib
import json
import math
import os
import select
import signal
import sys
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import msgpack
import numpy as np
import zmq

from annulus_pipe.capture.camera import BAYER_RGGB8
from annulus_pipe.capture.remote import MESSAGE_MAX
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.controller import PIN_LED, TICK_NS, TICK_S, TICKS_PER_US
from annulus_pipe.link.messages import BootCause
from annulus_pipe.link.pins import SLIDE_PINS, pins_from
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.twin.camera_server import CameraServer
from annulus_pipe.twin.drawing import Drawing, DrawingJob
from annulus_pipe.twin.driver import Driver
from annulus_pipe.twin.emulated import EmulatedBoard, open_board
from annulus_pipe.twin.faults import Faults, LossyLine
from annulus_pipe.twin.image_sensor import Exposure, HostClock
from annulus_pipe.twin.line import Line, PtyLine, TcpLine
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.sensors import HeadSensors
from annulus_pipe.twin.triggered import sensor_of
from annulus_pipe.twin.worlds.world import World
from annulus_pipe.vocabulary import AnnulusError

EMULATOR_WARM_TICKS = 50_000_000  # node compiles what runs often
LEVEL = 20  # of SCHED_FIFO, 1..99; before the daemon's 10
LATE_S = 0.3  # further behind, the world's time is stretched: a host's silence of 0.5 s would be the twin's own
SETTLE_S = 2.0  # from the camera's start to the cable's, time to calibrate and arm
SAMPLES_WAITING_MAX = 1000  # at a subscriber that does not read
COUNTED = (
    "frames",
    "rendered",
    "dropped_on_purpose",
    "driver_dropped_no_buffer",
    "driver_dropped_too_slow",
    "resets",
    "power_losses",
    "disconnects",
    "pulls",
    "serial_overflow",
    "camera_closed",
    "samples",
)


def main() -> None:
    """An order on stdin, addresses on stdout, questions and answers; the end of stdin ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the daemon's, which disarms the lamps through this head
    try:
        order = json.loads(sys.stdin.buffer.readline())
        head = TwinHead(order)
    except AnnulusError as error:
        sys.exit(str(error))
    try:
        head.run()
    finally:
        head.close()


class _SamplePublisher:
    """Two parts a sample, its sensor's name and msgpack of `Sample.to_dict()`. A slow subscriber loses samples."""

    def __init__(self) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.PUB)
        self._socket.setsockopt(zmq.SNDHWM, SAMPLES_WAITING_MAX)
        self._socket.setsockopt(zmq.LINGER, 0)
        self.address = f"ipc://@annulus-twin-sensors-{os.getpid()}"
        self._socket.bind(self.address)

    def send(self, sample: Sample) -> None:
        self._socket.send_multipart([sample.sensor.encode(), msgpack.packb(sample.to_dict())])

    def close(self) -> None:
        self._context.destroy(linger=0)


class _TwinCamera:
    """One of the head's cameras: its driver, what draws its frames, and where they are asked for."""

    def __init__(
        self, number: int, renderer: Renderer, driver: Driver, timing: FrameTiming, counts: Counter[str], threads: int
    ) -> None:
        hello = {"width": renderer.width, "height": renderer.height, "encoding": BAYER_RGGB8, "timing": asdict(timing)}
        self.server = CameraServer(hello, counts, number)
        self.drawing = Drawing(renderer, self.server.slots, threads)
        self.driver = driver
        self.drawn: deque[DrawingJob] = deque()  # until the driver hands them over


class TwinHead:
    def __init__(self, order: Mapping[str, Any]) -> None:
        self.world = World.from_dict(order["world"])
        self.faults = Faults.from_dict(order["faults"])
        others = [Faults.from_dict(one) for one in order.get("others", ())]
        self.timing = FrameTiming(**order["timing"])
        seed = int(order["seed"])
        self.counts = Counter({name: 0 for name in COUNTED})
        renderers = [Renderer(self.world, number) for number in range(len(self.world.cameras))]
        self.board = open_board(str(order["board"]))
        self.boot = 1 + seed % 200
        pins, trigger = pins_from(order.get("pins", {})), str(order.get("trigger", "none"))
        if trigger != "none":
            triggers = self.timing.triggered(trigger)
            pins = pins.triggering(trigger, triggers.width_us, triggers.delay_us)
        self.slides = self.world.turns
        pins = replace(pins, slides=self.slides)
        self.board.pull(*pins.pulled_up)
        self.board.power_on(self.boot)
        self.line = LossyLine(self.faults, seed)
        self.speed_mm_s = float(order["speed_mm_s"])
        self.pull_at: int | None = None
        is_native = order["board"] == "native"
        self.serial: Line = PtyLine() if is_native else TcpLine()
        self.patience_s = (2e-4, 1e-3) if is_native else (5e-4, 3e-3)  # a look at the emulator costs 0.2 ms
        self.lamp_tick: int | None = None  # when a lamp last went on or off
        self.stretched_ms = 0.0  # the world stood still for so long in all
        self.behind_ms = 0.0  # at worst, the world against the clock
        self.to_host = bytearray()
        self.publisher = _SamplePublisher()
        if not is_native:
            self.board.run_until(self.board.tick + EMULATOR_WARM_TICKS)
        start = self.board.tick
        clock = self.clock = HostClock(time.monotonic_ns() - start * TICK_NS, float(order["drift_ppm"]))
        self.sensor = sensor_of(
            self.world, self.timing, self.faults, seed=seed, clock=clock, start_tick=start, pins=pins, trigger=trigger
        )
        self.sensors = HeadSensors(self.world, self.sensor.cable, clock, self.faults, start_tick=start, seed=seed)
        threads = max(1, int(order["threads"]) // len(renderers))
        self.cameras = []
        for number, renderer in enumerate(renderers):
            faults = others[number - 1] if 0 < number <= len(others) else self.faults
            driver = Driver(faults, self.timing, seed, start_tick=start, camera=number)
            self.cameras.append(_TwinCamera(number, renderer, driver, self.timing, self.counts, threads))
        self.unplugged_until = 0  # world tick; until then the serial line is
        self.happenings = self._placed()

    def run(self) -> None:
        """Until stdin ends."""
        self._keep_time()
        cameras = [camera.server.address for camera in self.cameras]
        addresses = {"port": self.serial.url, "cameras": cameras, "sensors": self.publisher.address}
        sys.stdout.write(json.dumps(addresses) + "\n")
        sys.stdout.flush()
        os.set_blocking(sys.stdin.fileno(), False)
        asked = b""
        busy_until = 0.0
        while True:
            # while the host talks, answer soon; else a tenth of a frame will do
            patience = self.patience_s[0 if time.monotonic() < busy_until else 1]
            waitables = [*self.serial.waitables(), sys.stdin]
            for camera in self.cameras:
                waitables += [*camera.server.waitables(), camera.drawing.wake]
            readable, _, _ = select.select(waitables, [], [], patience)
            self.advance()
            if self.listen():
                busy_until = time.monotonic() + 3e-3
            if sys.stdin in readable:
                more = os.read(sys.stdin.fileno(), MESSAGE_MAX)
                if not more:
                    return
                *questions, asked = (asked + more).split(b"\n")
                for question in questions:
                    sys.stdout.write(json.dumps(self._answer(json.loads(question))) + "\n")
                    sys.stdout.flush()
            for camera in self.cameras:
                camera.server.serve(readable)
            if all(camera.server.streaming for camera in self.cameras) and self.speed_mm_s and not self.counts["pulls"]:
                self.counts["pulls"] += 1
                self.pull_at = self.clock.tick(time.monotonic_ns()) + round(SETTLE_S / TICK_S)
            for camera in self.cameras:
                camera.drawn += camera.drawing.finished()
                while camera.drawn and camera.drawn[0].frame.due_tick <= self.board.tick:
                    self._deliver(camera, camera.drawn.popleft())

    def listen(self) -> bool:
        """What the host has sent, to the controller: after it was sent by the world's clock too, or the controller
        would stamp what it had not got yet, and the host take its clock to have jumped.
        """
        heard = self.serial.read()
        if heard:
            self.advance()
            if self.board.tick >= self.unplugged_until:
                self.board.serial_write(heard)
        return bool(heard)

    def close(self) -> None:
        for camera in self.cameras:
            camera.drawing.close()
            camera.server.close()
        self.publisher.close()
        self.serial.close()
        self.board.close()

    # ---- time ----
    def _keep_time(self) -> None:
        """A real head does not wait for this machine's processor. Where the system allows it neither does this one; its
        pictures do.
        """
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(LEVEL))
            if isinstance(self.board, EmulatedBoard):
                self.board.hurry()

    def _placed(self) -> list[tuple[int, str, float]]:
        """What the faults have in store: world tick, what, how much; in order."""
        faults = self.faults
        named: list[tuple[int, str, float]] = [(frame, "resets", 0.0) for frame in faults.resets]
        named += [(frame, "power_losses", 0.0) for frame in faults.power_losses]
        named += [(frame, "disconnects", ms) for frame, ms in faults.disconnects]
        into = round(self.timing.period_us * TICKS_PER_US * 0.4)
        return sorted((self.sensor.edge(frame) + into, what, much) for frame, what, much in named)

    def _happens(self, what: str, much: float) -> None:
        self.counts[what] += 1
        if what == "disconnects":
            self.unplugged_until = self.board.tick + round(much * 1e-3 / TICK_S)
            self.line.unplug()
            return
        if what == "resets":
            self.boot = self.boot % 255 + 1
        self.board.power_on(self.boot, BootCause.WATCHDOG if what == "resets" else BootCause.POWER_ON)

    def advance(self) -> None:
        """Bring the firmware's world to now."""
        now_ns = time.monotonic_ns()
        now = self.clock.tick(now_ns)
        if (late_s := (now - self.board.tick) * TICK_S - LATE_S) > 0.0:
            self.stretched_ms += late_s * 1e3
            self.clock.stretch(round(late_s * 1e9))
            now = self.clock.tick(now_ns)
        while self.happenings and self.happenings[0][0] <= now:
            tick, what, much = self.happenings.pop(0)
            self._run_to(tick)
            self._happens(what, much)
        self._run_to(now)
        self.behind_ms = max(self.behind_ms, (self.clock.tick(time.monotonic_ns()) - now) * 1e3 * TICK_S)
        if self.pull_at is not None and now >= self.pull_at:
            self.sensor.pull(now + 1, self.speed_mm_s)
            self.pull_at = None
        data = self.board.serial_read()
        self.to_host += self.line.carry(data if now >= self.unplugged_until else b"")
        if self.to_host:
            del self.to_host[: self.serial.write(bytes(self.to_host))]
            if len(self.to_host) > 65536:  # nobody reads: a real line would have lost it too
                self.counts["serial_overflow"] += len(self.to_host)
                self.to_host.clear()

    def _run_to(self, tick: int) -> None:
        for at, pin, level in self.sensor.stimuli(tick):
            self.board.input(max(at, self.board.tick), pin, level)
        self.board.run_until(tick)
        pins = self.board.pins()
        lamps = pins["tick"][np.isin(pins["pin"], (*SLIDE_PINS, PIN_LED))]
        if len(lamps):
            self.lamp_tick = int(lamps[-1])
        for sample in self.sensors.samples(tick, pins):
            self.counts["samples"] += 1
            self.publisher.send(sample)
        for exposure in self.sensor.exposures(tick, pins):
            self.counts["frames"] += 1
            for camera in self.cameras:
                self._order(camera, exposure)

    # ---- frames ----
    def _order(self, camera: _TwinCamera, exposure: Exposure) -> None:
        """Have a frame drawn, or drop it as a driver without a free buffer does."""
        frame = camera.driver.take(exposure)
        camera.server.plug(not camera.driver.absent(int(exposure.sequence)))
        if not camera.server.streaming:
            return
        if frame is None:
            self.counts["dropped_on_purpose"] += 1
        elif (slot := camera.server.take()) is None:
            self.counts["driver_dropped_no_buffer"] += 1
        elif not camera.drawing.order(DrawingJob(slot, camera.server.generation, frame)):
            camera.server.give_back(slot)
            self.counts["driver_dropped_too_slow"] += 1

    def _deliver(self, camera: _TwinCamera, job: DrawingJob) -> None:
        self.counts["rendered"] += 1
        metadata = {
            "SensorTimestamp": job.frame.timestamp_ns,
            "FrameSequence": job.frame.sequence,
            "ExposureTime": round(self.timing.exposure_us),
            "FrameDuration": round(self.timing.period_us),
        }
        camera.server.deliver(job.slot, job.generation, metadata)

    def _answer(self, question: Mapping[str, Any]) -> dict[str, Any]:
        now = self.clock.tick(time.monotonic_ns())
        match question.get("do"):
            case "pull":
                self.speed_mm_s = float(question["speed_mm_s"])
                self.pull_at = now if math.isfinite(self.speed_mm_s) else None
                self.counts["pulls"] += 1
                return {}
            case "unplug":
                last = int(self.counts["frames"])
                driver = self.cameras[int(question["camera"])].driver
                driver.unplug(last + 1, round(float(question["seconds"]) * self.timing.fps))
                return {}
            case "silence":
                try:
                    self.sensors.silence(question["sensor"], time.monotonic_ns(), float(question["seconds"]))
                except AnnulusError as error:
                    return {"refused": str(error)}
                return {}
        last_lit_s = None if self.lamp_tick is None else (now - self.lamp_tick) * TICK_S
        lamps = (*(("projector", pin) for pin in SLIDE_PINS[: self.slides]), ("led", PIN_LED))
        on = [name for name, pin in lamps if self.sensor.is_lit(pin, self.board.level(pin))]
        return {
            **self.counts,
            "driver": dict(self.cameras[0].driver.counts),
            "drivers": [dict(camera.driver.counts) for camera in self.cameras],
            "events_lost": self.line.events_lost,
            "bytes_flipped": self.line.bytes_flipped,
            "z_mm": self.sensor.cable.z_mm(now),
            "lamps_on": on,
            "dark_s": 0.0 if on else last_lit_s,
            "behind_ms": self.behind_ms,
            "stretched_ms": self.stretched_ms,
        }
