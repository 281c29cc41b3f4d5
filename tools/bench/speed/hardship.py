"""What the machine does to a scan: processes that die again and again, and memory that there is not.

The kernel's OOM killer sends SIGKILL, and a process that is refused memory (RLIMIT_AS, put on it while it runs) ends or
fails by itself: both are done to each process once. Spares are left alone but where they are named.
"""

import os
import resource
import signal
import subprocess
import time
from collections import Counter
from contextlib import suppress

from annulus_pipe.daemon.ledger import ExitStatus
from annulus_pipe.record.recording import open_recording
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.speed.at_work import Work, at_work, recordings, until
from tools.bench.speed.blows import FPS, WORLD, is_alive, lit
from tools.bench.speed.daemons import DARK_S, dark_after
from tools.bench.speed.live import children_of
from tools.bench.speed.viewers import looked, serving
from tools.bench.table import Row

LOOPS = ("worker", "publisher", "surveyor", "recorder", "camera")
STARTS_A_SECOND = 1.0  # of processes that die at once, over the seconds of the row, their spares with them
CPU_PERCENT = 100.0  # of a core: a start costs up to two seconds of processor, and there are few
LINES_MAX = 12  # that the operator is told of it
BACK_S = 20.0  # after the last death: what was given up is tried again after 1, 2, 4, 8 s
GOES_ON_S = 10.0  # a process without memory is replaced, or found to hang, and the scan goes on
ENDED_S = 20.0
FLUSH_S = 1.5  # the recorder's chunks are on their way to the disk at least this often


def loops(seconds: float = 12.0, roles: tuple[str, ...] = LOOPS) -> list[Row]:
    """Every process of one kind is killed as soon as it starts, for so long; of two workers one is left alone."""
    rows = []
    with at_work(WORLD, FPS, workers="count = 2", judge=False) as work:
        rows += [_loop(work, role, seconds) for role in roles]
        zombies = [pid for _, pid in children_of(work.pid) if not is_alive(pid)]
        work.end()
        status, left = work.daemon.end(), [str(one) for one in work.daemon.sockets.iterdir()]
    wrong = [one for one in work.problems if one.startswith(("damaged", "frame "))]  # what was cut off is no wonder
    ok = not (zombies or left or wrong) and status in (ExitStatus.FINE, ExitStatus.INCOMPLETE)
    text = "; ".join([*wrong, *map(str, zombies), *left]) or f"{work.recorded} frames, whole; status {status}"
    return [*rows, Row("their scan in the end", "-", "readable, no zombie, nothing left", text, ok)]


def _loop(work: Work, role: str, seconds: float) -> Row:
    keep = set(work.pids(role)[:1]) if role == "worker" else set()
    lines, victims, zombies = len(work.daemon.heard()), set[int](), 0
    recorded, spent = work.ear.telemetry["recorded"], work.cpu_s()
    began = time.monotonic()
    while time.monotonic() < began + seconds:
        for pid in set(work.pids(role)) - keep:
            with suppress(ProcessLookupError):
                zombies += pid in victims and not is_alive(pid)
                os.kill(pid, signal.SIGKILL)
                victims.add(pid)
        time.sleep(0.01)
    percent = 100.0 * (work.cpu_s() - spent) / seconds
    told = [line for line in work.daemon.heard()[lines:] if not line.startswith(("armed", "scanning", "fault", "idle"))]
    given_up = [line for line in told if "tried" in line or "replaced" in line]
    killed_s = time.monotonic()
    back, took_s = "back", 0.0
    try:
        until(lambda: _works(work, role), f"no {role} {BACK_S:g} s later", BACK_S)
        took_s = time.monotonic() - killed_s
    except AnnulusError as error:
        back = str(error)
    more, whole_s = work.ear.telemetry["recorded"] - recorded, time.monotonic() - began
    records = more > 0.5 * whole_s * FPS if role not in ("recorder", "camera") else True
    ok = (
        len(victims) <= STARTS_A_SECOND * seconds + 4
        and percent <= CPU_PERCENT
        and records
        and back == "back"
        and bool(given_up)
        and len(told) <= LINES_MAX
    )
    text = (
        f"{len(victims)} starts, {percent:.0f} % of a core, {more} frames recorded in {whole_s:.0f} s, "
        f'{len(told)} lines; {back} {took_s:.1f} s after the last; "{(given_up or told or ["nothing"])[-1]}"'
    )
    asked = f"<= {STARTS_A_SECOND:g} starts a second, <= {CPU_PERCENT:g} %, recording goes on, <= {LINES_MAX} lines"
    return Row(f"{role} dies as it starts, for {seconds:g} s", "-", asked, text, ok)


def _works(work: Work, role: str) -> bool:
    """Frames recorded, labels heard, and the role's process is there."""
    telemetry, before = work.ear.telemetry, work.ear.telemetry.get("recorded", 0)
    time.sleep(1.2)
    grows = work.ear.telemetry is not telemetry and work.ear.telemetry.get("recorded", 0) > before
    return grows and bool(work.pids(role)) and work.client.health() is not None


# ---- memory ----


def memory(roles: tuple[str, ...] = LOOPS, console: bool = True) -> list[Row]:
    """Each process is refused memory, and is killed; then the console, and in the end the daemon itself."""
    rows = []
    with at_work(WORLD, FPS, record="sync_s = 1", judge=False) as work:
        rows += [_struck(work, role, how) for how in (refuse_memory, _kill) for role in roles]
        rows += [_console(work)] if console else []
        rows += [_out_of_files(work, role) for role in roles]
        rows.append(_killed(work))
    with at_work(WORLD, FPS, judge=False) as work:
        rows.append(_refused(work))
    return rows


def refuse_memory(pid: int) -> None:
    """Not a page more than it has."""
    resource.prlimit(pid, resource.RLIMIT_AS, (1, resource.RLIM_INFINITY))


def _kill(pid: int) -> None:
    os.kill(pid, signal.SIGKILL)


def _struck(work: Work, role: str, how: object) -> Row:
    name = "refused memory" if how is refuse_memory else "killed, as by the OOM killer"
    lines, unknown = len(work.daemon.heard()), work.ear.unknown
    victim = work.pids(role)[0]
    how(victim)  # type: ignore[operator]
    began, back = time.monotonic(), ""
    time.sleep(2.0)
    try:
        until(lambda: _works(work, role), f"no scan as before after {GOES_ON_S:g} s", GOES_ON_S)
    except AnnulusError as error:
        back = f"{error}; "
    took_s = time.monotonic() - began
    time.sleep(1.0)
    told = _news(work.daemon.heard()[lines:])
    ends = not is_alive(victim)
    traces = sum("Traceback" in line for line in told)
    ok = not back and not traces and (len(told) >= 1 or not ends) and len(told) <= LINES_MAX
    text = f"{back}{'replaced' if ends else 'lives on'}, the scan goes on within {took_s:.1f} s; "
    said = ", ".join(f'{count} times "{line}"' for line, count in Counter(told).most_common(2)) or "nothing"
    text += f"{work.ear.unknown - unknown} labels unknown; {len(told)} lines: {said}"
    return Row(f"{role} {name}", "-", f"the scan goes on in {GOES_ON_S:g} s, told, no traceback", text, ok)


def _console(work: Work) -> Row:
    lines, before = len(work.daemon.heard()), work.ear.unknown
    with serving(work.both) as (pid, url):
        looked(url, 1, 1.0)
        refuse_memory(pid)
        said = "it serves on"
        try:
            looked(url, 3, 1.0)
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
            said = "it serves nobody any more"
        _kill(pid)
    with serving(work.both) as (_, url):
        seen = looked(url, 1, 1.0)["a_second"]["status"]
    told = _news(work.daemon.heard()[lines:])
    text = f"refused memory {said}; killed, another shows {seen:.0f} words a second; the daemon says {told or 'no'}"
    return Row(
        "console refused memory, then killed",
        "-",
        "the scan does not notice; another console shows it",
        text,
        seen > 0 and not told and work.ear.unknown <= before + 2,
    )


def _killed(work: Work) -> Row:
    """By SIGKILL: what is on the disk is whole up to the last flush, the lamps go dark, nothing is left."""
    newest, children = max(work.ear.labels), [pid for _, pid in children_of(work.pid)]
    _kill(work.pid)
    dark_s = dark_after(work.head, time.monotonic())
    work.daemon.process.wait()
    problems = [f"left: process {pid}" for pid in children if is_alive(pid)] + lit(work.head)
    last = -1
    for path in recordings(work.out / "scans"):
        recording = open_recording(path)
        problems += [f"{path.name}: {one.text}" for one in recording.check()]
        last = max([last, *(frame.index for frame in recording.frames)])
    missing = newest - last
    if missing > FLUSH_S * FPS:
        problems.append(f"the last {missing} frames are not on the disk")
    text = f"dark after {dark_s:.2f} s; on the disk up to {max(0, missing)} frames before the last label; "
    text += "; ".join(problems) or "every frame whole"
    return Row(
        "daemon killed, as by the OOM killer",
        "-",
        f"dark in {DARK_S:.2f} s, whole up to the last flush",
        text,
        not problems and dark_s <= DARK_S,
    )


def _out_of_files(work: Work, role: str) -> Row:
    """Not one descriptor more, for a while in which all processes of one kind die, spares as well."""
    lines, recorded, began = len(work.daemon.heard()), work.ear.telemetry["recorded"], time.monotonic()
    usual = resource.prlimit(work.pid, resource.RLIMIT_NOFILE, (3, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    for _ in range(3):
        for pid in work.pids(role):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(1.0)
    resource.prlimit(work.pid, resource.RLIMIT_NOFILE, usual)
    back = f"the {role} is back"
    try:
        until(lambda: _works(work, role), f"no {role} {BACK_S:g} s later", BACK_S)
    except AnnulusError as error:
        back = str(error)
    told = [line for line in _news(work.daemon.heard()[lines:]) if "cannot start" in line]
    more, whole_s = work.ear.telemetry["recorded"] - recorded, time.monotonic() - began
    records = more > 0.5 * whole_s * FPS or role in ("recorder", "camera")
    ok = records and back == f"the {role} is back" and bool(told) and len(told) <= LINES_MAX
    text = f'{more} frames recorded in {whole_s:.0f} s; {back}; {len(told)} lines: "{(told or ["nothing"])[-1]}"'
    asked = f"recording goes on, told, the {role} comes back"
    return Row(f"daemon out of descriptors while a {role} dies", "-", asked, text, ok)


def _refused(work: Work) -> Row:
    lines = len(work.daemon.heard())
    refuse_memory(work.pid)
    began = time.monotonic()
    _kill(work.pids("worker")[0])  # so that it needs some
    try:
        status: int | None = work.daemon.process.wait(ENDED_S)
    except subprocess.TimeoutExpired:
        status = None
    took_s = time.monotonic() - began
    heard = max(work.ear.heard_s - began, 0.0)
    time.sleep(0.3)
    told = _news(work.daemon.heard()[lines:])
    problems = [
        f"{path.name}: {one.text}" for path in recordings(work.out / "scans") for one in open_recording(path).check()
    ]
    problems += ["a traceback"] if any("Traceback" in line for line in told) else []
    if status is None:
        problems += [] if heard > ENDED_S - 2.0 else [f"it hangs: no label for {ENDED_S - heard:.0f} s"]
        text = f"goes on for {ENDED_S:g} s; "
    else:
        problems += ["status 0"] if status == 0 else []
        time.sleep(DARK_S)
        problems += lit(work.head)
        text = f'ends after {took_s:.1f} s with status {status}, "{(told or ["nothing"])[-1]}"; '
    text += "; ".join(problems) or "nothing damaged"
    return Row("daemon refused memory", "-", "goes on, or ends dark with one line and status not 0", text, not problems)


def _news(lines: list[str]) -> list[str]:
    """What is more than the same numbers again, or how the head is."""
    dull = ("armed: ", "scanning: ", "fault: ", "idle: ", "health ", "head ", "frame ")
    return [line for line in lines if not line.startswith(dull)]
