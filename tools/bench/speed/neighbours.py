"""What others do to a scan: a second daemon that wants what the first has, lamps tuned against scans and operators, and
a day of starts, viewers and lines that come and go.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import zmq

from annulus_pipe.daemon.command import Operator
from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.daemon.state import State
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.head import HeadHandle, head_toml, start_head
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.speed.at_work import Work, at_work, until
from tools.bench.speed.blows import FPS, WORLD
from tools.bench.speed.live import children_of
from tools.bench.speed.viewers import ROOT, free_port, looked, rss_mb, serving
from tools.bench.table import Row

UP_S = 60.0
SECOND_S = 5.0  # of processor, all but all of them imports: then the second has ended; 2.2 are measured
SAME = ("everything", "port", "camera", "publish", "control", "recording folder")
HOLD_S = 7.0  # a tune that is killed is dark after its hold of 5 s, and what a busy machine adds
ANNULUS = [sys.executable, "-c", "from annulus_pipe.cli import main; main()"]
DAY_CYCLES = 288  # of a scan each five minutes
DAY_MB = 100.0  # that a process may grow in a day of them
LINE_EVERY, LINE_GONE_MS = 150, 400.0  # frames between two times that the controller's line is unplugged
OPERATOR = Operator("an operator's secret", "J. Doe")


# ---- a second daemon ----


def second(wanted: tuple[str, ...] = SAME) -> list[Row]:
    """While one daemon scans another is started that wants the same."""
    with at_work(WORLD, FPS) as work, start_head(WORLD, FPS, seed=7, speed_mm_s=0.0) as other:
        rows = [_second(work, other, what) for what in wanted]
    text = "; ".join(work.problems) or f"all of {work.recorded} frames recorded, none wrong"
    return [*rows, Row("the first daemon's scan", "-", "undisturbed", text, not work.problems)]


def _second(work: Work, other: HeadHandle, same: str) -> Row:
    folder = work.out / f"second-{same.replace(' ', '-')}"
    folder.mkdir()
    theirs = (work.out / "head.toml").read_text()
    toml = theirs if same == "everything" else _own(work, other, same)
    toml = toml.replace('file = "calibration.json"', f'file = "{work.out}/calibration.json"')
    toml = toml.replace('folder = "scans"', f'folder = "{work.out / "scans" if same == "everything" else "scans"}"')
    (folder / "head.toml").write_text(toml)
    calm, lines = work.disturbed(), len(work.daemon.heard())
    began, before = time.monotonic(), os.times()
    done = subprocess.Popen(
        [*ANNULUS, "daemon", "--config", str(folder / "head.toml")], stderr=subprocess.PIPE, text=True, cwd=ROOT
    )
    try:
        said = done.communicate(timeout=UP_S)[1].strip().splitlines()
    except subprocess.TimeoutExpired:
        done.send_signal(signal.SIGINT)
        said = done.communicate(timeout=UP_S)[1].strip().splitlines()
        said.append("it did not end by itself")
    took_s, cpu_s = time.monotonic() - began, os.times().children_user - before.children_user
    undisturbed, more = work.undisturbed(calm)
    told = [line for line in work.daemon.heard()[lines:] if not line.startswith(("scanning: ", "armed: ", "health "))]
    named = [line for line in said if line.startswith("annulus: ")]
    ok = done.returncode not in (0, -2) and len(named) == 1 and cpu_s <= SECOND_S and undisturbed and not told
    text = f'status {done.returncode} after {took_s:.1f} s ({cpu_s:.1f} s of processor): "{said[-1] if said else ""}"'
    text += f"; the first: {more} labels unknown" + (f", says {told}" if told else "")
    return Row(
        f"another daemon, the same {same}",
        "-",
        f"one line, in {SECOND_S:g} s of processor; the first goes on",
        text,
        ok,
    )


def _own(work: Work, other: HeadHandle, same: str) -> str:
    """Of a second head, with one thing of the first."""
    of = {"publish": work.daemon.publish, "control": work.control}
    publish, control = (of[one] if same == one else f"tcp://127.0.0.1:{free_port()}" for one in ("publish", "control"))
    toml = head_toml(other, WORLD, Path("calibration.json"))
    if same == "port":
        toml = toml.replace(other.port_url, work.head.port_url)
    if same == "camera":
        toml = toml.replace(other.camera_address, work.head.camera_address)
    folder = work.out / "scans" if same == "recording folder" else "scans"
    toml += f'\n[record]\nfolder = "{folder}"\nmin_free_gb = 0\n[publish]\naddress = "{publish}"\n'
    return toml + f'[control]\naddress = "{control}"\nautostart = false\n[workers]\ncount = 1\n'


# ---- tune ----


def tune() -> list[Row]:
    """`annulus tune` against scans, operators and another tune."""
    rows = []
    with at_work(WORLD, FPS, judge=False, speed_mm_s=0.0) as work:
        lamps = dict(work.client.about()["lamps"])

        def judged(what: str, asked: str, met: bool, text: str, dark: bool = True) -> None:
            wrong = _lit(work) if dark else []
            if (now := dict(work.client.about()["lamps"])) != lamps:
                wrong.append(f"lamps are {now}, were {lamps}")
            rows.append(Row(what, "-", asked, "; ".join([text, *wrong]), met and not wrong))

        calm = work.disturbed()
        with _tuning(work) as one:
            said = _ended(one)
        undisturbed, more = work.undisturbed(calm)
        judged(
            "tune while a scan is recorded",
            "refused in one line, the scan goes on",
            one.returncode == 1 and len(said) == 1 and undisturbed and work.client.state() is State.SCANNING,
            f'"{said[-1]}"; {more} labels unknown',
            dark=False,
        )
        work.client.stop()

        with _tuning(work) as one:
            _under_way(work)
            with _tuning(work) as two:
                refused = _ended(two)
            asked = _refusals(work)
            taken = _ended(one)
        judged(
            "two tunes at once",
            "the second is refused in one line, the first ends well",
            one.returncode == 0 and two.returncode == 1 and len(refused) == 1,
            f'"{refused[-1]}"; the first: status {one.returncode}, "{taken[-1]}"',
        )
        held = [name for name, answer in asked.items() if "commands" not in answer]
        judged(
            "an operator starts, sets lamps, holds, zeroes during tune",
            "all refused: tune commands",
            not held,
            f"done: {held}" if held else f'"{asked["start"]}"',
        )

        with _tuning(work) as one, ControlClient(work.control, who=OPERATOR) as operator:
            _under_way(work)
            operator.command(take=True)
            with suppress(AnnulusError):  # tune may have heard of it, and have ended its trial
                operator.stop()
            until(lambda: operator.state() is State.IDLE, "the trial does not end")
            operator.start()
            said = _ended(one)
            time.sleep(1.0)
            goes_on = work.client.state() in (State.ARMED, State.SCANNING)
            until(lambda: work.client.state() is State.SCANNING, "his scan has no labels")
            operator.stop()
            operator.release()
        judged(
            "an operator takes the command, ends the trial and scans",
            "tune ends in one line, his scan goes on",
            one.returncode == 1 and len(said) == 1 and goes_on,
            f'"{said[-1]}"; his scan goes on: {goes_on}',
        )

        with _tuning(work) as one:
            _under_way(work)
            one.kill()
            began = time.monotonic()
            until(lambda: work.client.state() is State.IDLE, "the trial does not end")
            took_s = time.monotonic() - began
        judged("tune killed", f"dark in {HOLD_S:g} s", took_s <= HOLD_S, f"dark after {took_s:.1f} s")
    return rows


def _lit(work: Work) -> list[str]:
    time.sleep(0.2)
    counters = work.head.counters()
    wrong = [f"lamp {lamp} is on" for lamp in counters["lamps_on"]]
    return wrong if wrong or counters["dark_s"] is None or counters["dark_s"] > 0.1 else ["lamps flash"]


@contextmanager
def _tuning(work: Work) -> Iterator["subprocess.Popen[str]"]:
    one = subprocess.Popen(
        [*ANNULUS, "tune", "--daemon", work.both, "--lamp", "led"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    try:
        yield one
    finally:
        one.kill()
        one.communicate()


def _ended(one: "subprocess.Popen[str]") -> list[str]:
    """What it said for people."""
    said = one.communicate(timeout=120.0)[1]
    return [line for line in said.replace("\r", "\n").splitlines() if line.startswith("annulus: ")] or ["nothing"]


def _under_way(work: Work) -> None:
    def tried() -> bool:
        telemetry = work.ear.telemetry
        return telemetry.get("trial") is not None and telemetry.get("state") == "scanning"

    until(tried, "no trial is under way")


def _refusals(work: Work) -> dict[str, str]:
    """What an operator is told."""
    out = {}
    with ControlClient(work.control, who=OPERATOR) as operator:
        wants: dict[str, Callable[[], Any]] = {
            "start": operator.start,
            "hold": operator.hold,
            "zero": operator.zero,
            "command": operator.command,
            "lamps": lambda: operator.lamps(commit=True, trial=True, led_width_us=900.0),
            "exposure": lambda: operator.lamps(commit=True, led_delay_us=100.0, led_width_us=100.0),
        }
        for name, ask in wants.items():
            try:
                out[name] = f"done: {ask()}"
            except AnnulusError as error:
                out[name] = str(error)
    return out


# ---- a day ----


def day(cycles: int = 24) -> list[Row]:
    """Scans begun and ended, viewers and consoles that come and go, camera and line unplugged and put back."""
    files: dict[str, list[int]] = {}
    mb: dict[str, list[float]] = {}
    unplugged = Faults(disconnects=tuple((frame, LINE_GONE_MS) for frame in range(200, 1 << 14, LINE_EVERY)))
    with at_work(WORLD, FPS, scan=False, faults=unplugged) as work, serving(work.both) as (console, url):
        for cycle in range(cycles):
            _cycle(work, url, cycle)
            processes = dict([*reversed(children_of(work.pid)), ("daemon", work.pid), ("console", console)])
            memory = work.memory_mb() | {"console": rss_mb(console)}
            for name in ("daemon", "console", "publisher", "worker", "surveyor", "camera"):
                if name in processes and name in memory:
                    files.setdefault(name, []).append(len(os.listdir(f"/proc/{processes[name]}/fd")))
                    mb.setdefault(name, []).append(memory[name])
        said = [line for line in work.daemon.heard() if "Traceback" in line or "internal" in line]
    rows = []
    warm = cycles // 4
    for name in files:
        first, last = max(files[name][warm : warm + 3]), min(files[name][-3:])
        slope = _slope(mb[name][warm:])
        grows = DAY_CYCLES * slope
        text = f"descriptors {first} -> {last}; {mb[name][-1]:.0f} MB, {grows:+.0f} MB a day"
        rows.append(
            Row(
                f"{name}, {cycles} cycles",
                "-",
                f"0 descriptors more, <= {DAY_MB:g} MB a day of {DAY_CYCLES}",
                text,
                last <= first and grows <= DAY_MB,
            )
        )
    return [*rows, Row("daemon's words", "-", "no internal error", "; ".join(said) or "none", not said)]


def _cycle(work: Work, url: str, cycle: int) -> None:
    work.client.start()
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    for _ in range(10):
        viewer = context.socket(zmq.SUB)
        viewer.subscribe(b"")
        viewer.connect(work.daemon.publish)
    eyes = Thread(target=lambda: _suppressed(looked, url, 2, 0.5))
    eyes.start()
    until(lambda: work.client.state() is State.SCANNING, "no scan")
    if cycle % 4 == 1:
        work.head.unplug(1.0)
        until(lambda: work.client.state() is State.FAULT, "the camera's absence is not seen", 20.0)
        until(lambda: work.client.state() in (State.ARMED, State.SCANNING), "the camera is not back", 20.0)
    if cycle % 4 == 2:
        work.client.pause()
        work.client.resume()
    if cycle % 4 == 3:
        work.client.mark("here", 90.0, b"\xff\xd8\xff" + bytes(1000))
    time.sleep(0.5)
    eyes.join()
    context.destroy(linger=0)
    work.client.stop()
    until(lambda: work.client.state() is State.IDLE, "the scan does not end")
    for path in (work.out / "scans").glob("*.mcap"):
        path.unlink()
    time.sleep(0.5)


def _suppressed(do: Callable[..., Any], *arguments: Any) -> None:
    with suppress(Exception):
        do(*arguments)


def _slope(mb: list[float]) -> float:
    """MB a cycle: the median of the slopes between any two looks that are far apart."""
    at, values = np.arange(len(mb)), np.array(mb)
    first, then = np.triu_indices(len(mb), max(1, len(mb) // 3))
    return float(np.median((values[then] - values[first]) / (at[then] - at[first])))
