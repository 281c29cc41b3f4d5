"""What a console and its viewers can do to a scan: nothing. A real daemon before the twin's head, a console behind a
network that can be cut, ten viewers of which one never reads.

    python -m tools.bench.speed.console_faults       the long form: a cut of 60 s
"""

import os
import signal
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from annulus_pipe.record.recording import open_recording
from annulus_pipe.twin.worlds import demo_world
from tools.bench.speed.at_work import Ear, at_work, recordings
from tools.bench.speed.live import children_of
from tools.bench.speed.viewers import child, cpu_s, looked, serving
from tools.bench.table import Row

FPS = 12.5
WORLD = demo_world(travel_mm=330.0).scaled(416)
VIEWERS = 9  # and one that never reads
CALM, LOOKED_AT, SUSPENDED, CUT, KILLED, AFTER = (
    "no console",
    "ten viewers, one never reads",
    "viewers suspended",
    "network cut",
    "console killed, another one",
    "no console again",
)
SAME_PERCENT, SAME_SHARE = 2.0, 0.35  # of a core: how far two measures of one thing lie apart on a shared machine
UNKNOWN_MORE = 0.01  # of frames: the twin too is late with a flash where the machine is too busy
SAME_MS = 8.0  # of a turn, in the median

NOTE = (
    f"{WORLD.camera.width} pixels' width at {FPS:g} frames a second. Every frame's label is compared with what is in "
    "its picture, and what a viewer at the daemon heard with what was recorded."
)


@dataclass(slots=True)
class Phase:
    """What the daemon did meanwhile."""

    seconds: float = 0.0
    daemon_percent: float = 0.0  # of a core: the process that labels
    children_percent: float = 0.0  # .. all others of it: camera, recorder, publisher, workers
    turn_ms: float = 0.0  # median of the longest turn of each second
    frames: Counter[str] = field(default_factory=Counter)  # by label


@dataclass(slots=True)
class Outcome:
    phases: dict[str, Phase] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    recorded: int = 0
    seen_again: Mapping[str, Any] = field(default_factory=dict)  # by a viewer of the second console


class Wire:
    """Between console and daemon: a TCP connection that can be cut, as a cable is: nobody is told."""

    def __init__(self, port: int) -> None:
        self._to = port
        self._open = threading.Event()
        self._open.set()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listening.getsockname()[1])
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        self._open.clear()

    def mend(self) -> None:
        self._open.set()

    def close(self) -> None:
        self.mend()
        self._listening.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listening.accept()
                far = socket.create_connection(("127.0.0.1", self._to))
                for one, other in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=(one, other), daemon=True).start()

    def _carry(self, one: socket.socket, other: socket.socket) -> None:
        with suppress(OSError):
            while data := one.recv(1 << 16):
                self._open.wait()
                other.sendall(data)
        for end in (one, other):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


def struck(calm_s: float, suspended_s: float, cut_s: float) -> Outcome:
    """One scan in which all of it happens, one after the other."""
    outcome = Outcome()
    with at_work(WORLD, FPS, judge=False) as work:
        ear = work.ear

        @contextmanager
        def phase(name: str) -> Iterator[None]:
            one = outcome.phases[name] = Phase()
            ear.counted, ear.turns, began = one.frames, [], time.monotonic()
            before = _cpu(work.pid)
            yield
            one.seconds = time.monotonic() - began
            ear.counted = None
            own, others = (100.0 * (b - a) / one.seconds for a, b in zip(before, _cpu(work.pid), strict=True))
            one.daemon_percent, one.children_percent = own, others
            one.turn_ms = statistics.median(ear.turns[1:] or [0.0])

        with phase(CALM):
            time.sleep(calm_s)
        wires = [Wire(int(address.rpartition(":")[2])) for address in work.both.split(",")]
        try:
            _looked_at(
                ",".join(f"tcp://127.0.0.1:{wire.port}" for wire in wires),
                wires,
                phase,
                outcome,
                (calm_s, suspended_s, cut_s),
            )
        finally:
            for wire in wires:
                wire.close()
        with phase(AFTER):
            time.sleep(calm_s)
        work.end()
        outcome.recorded, outcome.problems = work.recorded, outcome.problems + work.problems
        _compare(outcome, ear, work.out / "scans")
    return outcome


def _looked_at(
    through: str, wires: list[Wire], phase: Any, outcome: Outcome, lasts_s: tuple[float, float, float]
) -> None:
    calm_s, suspended_s, cut_s = lasts_s
    with ExitStack() as stack:
        pid, url = stack.enter_context(serving(through))
        python = [sys.executable, "-m", "tools.bench.speed.viewers"]
        readers = stack.enter_context(child([*python, "look", url, str(VIEWERS), "3600"], stderr=subprocess.DEVNULL))
        stack.enter_context(child([*python, "stare", url], stderr=subprocess.DEVNULL))
        time.sleep(2.0)
        with phase(LOOKED_AT):
            time.sleep(calm_s)
        with phase(SUSPENDED):
            readers.send_signal(signal.SIGSTOP)
            time.sleep(suspended_s)
            readers.send_signal(signal.SIGCONT)
        with phase(CUT):
            for wire in wires:
                wire.cut()
            time.sleep(cut_s)
            for wire in wires:
                wire.mend()
        again = looked(url, 1, 2.0)["a_second"]
        if again["status"] < 1.0:
            outcome.problems.append(f"after the cut a viewer has {again}")
        with phase(KILLED):
            os.kill(pid, signal.SIGKILL)
            time.sleep(1.0)
            with serving(through) as (_, other):
                outcome.seen_again = looked(other, 1, max(2.0, calm_s / 2))["a_second"]


def _compare(outcome: Outcome, ear: Ear, folder: Path) -> None:
    """Labels heard, labels recorded, pictures: frame by frame."""
    problems = outcome.problems
    (path,) = recordings(folder)
    recording = open_recording(path)
    recorded = {frame.index: recording.label(frame).get("label") for frame in recording.frames}
    heard = {index: body["label"] for index, body in ear.labels.items()}
    first = ear.begin + 1
    last = max(recorded)
    missing = [index for index in range(first, last + 1) if index not in recorded]
    if missing:
        problems.append(f"not recorded: {len(missing)} frames, first {missing[:5]}")
    other = [index for index in range(first, last + 1) if heard.get(index) != recorded.get(index)]
    if other:
        problems.append(f"heard and recorded differ in {len(other)} frames, first {other[:5]}")
    calm, looked_at = Counter[str](), Counter[str]()
    for name, phase in outcome.phases.items():
        (calm if name in (CALM, AFTER) else looked_at).update(phase.frames)
    if _unknown(looked_at) > _unknown(calm) + UNKNOWN_MORE:
        problems.append(f"without a label: {_unknown(looked_at):.1%} of frames, {_unknown(calm):.1%} without a console")


def _unknown(frames: Counter[str]) -> float:
    return frames["unknown"] / max(1, frames.total())


def unlike(outcome: Outcome) -> list[str]:
    """Phases in which the daemon did more than without a console."""
    calm = [outcome.phases[CALM], outcome.phases[AFTER]]
    most = max(one.daemon_percent for one in calm)
    turn = max(one.turn_ms for one in calm)
    out = []
    for name, one in outcome.phases.items():
        if one.daemon_percent > most + max(SAME_PERCENT, SAME_SHARE * most):
            out.append(f"{name}: the daemon took {one.daemon_percent:.1f} % of a core, {most:.1f} % without")
        if one.turn_ms > turn + SAME_MS:
            out.append(f"{name}: a turn took {one.turn_ms:.1f} ms, {turn:.1f} ms without")
    return out


def rows(calm_s: float = 20.0, suspended_s: float = 30.0, cut_s: float = 60.0) -> list[Row]:
    outcome = struck(calm_s, suspended_s, cut_s)
    apart = unlike(outcome)
    out = []
    for name, one in outcome.phases.items():
        text = (
            f"daemon {one.daemon_percent:.1f} %, its children {one.children_percent:.1f} % of a core, turn "
            f"{one.turn_ms:.1f} ms; {', '.join(f'{n} {label}' for label, n in sorted(one.frames.items()))}"
        )
        looked_at = name not in (CALM, AFTER)
        met = not any(line.startswith(name) for line in apart) if looked_at else None
        out.append(Row(f"{name}, {one.seconds:.0f} s", "-", "as without" if looked_at else "-", text, met))
    fine = f"all of {outcome.recorded} frames recorded; labels heard, recorded and seen agree"
    told = "; ".join(outcome.problems) or fine
    out.append(Row("frame by frame", "-", "as without", f"{told}; load {os.getloadavg()[0]:.1f}", not outcome.problems))
    return out


def _cpu(pid: int) -> tuple[float, float]:
    others = 0.0
    for _, one in children_of(pid):
        with suppress(OSError):
            others += cpu_s(one)
    return cpu_s(pid), others


if __name__ == "__main__":
    for row in rows():
        print(f"{row.what}: {row.measured}", "" if row.ok is None else "met" if row.ok else "missed")
