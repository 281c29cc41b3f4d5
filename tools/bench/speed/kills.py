"""Every process of a scan killed and stopped in turn, its recording's folder removed: how soon it goes on, and whether
the ledger of frames adds up.

    python -m tools.bench.speed.kills [TIMES] [LOAD]     TIMES a process and signal; LOAD: processes that spin

The head is the twin's, at a quarter of its size; the blows fall into one scan each.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median

from annulus.daemon.account import ScanReport
from annulus.daemon.config import SocketConfig
from annulus.daemon.session import Session
from annulus.demo import demo_config
from annulus.record.calibration_file import save_calibration
from annulus.twin.head import HeadHandle, head_toml, start_head
from annulus.twin.worlds import demo_world
from tools.bench.speed.latency import spinning
from tools.bench.table import Row

TIMES, LOAD = 20, 3
FPS = 8.0
SOON_S, PAUSE_S, GIVE_UP_S = 2.0, 0.5, 30.0
DARK_S = 0.5 + 0.25  # the host timeout, and a period of edges at 4 Hz and more
ROLES = ("recorder", "recorder spare", "publisher", "worker", "camera")
FOLDER = "folder"
WORLD = demo_world(travel_mm=330.0).scaled(416)

NOTE = "Recovery: from the blow until another process is up in its place and frames are labelled again."


class Blows:
    """A session's `stop`: strikes `times` times, each time once all is well again, and then ends the scan."""

    def __init__(self, role: str, number: signal.Signals, times: int, folder: Path) -> None:
        self.session: Session | None = None
        self.recovery_s: list[float] = []
        self.pids: set[int] = set()
        self._role, self._number, self._left, self._folder = role, number, times, folder
        self._victim, self._struck, self._labelled = 0, 0.0, 0
        self._well_since = self._began = time.monotonic()

    def __call__(self) -> bool:
        assert self.session is not None
        now, processes, labelled = time.monotonic(), self.session.processes, self.session.labelled
        self.pids.update(pid for pids in processes.values() for pid in pids)
        if self._struck:
            if self._is_well(processes, labelled):
                self.recovery_s.append(now - self._struck)
                self._struck, self._well_since = 0.0, now
            elif now - self._struck > GIVE_UP_S:
                self.recovery_s.append(GIVE_UP_S)
                return True
            return False
        if not all(processes.get(role) for role in ROLES) or labelled < 10:
            self._well_since = now
            return now - self._began > 120.0
        if now - self._well_since < PAUSE_S:
            return False
        if not self._left:
            return True
        self._left -= 1
        self._struck, self._labelled = now, labelled
        if self._role == FOLDER:
            shutil.rmtree(self._folder)
        else:
            self._victim = processes[self._role][0]
            os.kill(self._victim, self._number)
        return False

    def _is_well(self, processes: dict[str, list[int]], labelled: int) -> bool:
        if self._role == FOLDER:
            return any(path.stat().st_size > 100_000 for path in self._folder.glob("*.mcap"))
        there = processes.get(self._role, [])
        return bool(there) and self._victim not in there and labelled > self._labelled


def struck(role: str, number: signal.Signals, times: int) -> tuple[Blows, ScanReport, list[str]]:
    """One scan under blows: them, its report, and what it left behind."""
    with tempfile.TemporaryDirectory() as out, start_head(WORLD, FPS, seed=5, speed_mm_s=2.0) as head:
        config = demo_config(head, WORLD, Path(out))
        folder = Path(out) / "scans"
        config = replace(
            config, record_folder=folder, workers=1, slots=24, publish=SocketConfig("tcp://127.0.0.1:*", None)
        )
        blows = Blows(role, number, times, folder)
        session = blows.session = Session(config, name="scan")
        report = session.run(blows)
        left = [f"process {pid}" for pid in blows.pids if Path(f"/proc/{pid}").exists()]
        left += [f"lamp {lamp}" for lamp in head.counters()["lamps_on"]]  # type: ignore[attr-defined]
        return blows, report, left


def daemon_killed(times: int) -> Row:
    """kill -9 of the daemon itself: until the lamps are dark, and its processes gone."""
    dark_s, left = [], Counter[str]()
    for _ in range(times):
        with tempfile.TemporaryDirectory() as out, start_head(WORLD, FPS, seed=5) as head:
            save_calibration(Path(out) / "calibration.json", WORLD.calibration())
            more = '\n[record]\nfolder = "scans"\n[publish]\naddress = "tcp://127.0.0.1:*"\n'
            (Path(out) / "head.toml").write_text(head_toml(head, WORLD, Path("calibration.json")) + more)
            (sockets := Path(out) / "tmp").mkdir()
            mark = {"ANNULUS_KILLED": out, "TMPDIR": str(sockets)}
            daemon = subprocess.Popen(
                [
                    sys.executable,
                    "-c",
                    "from annulus.cli import main; main()",
                    "daemon",
                    "--config",
                    f"{out}/head.toml",
                ],
                env=os.environ | mark,
                stderr=subprocess.PIPE,
                text=True,
            )
            assert daemon.stderr is not None
            for line in daemon.stderr:
                if line.startswith("scanning: ") and int(line.split()[1]) >= 12:
                    break
            daemon.kill()
            began = time.monotonic()
            dark_s.append(_until_dark(head, began))
            daemon.wait()
            daemon.stderr.close()
            end = time.monotonic() + 5.0
            while (alive := _marked(out)) and time.monotonic() < end:
                time.sleep(0.05)
            left["processes"] += len(alive)
            left["sockets"] += len(list(sockets.iterdir()))
    worst = max(dark_s)
    what = f"lamps dark after {median(dark_s):.2f}, at most {worst:.2f} s; left: {+left or 'nothing'}"
    return Row(f"daemon, SIGKILL, {times} times", "-", f"dark in {DARK_S} s", what, worst <= DARK_S and not +left)


def _until_dark(head: HeadHandle, began: float) -> float:
    """The last moment at which a lamp was seen on, over two seconds, in seconds."""
    last = 0.0
    while (since := time.monotonic() - began) < 2.0:
        if head.counters()["lamps_on"]:  # type: ignore[attr-defined]
            last = since
    return last


def _marked(mark: str) -> list[str]:
    found = []
    for folder in Path("/proc").iterdir():
        try:
            if folder.name.isdigit() and f"ANNULUS_KILLED={mark}\0".encode() in (folder / "environ").read_bytes():
                found.append(folder.name)
        except OSError:
            continue
    return found


def rows(times: int = TIMES, load: int = LOAD, tell: Callable[[Row], None] = lambda row: None) -> list[Row]:
    table: list[Row] = []
    with spinning(load):
        cases = [(role, number) for role in ROLES for number in (signal.SIGKILL, signal.SIGSTOP)]
        for role, number in [*cases, (FOLDER, signal.SIGKILL)]:
            blows, report, left = struck(role, number, times)
            took, ledger = blows.recovery_s, report.ledger
            lost = ", ".join(f"{count} {kind}" for kind, count in (*ledger.before.items(), *ledger.after.items()))
            measured = (
                f"recovery {median(took):.2f}, at most {max(took):.2f} s; {ledger.taken} frames, "
                f"lost: {lost or 'none'}; "
                f"left: {', '.join(left) or 'nothing'}" + (f"; {ledger.problem}" if ledger.problem else "")
            )
            soon = SOON_S + (1.0 if "spare" in role else 0.0)  # a spare follows a second after the last one
            ok = len(took) == times and max(took) <= soon and not left and not ledger.problem
            how = "removed" if role == FOLDER else number.name
            table.append(Row(f"{role}, {how}, {times} times", "-", f"{soon:g} s, adds up", measured, ok))
            tell(table[-1])
        table.append(daemon_killed(times))
        tell(table[-1])
    return table


if __name__ == "__main__":
    times, load = (int(value) for value in (*sys.argv[1:3], *(str(TIMES), str(LOAD))[len(sys.argv) - 1 :]))
    rows(times, load, lambda row: print(row.what, "|", row.measured, "|", row.ok, flush=True))
