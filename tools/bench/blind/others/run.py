"""Draws cases of one kind, measures each as a user would, and sums up."""

import argparse
import importlib
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tools.bench.blind.others.tally import Case, markdown, totals


def run(asked: argparse.Namespace, seeds: Sequence[int], use: str) -> int:
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.keep or Path(scratch)
        cases, failed, began, worked_s = [], {}, time.monotonic(), 0.0
        for seed, case, spent_s in _each(asked.of, seeds, folder, asked.jobs):
            worked_s += spent_s
            if isinstance(case, str):
                failed[seed] = case
            else:
                cases.append(case)
            print(f"{seed}: {case} ({spent_s:.0f} s)", flush=True)
        done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
        command = f"python -m tools.bench blind --of {asked.of} --seed {asked.seed} --pipes {asked.pipes}"
        head = (
            f"# Blind, {asked.of}, seed {asked.seed} ({use})\n\nMade by `{command}` at `{done.stdout.strip()}` in "
            f"{(time.monotonic() - began) / 60:.1f} minutes, {worked_s / len(seeds):.0f} s of processor each."
        )
        text = markdown(cases, failed, head)
        print(f"\n{text}", end="")
        if asked.keep:
            (folder / "table.md").write_text(text, encoding="utf-8")
            plain = json.dumps(totals(cases, failed), indent=1)
            (folder / "table.json").write_text(plain, encoding="utf-8")
    return 1 if failed else 0


def _each(kind: str, seeds: Sequence[int], folder: Path, jobs: int) -> Iterator[tuple[int, Case | str, float]]:
    if jobs <= 1 or len(seeds) == 1:
        for seed in seeds:
            yield one_case(kind, seed, folder)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(one_case, [kind] * len(seeds), seeds, [folder] * len(seeds))


def one_case(kind: str, seed: int, folder: Path) -> tuple[int, Case | str, float]:
    """A line in place of a case where it breaks."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    began, room = sum(os.times()[:4]), folder / f"{kind}-{seed}"
    room.mkdir(parents=True, exist_ok=True)
    try:
        return seed, importlib.import_module(f"tools.bench.blind.others.{kind}").measured(seed, room), _since(began)
    except Exception as error:  # must not cost the other cases
        return seed, f"{type(error).__name__}: {' '.join(str(error).split())}", _since(began)


def _since(began: float) -> float:
    return sum(os.times()[:4]) - began
