"""A console at work for a benchmark, each part in a process of its own: a daemon that only talks
(tests/unit/console/fake_daemon.py), the console, and viewers on real WebSockets.

    python -m tools.bench.speed.viewers talk FPS       prints PUBLISH,CONTROL; with a second number so many times faster
    python -m tools.bench.speed.viewers look URL N S   N viewers for S seconds; prints what they saw as JSON
    python -m tools.bench.speed.viewers stare URL      one that wants everything and never reads
"""

import asyncio
import json
import os
import re
import signal
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tests/unit/console"))
PICTURES = 32  # that differ, so that who sees one knows which it was
BAR_PX = 24  # of the upper edge; its length says the picture's number
BAR_STEP_PX = 25
UP_S = 60.0
NICE = -18
STATUS, PICTURE, POINTS, WALL, ROWS, SLITS = range(1, 7)
KINDS = {STATUS: "status", PICTURE: "pictures", POINTS: "points", WALL: "wall", ROWS: "rows", SLITS: "slits"}


@dataclass(frozen=True, slots=True)
class Console:
    url: str  # with the slash at its end
    pid: int
    head: int  # pid of who talks
    publish: str  # where that one does


@contextmanager
def child(command: list[str], **how: Any) -> Iterator["subprocess.Popen[str]"]:
    """A process that is gone afterwards."""
    running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT, **how)
    try:
        yield running
    finally:
        with suppress(ProcessLookupError):
            running.send_signal(signal.SIGCONT)
            running.send_signal(signal.SIGINT)
        try:
            running.wait(10.0)
        except subprocess.TimeoutExpired:
            running.kill()
            running.wait()


def _told(running: "subprocess.Popen[str]", stream: Any, pattern: str) -> str:
    """The first thing it says that looks like this; the rest is read and thrown away, so that it never waits."""
    found: list[str] = []
    there = threading.Event()

    def read() -> None:
        for line in stream:
            if not found and (match := re.search(pattern, line)):
                found.append(match[0])
                there.set()
        there.set()

    threading.Thread(target=read, daemon=True).start()
    there.wait(UP_S)
    if not found:
        raise RuntimeError(f"{running.args}: did not come up")
    return found[0]


@contextmanager
def talking(fps: float, faster: float = 1.0) -> Iterator[tuple[int, str]]:
    """A daemon that only talks: its pid, and PUBLISH,CONTROL. faster : than the time it talks of."""
    with child([sys.executable, "-m", "tools.bench.speed.viewers", "talk", f"{fps:g}", f"{faster:g}"]) as head:
        yield head.pid, _told(head, head.stdout, r"tcp://\S+,tcp://\S+")


@contextmanager
def serving(daemon: str) -> Iterator[tuple[int, str]]:
    """A console of that daemon: its pid and address."""
    command = [sys.executable, "-c", "from annulus_pipe.cli import main; main()", "console"]
    command += ["--daemon", daemon, "--port", str(free_port())]
    with child(command, stderr=subprocess.STDOUT) as console:
        url = _told(console, console.stdout, r"https?://[\w.:\[\]]+/")
        end = time.monotonic() + UP_S
        while True:
            try:
                urllib.request.urlopen(f"{url}api/session", timeout=2.0).read()
                break
            except OSError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.05)
        yield console.pid, url


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@contextmanager
def console_at_work(fps: float = 25.0, faster: float = 1.0) -> Iterator[Console]:
    with talking(fps, faster) as (head, daemon), serving(daemon) as (pid, url):
        time.sleep(2.0)
        yield Console(url, pid, head, daemon.partition(",")[0])


@contextmanager
def foremost() -> Iterator[None]:
    """This process and all below it go before whatever else this machine does, where that is allowed: what is measured
    is not what the neighbours leave. Linux shares a core between sessions first, so those are raised too."""
    ended = threading.Event()

    def raise_all() -> None:
        known: set[str] = set()
        while not ended.wait(0.5):
            waiting = [os.getpid()]
            while waiting:
                pid = waiting.pop()
                with suppress(OSError):
                    for task in Path(f"/proc/{pid}/task").iterdir():
                        waiting += [int(one) for one in (task / "children").read_text().split()]
                        if task.name not in known:
                            known.add(task.name)
                            os.setpriority(os.PRIO_PROCESS, int(task.name), NICE)
                    Path(f"/proc/{pid}/autogroup").write_text(str(NICE))

    raising = threading.Thread(target=raise_all, daemon=True)
    raising.start()
    try:
        yield
    finally:
        ended.set()
        raising.join()


def session_of(url: str) -> tuple[str, str]:
    """Cookie and token of a new session."""
    with urllib.request.urlopen(f"{url}api/session", timeout=10.0) as answer:
        cookie = (answer.headers["Set-Cookie"] or "").partition(";")[0]
        return cookie, str(json.loads(answer.read())["token"])


def cpu_s(pid: int) -> float:
    """Of all its threads so far, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def rss_mb(pid: int) -> float:
    """What is its own."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1000.0 for line in lines if line.startswith("RssAnon"))


def looked(url: str, count: int, seconds: float) -> dict[str, Any]:
    """What so many viewers in another process saw; see `look`."""
    command = [sys.executable, "-m", "tools.bench.speed.viewers", "look", url, str(count), f"{seconds:g}"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=seconds + UP_S, check=True)
    return dict(json.loads(done.stdout))


async def look(url: str, count: int, seconds: float) -> dict[str, Any]:
    """Every message taken at once. latency_ms : of pictures, from published to here, all viewers together."""
    from websockets.asyncio.client import connect

    latency: list[float] = []
    seen: list[Counter[str]] = [Counter() for _ in range(count)]
    dropped = 0

    async def one(number: int) -> None:
        nonlocal dropped
        cookie, _ = await asyncio.to_thread(session_of, url)
        headers = {"Cookie": cookie, "Origin": url.rstrip("/")}
        address = url.replace("http", "ws", 1) + "ws"
        async with connect(address, additional_headers=headers, compression=None, max_size=1 << 24) as socket:
            await socket.send(json.dumps({"want": ["pictures", "points", "wall", "rows", "slits", "status"]}))
            begin = time.monotonic() + 1.0  # what waited for who comes late is not counted
            while (now := time.monotonic()) < begin + seconds:
                message = await asyncio.wait_for(socket.recv(), 10.0)
                now, unix = time.monotonic(), time.time()
                kind = message[0]
                if now < begin or not isinstance(message, bytes):
                    continue
                seen[number][KINDS.get(kind, "other")] += 1
                if kind == PICTURE:
                    latency.append(1e3 * (unix - struct.unpack_from("<d", message, 12)[0]))
                elif kind == STATUS and message[1:20].startswith(b'{"topic": "alive"') | (b'"alive"' in message[:40]):
                    dropped = max(dropped, int(json.loads(message[1:])["body"]["you"]["dropped"]))

    await asyncio.gather(*(one(number) for number in range(count)))
    cuts = statistics.quantiles(latency, n=100) if len(latency) > 10 else [0.0] * 99
    rates = {kind: min(one[kind] for one in seen) / seconds for kind in KINDS.values()}
    return {
        "p50_ms": cuts[49],
        "p95_ms": cuts[94],
        "p99_ms": cuts[98],
        "max_ms": max(latency, default=0.0),
        "a_second": rates,
        "dropped": dropped,
        "pictures": len(latency),
    }


def stare(url: str) -> None:
    """Asks for everything, takes in a few messages that nobody looks at, and no more."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    cookie, _ = session_of(url)
    headers = {"Cookie": cookie, "Origin": url.rstrip("/")}
    address = url.replace("http", "ws", 1) + "ws"
    with suppress(ConnectionClosed), connect(address, additional_headers=headers, compression=None, max_queue=1) as one:
        print("staring", flush=True)
        while True:
            time.sleep(60.0)
            assert one is not None


def numbered(head: Any) -> None:
    """Its pictures differ by their number from 0 to PICTURES - 1, which a bar says."""
    import cv2
    import numpy as np

    class Turning(list[bytes]):
        def __getitem__(self, _: Any) -> Any:
            return super().__getitem__(head.index % PICTURES)

    for lamp, some in head._jpegs.items():
        plain = cv2.imdecode(np.frombuffer(some[0], np.uint8), cv2.IMREAD_COLOR)
        made = Turning()
        for number in range(PICTURES):
            plain[:BAR_PX] = 0
            plain[:BAR_PX, : BAR_STEP_PX * (number + 1)] = 255
            made.append(bytes(cv2.imencode(".jpg", plain, [cv2.IMWRITE_JPEG_QUALITY, 80])[1]))
        head._jpegs[lamp] = made


def hurried(head: Any, faster: float) -> None:
    """Hours in minutes: all that it says in a second of its own, in the same order, `faster` times a second. Profiles
    are some of the first, moved on along the pipe."""
    import fake_daemon
    import numpy as np

    some = [fake_daemon.profile(k, 0.0) for k in range(20)]
    points = [np.frombuffer(one["points"], "<f4").reshape(-1, 3) for one in some]

    def profile(index: int, z_mm: float) -> dict[str, Any]:
        which = index % len(some)
        at = points[which] + np.array([0.0, 0.0, z_mm], "<f4")
        return {**some[which], "frame": index, "z_mm": z_mm, "points": at.astype("<f4").tobytes()}

    fake_daemon.profile = profile
    fps = int(head.fps)

    def run() -> None:
        due = time.monotonic()
        while not head._ended.is_set():
            head._listen()
            head._answer()
            head._frame()
            if head.index % (fps // 2) == 0:
                head._wall()
            if head.index % fps == 0:
                head._second(time.monotonic())
            due = max(due + 1.0 / (fps * faster), time.monotonic() - 0.05)
            time.sleep(max(0.0, due - time.monotonic()))

    head._run = run
    head._thread = threading.Thread(target=run, daemon=True)


def talk(fps: float, faster: float) -> None:
    from fake_daemon import FakeDaemon

    head = FakeDaemon(fps, scanning=True)
    numbered(head)
    if faster > 1.0:
        hurried(head, faster)
    with head:
        print(f"{head.publish},{head.control}", flush=True)
        signal.sigwait([signal.SIGINT, signal.SIGTERM])


def main(what: str, *given: str) -> None:
    if what == "talk":
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM])
        talk(float(given[0]), float(given[1]) if given[1:] else 1.0)
    elif what == "stare":
        stare(given[0])
    else:
        print(json.dumps(asyncio.run(look(given[0], int(given[1]), float(given[2])))))


if __name__ == "__main__":
    main(*sys.argv[1:])
