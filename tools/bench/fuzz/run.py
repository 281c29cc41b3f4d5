"""Cases in a child process with limits, watched by this one; what breaks the law is kept with its input."""

import argparse
import contextlib
import multiprocessing
import os
import re
import resource
import shutil
import signal
import tempfile
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from annulus_pipe.vocabulary import AnnulusError
from tools.bench.fuzz.targets import TARGETS

CASE_S = 5.0  # of the processor: what others leave of the machine is not the case's fault
MEMORY_MAX = 2 << 30  # bytes above what the child begins with
HUNG_S = 60.0  # asleep, or in code that hears no signal
FINDINGS_MAX = 20


class TooLong(BaseException):
    """A case took over twice CASE_S."""


@dataclass
class Outcome:
    """`executions` cases were run; `findings`: case -> what it did."""

    executions: int = 0
    refused: int = 0
    seconds: float = 0.0
    findings: dict[int, str] = field(default_factory=dict)


def one(name: str, seed: int, number: int, folder: Path) -> str | None:
    """Runs one case: None for a result, "" for one line, else what broke the law."""
    target = TARGETS[name]
    data = target.case(Random(f"{seed} {name} {number}"))
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    signal.signal(signal.SIGPROF, _too_long)
    signal.setitimer(signal.ITIMER_PROF, 2 * CASE_S)
    begun, said = time.process_time(), None
    try:
        target.read(data, folder)
    except (AnnulusError, *target.one_line) as error:
        text = str(error)
        said = "" if text else "an error without words"
        if isinstance(error, AnnulusError) and (
            len(text) > 500 or re.search(r"[\x00-\x1f\x7f-\x9f\u202a-\u202e]", text)
        ):
            said = f"no printable line: {text[:200]!r}"
    except TooLong:
        return f"took over {2 * CASE_S:g} s"
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {str(error)[:200]} ({Path(place.filename).name}:{place.lineno})"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    took = time.process_time() - begun
    return f"took {took:.1f} s" if took > CASE_S else said


def _too_long(*_: object) -> None:
    raise TooLong


def _child(
    name: str, seed: int, first: int, last: int | None, end: float, folder: Path, progress: Any, told: Any
) -> None:
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 2)  # libraries say on stderr what they think of their input
    with open("/proc/self/statm") as file:
        size = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY_MAX, size + MEMORY_MAX))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    number = first
    while (last is None or number < last) and time.monotonic() < end:
        progress[0], progress[1] = number, int(time.monotonic() * 1e3)
        said = one(name, seed, number, folder / "case")
        if said:
            told.put((number, said))
        progress[2] += said == ""
        number += 1
    progress[0] = number
    told.put(None)


def fuzz(name: str, seed: int, *, seconds: float = 1e9, cases: int | None = None) -> Outcome:
    """Runs a target for so long, or so many cases."""
    context = multiprocessing.get_context("fork")
    outcome, begun, first = Outcome(), time.monotonic(), 0
    end = begun + seconds
    with tempfile.TemporaryDirectory(prefix="annulus-fuzz-") as folder:
        while time.monotonic() < end and (cases is None or first < cases) and len(outcome.findings) < FINDINGS_MAX:
            progress, told = context.Array("q", 3), context.Queue()
            progress[0], progress[1] = first, int(time.monotonic() * 1e3)
            child = context.Process(target=_child, args=(name, seed, first, cases, end, Path(folder), progress, told))
            child.start()
            done = False
            while not done:
                with contextlib.suppress(Exception):
                    heard = told.get(timeout=0.5)
                    if heard is None:
                        done = True
                    else:
                        outcome.findings[heard[0]] = heard[1]
                    continue
                hung = time.monotonic() - progress[1] / 1e3 > HUNG_S
                if hung and child.is_alive():
                    child.kill()
                    child.join()
                if not child.is_alive() and told.empty():
                    outcome.findings[progress[0]] = "hung" if hung else f"the process died ({child.exitcode})"
                    progress[0] += 1
                    done = True
            child.join()
            first = progress[0]
            outcome.refused += progress[2]
    outcome.executions, outcome.seconds = first, time.monotonic() - begun
    return outcome


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.bench fuzz", description=TARGETS.__doc__)
    parser.add_argument("--target", choices=[*TARGETS, "all"], default="all")
    parser.add_argument("--minutes", type=float, default=10.0, help="of each target")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--case", type=int, help="one case alone, with its traceback")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-findings"), help="folder for the inputs of findings")
    given = parser.parse_args(arguments)
    if given.case is not None:
        with tempfile.TemporaryDirectory() as folder:
            TARGETS[given.target].read(
                TARGETS[given.target].case(Random(f"{given.seed} {given.target} {given.case}")), Path(folder)
            )
        return 0
    bad = 0
    for name in TARGETS if given.target == "all" else [given.target]:
        outcome = fuzz(name, given.seed, seconds=60 * given.minutes)
        rate = outcome.executions / max(outcome.seconds, 1e-3)
        print(
            f"{name:<12} seed {given.seed}  {outcome.seconds / 60:.1f} min  {outcome.executions} cases  {rate:.0f}/s  "
            f"{outcome.refused} refused in one line  {len(outcome.findings)} findings",
            flush=True,
        )
        for number, what in outcome.findings.items():
            given.keep.mkdir(exist_ok=True)
            kept = given.keep / f"{name}-{given.seed}-{number}"
            kept.write_bytes(TARGETS[name].case(Random(f"{given.seed} {name} {number}")))
            print(f"  case {number}: {what}  ({kept})", flush=True)
        bad += len(outcome.findings)
    return 1 if bad else 0
