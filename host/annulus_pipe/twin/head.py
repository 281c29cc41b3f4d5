"""The simulated head in real time, as its own process: a controller on a serial line, a camera and sensors on sockets.

    with start_head(demo_world(), fps=15.0) as head:
        client = Client(head.port_url)                  # as for a real controller
        camera = RemoteCamera(head.camera_address)      # as for a real camera
        sensors = RemoteSensors(head.sensor_address)    # as for real sensors

The head's process (`process`) runs the firmware in virtual time slaved to the monotonic clock, natively behind a pty or
as the shipped image on an emulated board behind TCP. It renders what the lamps lit; a frame that cannot be rendered in
time is the driver's drop: a hole in the sequence. Nothing of it has a name in the file system, nothing can be left
behind.
"""

import contextlib
import json
import math
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.hooks import merged
from annulus_pipe.link.pins import AS_WIRED, Pins, pins_list
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.profiles import load_faults
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World, demo_world, stereo_world
from annulus_pipe.vocabulary import AnnulusError

MM_PER_FRAME = 3.0
READOUT_MAX_US = 28_000.0  # of the sensor at 1664x1232
TRIGGERED_READOUT_US = 14_300.0  # of the Global Shutter camera
SLACK_US = 2_000.0  # exposure ends this much short of the frame period
FLASH_AFTER_OPENING_US = 500.0
_START_S = 300.0  # 2 on a quiet machine; one that is itself emulated takes minutes to import the twin
HEADS: Mapping[str, Callable[[int], World]] = {  # by seed; and those of wings
    "ring": demo_world,
    "stereo": stereo_world,
}


def head_timing(fps: float, trigger: str = "none") -> FrameTiming:
    """The twin camera's mode at a frame rate: exposure 2 ms short of the period, readout 28 ms or less. Of one that
    takes a trigger: half the period, and then the readout, 14.3 ms or less.
    """
    period = 1e6 / fps
    if trigger != "none":
        return FrameTiming(fps, 0.5 * period, min(TRIGGERED_READOUT_US, 0.4 * period))
    exposure = period - min(SLACK_US, 0.05 * period)
    return FrameTiming(fps, exposure, min(READOUT_MAX_US, 0.7 * period))


@dataclass
class HeadHandle:
    """A running head, seen from the process that started it. Close it, or use it as a context."""

    port_url: str
    camera_address: str  # of the first camera
    sensor_address: str  # ZeroMQ PUB: see sensors.remote
    timing: FrameTiming
    process: "subprocess.Popen[bytes]" = field(repr=False)
    _lines: "queue.SimpleQueue[bytes]" = field(repr=False)
    camera_addresses: tuple[str, ...] = ()  # of all
    pins: Pins = AS_WIRED
    trigger: str = "none"  # what the cameras take

    def counters(self) -> dict[str, Any]:
        """What the head counts: frames, rendered, driver drops by reason, events lost on purpose, z_mm, lamps_on,
        dark_s: for how long no lamp was on (None: none has been yet), behind_ms: how far the world fell behind the
        clock at worst, stretched_ms: for how long it stood still because this machine was too busy. A head that needs
        more than this machine has is no head to judge a host by: its clocks jump by what was stretched.
        """
        return cast(dict[str, Any], self._ask({"do": "counters"}))

    def pull(self, speed_mm_s: float) -> None:
        """Let the cable move at this speed from now on; 0 stops it."""
        self._ask({"do": "pull", "speed_mm_s": speed_mm_s})

    def unplug(self, seconds: float, camera: int = 0) -> None:
        """Let that camera not be there from the next frame on, for so long; its driver then counts from 0."""
        self._ask({"do": "unplug", "seconds": seconds, "camera": camera})

    def silence(self, sensor: str, seconds: float) -> None:
        """Let nothing be heard of this sensor ("imu", "supply") from now on, for so long."""
        self._ask({"do": "silence", "sensor": sensor, "seconds": seconds})

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
        if "refused" in answer:
            raise AnnulusError(f"twin head: {answer['refused']}")
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
    others: Sequence[Faults] = (),
    pins: Pins = AS_WIRED,
    trigger: str = "none",
) -> HeadHandle:
    """Start a head in its own process and wait until it can be talked to.

    fps : of the camera, which runs at once and for ever. timing : exposure and readout, by default `head_timing(fps)`.
    speed_mm_s : of the cable, which starts 2 s after the camera was first started; None: 3 mm a frame, 0: not before
    `pull`. drift_ppm : of the head's crystal against this machine's clock. threads : that render, by default one a
    core, two at most. board : native or emulated, the shipped image. others : what the drivers of further cameras do,
    where that is not what the first one's does.
    pins : how it is wired. trigger : what its cameras take, as in head.toml.

    Raises AnnulusError when the head does not come up, with the last thing it said.
    """
    mode = timing or head_timing(fps, trigger)
    order = {
        "world": world.to_dict(),
        "timing": asdict(mode),
        "faults": asdict(faults if isinstance(faults, Faults) else load_faults(faults)),
        "others": [asdict(one) for one in others],
        "seed": seed,
        "speed_mm_s": MM_PER_FRAME * fps if speed_mm_s is None else speed_mm_s,
        "drift_ppm": drift_ppm,
        "threads": threads or default_threads(),
        "board": board,
        "pins": asdict(pins),
        "trigger": trigger,
    }
    process = subprocess.Popen(
        [sys.executable, "-c", "from annulus_pipe.twin.process import main; main()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdin is not None and process.stdout is not None and process.stderr is not None
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    printed: list[bytes] = []
    listeners = [
        threading.Thread(target=_collect, args=(stream, keep), daemon=True)
        for stream, keep in ((process.stdout, lines.put), (process.stderr, printed.append))
    ]
    for listener in listeners:
        listener.start()
    try:
        process.stdin.write(json.dumps(order).encode() + b"\n")
        process.stdin.flush()
        up = json.loads(lines.get(timeout=_START_S))
        cameras = tuple(up["cameras"])
        return HeadHandle(up["port"], cameras[0], up["sensors"], mode, process, lines, cameras, pins, trigger)
    except BaseException as error:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1.0)  # what broke it is still being said
        process.kill()
        process.wait()
        if isinstance(error, queue.Empty | OSError | ValueError | KeyError):
            listeners[1].join(1.0)
            spoken = [line for line in printed if line.strip()]
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


PREAMBLE_FRAMES = 500  # between two optical preambles, as on a real head: 20 s at 25 fps, of which it has fewer


def head_toml(head: HeadHandle, world: World, calibration: Path | None = None) -> str:
    """The daemon's configuration for this head, flashes at the beginning of the window in which all rows expose.

    calibration : file with the head's calibration, where live profiles are wanted.
    """
    timing = flashes_in = head.timing
    triggered = ""
    if head.trigger != "none":
        flashes_in = timing.triggered(head.trigger).flashes_in
        triggered = f'\n        trigger = "{head.trigger}"'
    delay_us = math.ceil(flashes_in.opens_us + FLASH_AFTER_OPENING_US)
    turns = f"\nslides = {world.turns}" if world.turns > 1 else ""

    def sees(number: int) -> str:
        return f"\nslides = {list(world.sees(number))}" if world.sees(number) else ""

    section = "[[camera]]" if world.others else "[camera]"
    cameras = "".join(
        f"""
        {section}
        kind = "remote"
        device = "{address}"{sees(number)}
        width = {one.camera.width}
        height = {one.camera.height}
        fps = {timing.fps:g}
        exposure_us = {timing.exposure_us:.1f}
        readout_us = {timing.readout_us:.1f}{triggered}"""
        for number, (address, one) in enumerate(
            zip(head.camera_addresses or (head.camera_address,), world.cameras, strict=True)
        )
    )
    lines = f"""
        [controller]
        port = "{head.port_url}"
        inverted = {json.dumps(pins_list(head.pins.inverted))}{cameras}
        [lamps]
        ratio = 4{turns}
        projector_delay_us = {delay_us}
        projector_width_us = {world.projector.nominal_us:g}
        led_delay_us = {delay_us}
        led_width_us = {world.led.nominal_us:g}
        preamble_interval_s = {PREAMBLE_FRAMES / timing.fps:g}
        [odometer]
        mm_per_count = {world.mm_per_count:g}
        [[sensor]]
        kind = "remote"
        device = "{head.sensor_address}"
    """.split("\n")
    if calibration is not None:
        lines += ["[calibration]", f"file = {json.dumps(str(calibration))}"]
    return "".join(line.strip() + "\n" for line in lines if line.strip()).replace("\n[", "\n\n[")


def world_named(head: str, seed: int) -> World:
    """Of HEADS or the wings' worlds. AnnulusError for another."""
    heads = {**HEADS, **merged("worlds")}
    if head not in heads:
        raise AnnulusError(f"head {head!r}: expected one of {', '.join(heads)}")
    world: World = heads[head](seed)
    return world


def run_head(
    fps: float,
    seed: int,
    faults: Path | None,
    board: str,
    roll_deg: float,
    out: Path | None,
    head: str = "ring",
    buried_m: float | None = None,
    pins: Pins = AS_WIRED,
    trigger: str = "none",
) -> None:
    """A head, of HEADS or the wings' worlds, in its pipe until Ctrl-C, for a daemon or `annulus head` elsewhere.

    Prints the head.toml that finds it, or writes it into `out`, with the calibration and the truth beside it. The head
    rolls by `roll_deg` either way on its way through the pipe. buried_m : the pipe is so long and lies in a ground with
    sewers that it was drilled through, and the head has capacitive sectors.
    """
    world = replace(world_named(head, seed), roll_deg=roll_deg)
    if buried_m is not None:
        ground = merged("lights")["ground"].along(1000 * buried_m, seed)
        world = replace(world, travel_mm=1000 * buried_m, ground=ground)
    with start_head(world, fps, faults, seed=seed, board=board, pins=pins, trigger=trigger) as running:
        if out is None:
            print(head_toml(running, world), flush=True)
        else:
            try:
                out.mkdir(parents=True, exist_ok=True)
                (out / "calibration.json").write_text(json.dumps(world.calibration().to_dict(), indent=1) + "\n")
                (out / "truth.json").write_text(json.dumps(world.truth(), indent=1) + "\n")
                (out / "head.toml").write_text(head_toml(running, world, Path("calibration.json")))
            except OSError as error:
                raise AnnulusError(f"{out}: cannot be written ({error.strerror})") from None
            print(f"{out / 'head.toml'} is what `annulus daemon` wants", flush=True)
        print(f"# {running.timing}; Ctrl-C ends the head", file=sys.stderr, flush=True)
        told_ms = 0.0
        try:
            while running.process.poll() is None:
                time.sleep(0.2)
                if (stretched_ms := running.counters()["stretched_ms"]) > told_ms:
                    print(
                        f"# this machine is too busy: the head stood still for {stretched_ms:.0f} ms so far",
                        file=sys.stderr,
                    )
                    told_ms = stretched_ms + 1000.0
        except KeyboardInterrupt:
            return
    raise AnnulusError("twin head: ended by itself")


def sustainable_fps(world: World, threads: int | None = None, frames: int = 8) -> float:
    """Flashes of the projector a second that this machine renders now, each as every camera of the world sees it, on as
    many threads as the head would use.

    Measured over the world's whole travel. It leaves nothing for anybody else.
    """
    renderers = [Renderer(world, number) for number in range(len(world.cameras))]
    for renderer in renderers:
        renderer.render(world.pose(0.0), 0.0, 1.0)
    threads = threads or default_threads()
    stations = np.linspace(0.0, world.travel_mm, frames * threads)

    def work(mine: NDArray[np.float64]) -> None:
        for z in mine:
            for renderer in renderers:
                renderer.render(world.pose(float(z)), float(z), 1.0)

    crew = [threading.Thread(target=work, args=(stations[i::threads],)) for i in range(threads)]
    start = time.perf_counter()
    for thread in crew:
        thread.start()
    for thread in crew:
        thread.join()
    return len(stations) / (time.perf_counter() - start)
