"""Breaks the host's Python at places drawn from a seed, one at a time, and says which tests notice.

python -m tools.breakages --seed 7 --count 20          the tests of the room first, then the rest of the gate
python -m tools.breakages --seed 7 --list              only say what would be broken
python -m tools.breakages --seed 7 --room-only         the tests of the room, no more: minutes in place of hours
python -m tools.breakages --seed 7 --deep              what the gate lets pass, before the deep tests as well

Each fault is made in a copy of the tracked files. Whoever notices is asked of the unbroken copy too: a test that fails
there as well has noticed nothing, and is left out from then on. `tools/mutants.py` breaks the firmware, by names.
"""

import argparse
import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from tools.faults import Breakage, drawn

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "build/breakages"
GATE = ["tests/unit", "tests/regression", "tests/scenes", "tests/system", "tests/hil"]
HOUSE = "tests/unit/test_house.py"  # judges texts, and a run of some tests as if it were one of all: a false catch
UNTRACKED = (
    "firmware/build",
    "host/annulus_pipe/shipped/annulus.uf2",
    "host/annulus_pipe/shipped/libannulus_native.so",
)
LINKED = (".venv", ".tools", "tools/emulator/node_modules")
RUN = [sys.executable, "-m", "pytest", "-x", "--tb=no", "-p", "no:cacheprovider"]
DEEP_TIMES = 4.0  # the deep tests cost so much more than the gate: tests/durations.json
LATE = "nothing but the time: more than"


def host_sources() -> dict[str, str]:
    return {
        name: (ROOT / name).read_text(encoding="utf-8") for name in tracked("host/annulus_pipe") if name.endswith(".py")
    }


def tracked(*under: str) -> list[str]:
    listed = subprocess.run(["git", "ls-files", "-z", *under], cwd=ROOT, capture_output=True, text=True, check=True)
    return [name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


def copied(other: Path) -> Path:
    """A checkout of its own. Raises SystemExit where Python would still import ours."""
    for name in tracked():
        (other / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, other / name, follow_symlinks=False)
    git = ["git", "-c", "user.name=breakages", "-c", "user.email=breakages@localhost", "-c", "gc.auto=0"]
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-q", "--no-verify", "-m", "a copy"]):
        subprocess.run([*git, *words], cwd=other, check=True)
    for name in UNTRACKED:  # copied: a test that builds must not write into ours
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, other / name)
        elif (ROOT / name).is_file():
            shutil.copy2(ROOT / name, other / name)
    for name in LINKED:
        if (ROOT / name).is_dir():
            (other / name).symlink_to(ROOT / name)
    asked = [sys.executable, "-c", "import annulus_pipe; print(annulus_pipe.__file__)"]
    run = subprocess.run(asked, cwd=other, env=env_of(other), capture_output=True, text=True)
    if not run.stdout.startswith(f"{other}/"):
        raise SystemExit(f"tools.breakages: annulus comes not from the copy but {(run.stdout or run.stderr).strip()}")
    return other


def env_of(other: Path) -> dict[str, str]:
    ours = {"PYTHONPATH": f"{other / 'host'}"}
    return {**os.environ, **ours, "PYTHONDONTWRITEBYTECODE": "1"}  # none is stale


def noticed_by(other: Path, arguments: list[str], timeout_s: float, env: dict[str, str]) -> str:
    """The first test that fails, the last line of a run that never began, or "" where none does."""
    with tempfile.TemporaryFile("w+") as said:
        run = subprocess.Popen(
            [*RUN, *arguments], cwd=other, env=env, stdout=said, stderr=subprocess.STDOUT, start_new_session=True
        )
        try:
            status = run.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return f"{LATE} {timeout_s:g} s"
        finally:  # its workers as well, also when we are interrupted
            if run.poll() is None:
                os.killpg(run.pid, signal.SIGKILL)
                run.wait()
        said.seek(0)
        text = said.read()
    if status in (0, 5):  # 5: no such tests
        return ""
    first = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", text, re.M)
    return first.group(1) if first else (text.strip().splitlines() or [f"pytest ended with {status}"])[-1]


@dataclass(slots=True)
class Bench:
    """The copy, and what was found out about it."""

    other: Path
    timeout_s: float
    env: dict[str, str]
    workers: tuple[str, ...] = ("-n", "2", "--dist", "loadfile")
    excused: list[str] = field(default_factory=list)  # tests that fail in the unbroken copy as well

    def stages(self, room: str, *, room_only: bool, deep: bool) -> list[tuple[str, list[str], float]]:
        gate = ["-m", "not deep and not alone"]
        own = [name for name in (f"tests/unit/{room}", f"tests/unit/test_{room}.py") if (self.other / name).exists()]
        rest = [name for name in GATE if (self.other / name).is_dir()] + [f"--ignore={HOUSE}"]
        stages = [("room", [*own, *gate], self.timeout_s)] if own else []
        if not room_only:
            past = [f"--ignore={name}" for name in own]
            stages.append(("gate", [*rest, *past, *gate], self.timeout_s))
        if deep:
            stages.append(("deep", [*rest, "-m", "deep and not alone"], DEEP_TIMES * self.timeout_s))
        return stages

    def judged(self, fault: Breakage, *, room_only: bool = False, deep: bool = False) -> tuple[str, str]:
        """room, gate, deep or nobody; and the test that failed."""
        path = self.other / fault.file
        right = path.read_text(encoding="utf-8")
        for stage, arguments, timeout_s in self.stages(fault.room, room_only=room_only, deep=deep):
            while True:
                without = [f"--deselect={name}" for name in self.excused]
                path.write_text(fault.source, encoding="utf-8")
                try:
                    by = noticed_by(self.other, [*self.workers, *arguments, *without], timeout_s, self.env)
                finally:
                    path.write_text(right, encoding="utf-8")
                if by.startswith(LATE) or (by and not self.fails_anyway(by, arguments)):
                    return stage, by
                if not by:
                    break
                if by in self.excused:
                    raise SystemExit(f"tools.breakages: {by} fails without any fault and cannot be left out")
                self.excused.append(by)
                print(f"       {by} fails without any fault, and is left out", file=sys.stderr, flush=True)
        return "nobody", ""

    def fails_anyway(self, by: str, arguments: list[str]) -> bool:
        if by.startswith("tests/"):
            return bool(noticed_by(self.other, [by], self.timeout_s, self.env))
        if why := noticed_by(self.other, [*arguments, "--collect-only"], self.timeout_s, self.env):
            raise SystemExit(f"tools.breakages: pytest does not run in the unbroken copy: {why}")
        return False


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.breakages", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1, help="draws the places and the faults (1)")
    parser.add_argument("--count", type=int, default=20, help="of faults (20)")
    parser.add_argument("--list", action="store_true", help="say what would be broken, and run nothing")
    parser.add_argument("--room-only", action="store_true", help="the tests of the room that is broken, no more")
    parser.add_argument("--deep", action="store_true", help="what the gate lets pass goes before the deep tests")
    stage_help = (
        f"s, a stage that takes longer hangs: that is caught as well (900; the deep one {DEEP_TIMES:g} times that)"
    )
    parser.add_argument("--timeout", type=float, default=900.0, metavar="S", help=stage_help)
    asked = parser.parse_args()
    if not 0 < asked.count <= 10_000 or not 0.0 < asked.timeout < 1e6:
        parser.error("expected --count from 1 to 10000, --timeout above 0 s")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # pytest and the copy go with us
    faults = drawn(host_sources(), asked.seed, asked.count)
    if asked.list:
        for fault in faults:
            print(f"{fault.file}:{fault.line}  {fault.was}  ->  {fault.now}")
        return 0
    KEPT.mkdir(parents=True, exist_ok=True)
    place = Path(tempfile.gettempdir()).resolve() / f"annulus-breakages-{os.getuid()}"
    tally, late = {"room": 0, "gate": 0, "deep": 0, "nobody": 0}, 0
    with (place.with_suffix(".lock")).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SystemExit(f"tools.breakages: another run of it is at work in {place}") from None
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(mode=0o700)
        try:
            bench = Bench(copied(place), asked.timeout, env_of(place))
            for fault in faults:
                began = time.monotonic()
                stage, by = bench.judged(fault, room_only=asked.room_only, deep=asked.deep)
                tally[stage] += 1
                late += by.startswith(LATE)
                verdict = f"caught deep by {by}" if stage == "deep" else f"caught by {by} ({stage})"
                if stage == "nobody":
                    stages = bench.stages(fault.room, room_only=asked.room_only, deep=asked.deep)
                    verdict = f"SURVIVED ({stages[-1][0]})" if stages else "SURVIVED (the room has no tests)"
                took_s = time.monotonic() - began
                print(f"{fault.file}:{fault.line}  {fault.was} -> {fault.now}  {verdict}  {took_s:.0f} s", flush=True)
        finally:
            shutil.rmtree(place, ignore_errors=True)
    caught = tally["room"] + tally["gate"]
    where = "their room" if asked.room_only else f"the gate, {tally['room']} of them by their room"
    print(f"{caught} of {len(faults)} caught in {where}; only deep {tally['deep']}; survived {tally['nobody']}", end="")
    print(f"; {late} by nothing but a stage's time" if late else "")
    return 0


if __name__ == "__main__":
    sys.exit(main())
