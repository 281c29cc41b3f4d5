"""Many viewers, many frames, many cameras: what a scan does under the most that anybody asked of it.

python -m tools.bench.speed.crowd look ADDRESS N SECONDS     N viewers of labels; prints what they saw as JSON
python -m tools.bench.speed.crowd stare ADDRESS              one that asks for everything and never reads
"""

import json
import signal
import statistics
import subprocess
import sys
import time
from typing import Any

import zmq

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.stream.publish import parse
from tools.bench.speed.at_work import Work, at_work, spread_ms
from tools.bench.speed.live import plain_world
from tools.bench.speed.viewers import ROOT, UP_S, child, looked, serving
from tools.bench.table import Row

VIEWERS, BROWSERS = 100, 20
FPS, WIDTH = 25.0, 832
FAST_FPS, FAST_WIDTH = 60.0, 832
CAMERAS, CAMERAS_WIDTH, CAMERAS_FPS = 4, 416, 12.5
EXPOSED, READ = 0.9, 0.5  # of the time between two frames
P99_MS = 40.0  # of a label at each viewer: one frame, three times what is measured, on two cores that all share
LOUD_P99_MS = 60.0  # beside twenty browsers, whose console and readers are on the same two cores
SLOWED_MS = 20.0  # by which the p99 of others may rise when one stops reading
GROWN_MB = 5.0  # of the daemon and its publisher together, by viewers who come and go once more
UNKNOWN = 0.01  # share of frames: the twin is late with a flash, too, where the machine is busy


def viewers(seconds: float = 15.0, viewers: int = VIEWERS, browsers: int = BROWSERS) -> list[Row]:
    """A hundred viewers, then with one that never reads, then with twenty browsers besides."""
    rows, stare = [], [sys.executable, "-m", "tools.bench.speed.crowd", "stare"]
    with at_work(plain_world().scaled(WIDTH), FPS, copied=True, speed_mm_s=0.0) as work:
        calm = _seen(work, 1, seconds)
        many = _seen(work, viewers, seconds)
        with child([*stare, work.daemon.publish]):
            time.sleep(1.0)
            stalled = _seen(work, viewers, seconds)
            rest = _seen(work, 1, 3.0)
        before = work.memory_mb()
        with child([*stare, work.daemon.publish]):  # glibc keeps what the first of them took
            _seen(work, viewers, seconds / 2)
        after = work.memory_mb()
        with serving(work.both) as (_, url):
            eyes = subprocess.Popen(
                _looking(work.daemon.publish, viewers, seconds + 4.0), stdout=subprocess.PIPE, text=True, cwd=ROOT
            )
            shown = looked(url, browsers, seconds)
            loud = json.loads(eyes.communicate(timeout=seconds + UP_S)[0])
    grown = sum(after[name] - before[name] for name in ("daemon", "publisher"))
    whole, told = not work.problems, "; ".join(work.problems) or f"all of {work.recorded} frames recorded, none wrong"
    rows.append(_crowd(f"{viewers} viewers, beside one alone", many, P99_MS, f"alone {_late(calm)}"))
    slow = stalled["p99_ms"] <= max(P99_MS, many["p99_ms"] + SLOWED_MS)
    rows.append(_crowd(f"{viewers} viewers, one more never reads", stalled, P99_MS, f"one alone {_late(rest)}", slow))
    rows.append(
        _crowd(
            f"{viewers} viewers and {browsers} browsers",
            loud,
            LOUD_P99_MS,
            f"pictures at browsers p50 {shown['p50_ms']:.0f}, p99 {shown['p99_ms']:.0f} ms",
        )
    )
    rows.append(
        Row(
            "memory of daemon and publisher, as many come and go again",
            "-",
            f"<= {GROWN_MB:g} MB more",
            f"{grown:+.1f} MB ({', '.join(f'{n} {mb:.0f}' for n, mb in after.items())})",
            grown <= GROWN_MB,
        )
    )
    rows.append(Row("frames of that scan", "-", "0 lost before the disk, 0 labels wrong", told, whole))
    return rows


def sixty(seconds: float = 25.0) -> list[Row]:
    """A head at sixty frames a second."""
    period_us = 1e6 / FAST_FPS
    timing = FrameTiming(FAST_FPS, EXPOSED * period_us, READ * period_us)
    return _filmed(f"{FAST_FPS:g} frames a second", plain_world().scaled(FAST_WIDTH), FAST_FPS, timing, seconds)


def four(seconds: float = 25.0) -> list[Row]:
    """A head of four cameras on one frame-sync."""
    world = plain_world(CAMERAS).scaled(CAMERAS_WIDTH)
    return _filmed(f"{CAMERAS} cameras, {CAMERAS_FPS:g} frames a second each", world, CAMERAS_FPS, None, seconds)


def _filmed(what: str, world: Any, fps: float, timing: FrameTiming | None, seconds: float) -> list[Row]:
    with at_work(world, fps, timing=timing, copied=True, speed_mm_s=0.0, flash_us=0.15e6 / fps) as work:
        work.ear.late_ms.clear()
        spent, began = work.percents(), time.monotonic()
        time.sleep(seconds)
        late, took = list(work.ear.late_ms), time.monotonic() - began
        cpu = {name: 100.0 * (s - spent.get(name, 0.0)) / took for name, s in work.percents().items()}
    frames, unknown = len(work.ear.labels), work.ear.unknown
    text = "; ".join(work.problems) or f"all of {work.recorded} frames recorded, 0 wrong"
    share = ", ".join(f"{name} {percent:.0f} %" for name, percent in sorted(cpu.items()))
    text += f"; {unknown} of {frames} unknown; {world.camera.width} px; {share} of a core"
    ok = not work.problems and unknown <= UNKNOWN * frames
    p99 = statistics.quantiles(late, n=100)[98]
    return [
        Row(what, "-", f"0 lost before the disk, 0 wrong, unknown <= {UNKNOWN:.0%}", text, ok),
        Row(f"{what}: label at a viewer", "-", f"p99 <= {P99_MS:g} ms", spread_ms(late), p99 <= P99_MS),
    ]


def _crowd(what: str, seen: dict[str, Any], most_ms: float, more: str, ok: bool | None = None) -> Row:
    text = f"{_late(seen)}; holes {seen['holes']} of {seen['labels']}; {more}"
    met = seen["p99_ms"] <= most_ms if ok is None else ok
    return Row(what, "-", f"p99 <= {most_ms:g} ms, nobody misses a label", text, met and not seen["holes"])


def _late(seen: dict[str, Any]) -> str:
    return f"p50 {seen['p50_ms']:.1f}, p99 {seen['p99_ms']:.1f}, worst viewer's p99 {seen['worst_ms']:.1f} ms"


def _looking(address: str, count: int, seconds: float) -> list[str]:
    return [sys.executable, "-m", "tools.bench.speed.crowd", "look", address, str(count), f"{seconds:g}"]


def _seen(work: Work, count: int, seconds: float) -> dict[str, Any]:
    done = subprocess.run(
        _looking(work.daemon.publish, count, seconds),
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=seconds + UP_S,
        check=True,
    )
    return dict(json.loads(done.stdout))


def look(address: str, count: int, seconds: float) -> dict[str, Any]:
    """So many connections. holes : labels that one of them did not get, by their running numbers, all together."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    poller, late, numbers = zmq.Poller(), [list[float]() for _ in range(count)], [list[int]() for _ in range(count)]
    sockets = {}
    for number in range(count):
        socket = context.socket(zmq.SUB)
        for topic in (b"label", b"telemetry", b"event", b"state"):
            socket.subscribe(topic)
        socket.connect(address)
        poller.register(socket, zmq.POLLIN)
        sockets[socket] = number
    begin = time.monotonic() + 1.5  # until all are connected
    while (now := time.monotonic()) < begin + seconds:
        for socket, _ in poller.poll(100):
            while socket.poll(0):
                message, at_ns = socket.recv_multipart(), time.monotonic_ns()
                if message[0] == b"label" and now >= begin:
                    _, running, body, _ = parse(message)
                    numbers[sockets[socket]].append(running)
                    late[sockets[socket]].append((at_ns - body["arrived_ns"]) / 1e6)
    context.destroy(linger=0)
    cuts = statistics.quantiles([one for some in late for one in some], n=100)
    worst = max(statistics.quantiles(some, n=100)[98] for some in late)
    holes = sum(some[-1] - some[0] + 1 - len(some) for some in numbers)
    return {"p50_ms": cuts[49], "p99_ms": cuts[98], "worst_ms": worst, "holes": holes, "labels": sum(map(len, numbers))}


def stare(address: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, 1)
    socket.setsockopt(zmq.RCVBUF, 1 << 12)
    socket.subscribe(b"")
    socket.connect(address)
    while True:
        time.sleep(60.0)


if __name__ == "__main__":
    if sys.argv[1] == "stare":
        stare(sys.argv[2])
    print(json.dumps(look(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]))))
