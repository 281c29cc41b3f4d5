"""Draws cases of one kind, measures each as a user would, and sums up."""

import argparse
import importlib
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tools.bench.blind.cases import guarded, run_all
from tools.bench.blind.others.tally import Case, markdown, totals


def run(asked: argparse.Namespace, seeds: Sequence[int], use: str) -> int:
    with tempfile.TemporaryDirectory() as scratch:
        return run_all(
            partial(one_case, asked.of, folder=asked.keep or Path(scratch)),
            seeds,
            asked.jobs,
            title=f"Blind, {asked.of}, seed {asked.seed} ({use})",
            command=f"python -m tools.bench blind --of {asked.of} --seed {asked.seed} --pipes {asked.pipes}",
            line=str,
            markdown=markdown,
            totals=totals,
            keep=asked.keep,
        )


def one_case(kind: str, seed: int, folder: Path) -> tuple[int, Case | str, float]:
    """A line in place of a case where it breaks."""
    room = folder / f"{kind}-{seed}"
    room.mkdir(parents=True, exist_ok=True)

    def measured() -> Case:
        case: Case = importlib.import_module(f"tools.bench.blind.others.{kind}").measured(seed, room)
        return case

    return guarded(seed, measured)
