"""When a page shows a picture whose label was published, with the cloud beside it: in Debian's chromium.

The daemon's pictures have a bar that says their number. The page is asked in every animation frame how long the bar is
on its canvas, and when that frame was handed over; a viewer at the daemon knows when which label was published. The
clocks are one machine's.
"""

import os
import shutil
import statistics
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import zmq

from annulus_pipe.stream.publish import parse
from tools.bench.speed.viewers import BAR_STEP_PX, PICTURES, Console, cpu_s
from tools.bench.table import Row

ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-precise-memory-info",
)
WIDTH, HEIGHT = 1400, 900
SECONDS = 20.0
PIXEL_MS = 100.0  # 95 of 100 labels
POINTS = 5_000_000
FILLED = 0.97  # of them: the page thins what it holds when it is full
FILL_S = 150.0
LED, PROJECTOR = "led", "projector"

WATCH = f"""
  window.seen = [];
  const canvases = [...document.querySelectorAll('.picture canvas')];
  const last = canvases.map(() => -1);
  const channel = new MessageChannel();
  let fresh = [];
  channel.port1.onmessage = () => {{
    const now = performance.timeOrigin + performance.now();
    for (const one of fresh) window.seen.push([one[0], one[1], now]);
    fresh = [];
  }};
  const look = () => {{
    canvases.forEach((canvas, which) => {{
      const line = canvas.getContext('2d').getImageData(0, 8, canvas.width, 1).data;
      let end = 0;
      while (end < canvas.width && line[4 * end] > 128) end += 1;
      const number = Math.round(end / {BAR_STEP_PX}) - 1;
      if (number >= 0 && number !== last[which]) fresh.push([which, number]);
      last[which] = number;
    }});
    if (fresh.length) channel.port2.postMessage(0);
    requestAnimationFrame(look);
  }};
  requestAnimationFrame(look);
"""
RENDERER = """() => {
  const gl = document.createElement('canvas').getContext('webgl2');
  if (!gl) return 'no WebGL';
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  return String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
}"""


@contextmanager
def chromium_at(url: str) -> Iterator[Any]:
    """A tab of Debian's chromium with the console's page, once it is said to be live."""
    path = shutil.which("chromium")
    if path is None:
        raise RuntimeError("needs Debian's chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        try:
            tab = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            tab.goto(url)
            tab.wait_for_function("() => window.annulus?.stats?.pictures > 0", timeout=60_000)
            yield tab
        finally:
            browser.close()


class Labels:
    """When which label was published, as a viewer at the daemon hears: Unix ms by index."""

    def __init__(self, address: str) -> None:
        self.at_ms: dict[int, float] = {}
        self.lamp: dict[int, str] = {}
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.subscribe(b"label")
        self._socket.connect(address)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Labels":
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        self._context.destroy(linger=0)

    def _listen(self) -> None:
        ahead_ms = 1e3 * time.time() - 1e-6 * time.monotonic_ns()
        while not self._ended.is_set():
            if self._socket.poll(100):
                body = parse(self._socket.recv_multipart())[2]
                self.at_ms[body["index"]] = 1e-6 * body["timestamp_ns"] + ahead_ms
                self.lamp[body["index"]] = body["label"]

    def delays(self, seen: list[tuple[int, int, float]], which: int, lamp: str) -> list[float]:
        """ms, of every picture of that lamp that a canvas came to show: from the newest label of that number."""
        of_number: dict[int, list[float]] = {}
        for index, at in self.at_ms.items():
            if self.lamp[index] == lamp:
                of_number.setdefault(index % PICTURES, []).append(at)
        out = []
        for canvas, number, shown in seen:
            before = [at for at in of_number.get(number, ()) if at <= shown]
            if canvas == which and before:
                out.append(shown - max(before))
        return out


def rows(console: Console) -> list[Row]:
    with chromium_at(console.url) as tab, Labels(console.publish) as labels:
        renderer = tab.evaluate(RENDERER)
        tab.evaluate(f"() => {{ {WATCH} }}")
        began = time.monotonic()
        time.sleep(3.0)
        out = [_shown(tab, labels, "a cloud of", renderer, console)]
        out += _filled(tab, began)
        out.append(_shown(tab, labels, "a full cloud,", renderer, console))
        return out


def _shown(tab: Any, labels: Labels, said: str, renderer: str, console: Console) -> Row:
    before, began = cpu_s(console.pid), time.monotonic()
    tab.evaluate("() => { window.seen.splice(0); window.annulus.stats.latencyMs.splice(0); }")
    drawn = tab.evaluate("() => window.annulus.stats.drawn")
    pictures = tab.evaluate("() => window.annulus.stats.pictures")
    tab.wait_for_timeout(1e3 * SECONDS)
    took = time.monotonic() - began
    stats = tab.evaluate("() => ({...window.annulus.stats})")
    seen = [(one[0], one[1], one[2]) for one in tab.evaluate("() => window.seen.splice(0)")]
    delays = labels.delays(seen, 0, PROJECTOR) + labels.delays(seen, 1, LED)
    if len(delays) < 20:
        return Row(
            "published to pixel", "-", f"p95 <= {PIXEL_MS:g} ms", f"only {len(delays)} pictures were seen", False
        )
    cuts = statistics.quantiles(delays, n=100)
    own = statistics.quantiles(stats["latencyMs"], n=20)[18] if len(stats["latencyMs"]) > 20 else 0.0
    cpu = 100 * (cpu_s(console.pid) - before) / took
    text = (
        f"p50 {cuts[49]:.0f}, p95 {cuts[94]:.0f}, p99 {cuts[98]:.0f} ms of {len(delays)} pictures, "
        f"{len(delays) / took:.1f} updates a second seen, {(stats['pictures'] - pictures) / took:.1f} drawn; by the "
        f"page's own count p95 {own:.0f} ms; "
        f"cloud drawn {(stats['drawn'] - drawn) / took:.1f} times a second by {renderer}; console {cpu:.1f} %, load "
        f"{os.getloadavg()[0]:.1f}"
    )
    points = stats["points"]
    name = f"label published to pixel changed, {said} {points / 1e6:.1f} million points"
    return Row(name, "-", f"p95 <= {PIXEL_MS:g} ms", text, cuts[94] <= PIXEL_MS)


def _filled(tab: Any, began: float) -> list[Row]:
    end = time.monotonic() + FILL_S
    most = 0
    while most < FILLED * POINTS and time.monotonic() < end:
        tab.wait_for_timeout(500)
        most = tab.evaluate("() => window.annulus.stats.pointsMost ?? window.annulus.stats.points")
    drawn, since = tab.evaluate("() => window.annulus.stats.drawn"), time.monotonic()
    tab.wait_for_timeout(5000)
    rate = (tab.evaluate("() => window.annulus.stats.drawn") - drawn) / (time.monotonic() - since)
    held = tab.evaluate("() => window.annulus.stats.points")
    text = (
        f"{most / 1e6:.2f} million after {since - began:.0f} s, {held / 1e6:.2f} held 5 s later; {rate:.1f} slices "
        "a second"
    )
    memory = f"heap {heap_mb(tab):.0f} MB, the page's process {renderer_mb():.0f} MB of its own"
    return [
        Row("points in the cloud", "-", f"{POINTS / 1e6:g} million", text, most >= FILLED * POINTS),
        Row("memory of the page then", "-", "-", memory),
    ]


def heap_mb(tab: Any) -> float:
    """JavaScript's heap after a collection, and what its arrays hold."""
    session = tab.context.new_cdp_session(tab)
    try:
        session.send("HeapProfiler.enable")
        session.send("HeapProfiler.collectGarbage")
        used = session.send("Runtime.getHeapUsage")
        return float(used["usedSize"] + used.get("backingStorageSize", 0.0)) / 1e6
    finally:
        session.detach()


def renderer_mb() -> float:
    """Own memory of the largest renderer process below this one."""
    found, waiting = 0.0, [os.getpid()]
    while waiting:
        pid = waiting.pop()
        with suppress(OSError):
            for task in Path(f"/proc/{pid}/task").iterdir():
                waiting += [int(one) for one in (task / "children").read_text().split()]
            if b"--type=renderer" in Path(f"/proc/{pid}/cmdline").read_bytes():
                lines = Path(f"/proc/{pid}/status").read_text().splitlines()
                found = max(found, next(int(line.split()[1]) / 1e3 for line in lines if line.startswith("RssAnon")))
    return found
