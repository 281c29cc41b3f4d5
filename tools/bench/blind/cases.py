"""Cases worked on side by side, a line of each as it ends, and the table of all."""

import json
import os
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")


def guarded(seed: int, work: Callable[[], T]) -> tuple[int, T | str, float]:
    """The seed, what the work gave, or a line where it breaks, and seconds of processor, children's among them."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    began = sum(os.times()[:4])
    try:
        done: T | str = work()
    except Exception as error:  # must not cost the other cases
        done = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return seed, done, sum(os.times()[:4]) - began


def run_all(
    work: Callable[[int], tuple[int, T | str, float]],
    seeds: Sequence[int],
    jobs: int,
    *,
    title: str,
    command: str,
    line: Callable[[T], str],
    markdown: Callable[[Sequence[T], Mapping[int, str], str], str],
    totals: Callable[[Sequence[T], Mapping[int, str]], dict[str, Any]],
    keep: Path | None,
) -> int:
    """0, or 1 where one of them broke. work : picklable; gives what `guarded` does. keep : for table.md and .json."""
    whole: list[T] = []
    broke: dict[int, str] = {}
    began, worked_s = time.monotonic(), 0.0
    with ProcessPoolExecutor(max(jobs, 1)) as pool:
        for seed, one, spent_s in (map if jobs <= 1 or len(seeds) == 1 else pool.map)(work, seeds):
            worked_s += spent_s
            if isinstance(one, str):
                broke[seed] = one
            else:
                whole.append(one)
            print(f"{seed}: {one if isinstance(one, str) else line(one)} ({spent_s:.0f} s)", flush=True)
    minutes, each_s = (time.monotonic() - began) / 60, worked_s / len(seeds)
    head = (
        f"# {title}\n\nMade by `{command}` at `{_commit()}` in {minutes:.1f} minutes, {each_s:.0f} s of processor each."
    )
    text = markdown(whole, broke, head)
    print(f"\n{text}", end="")
    if keep is not None:
        (keep / "table.md").write_text(text, encoding="utf-8")
        (keep / "table.json").write_text(json.dumps(totals(whole, broke), indent=1), encoding="utf-8")
    return 1 if broke else 0


def _commit() -> str:
    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    return done.stdout.strip()
