"""Draws pipes, surveys them, scores them: `python -m tools.bench blind --help`."""

import argparse
import json
import sys
import tempfile
from functools import partial
from pathlib import Path

from annulus_pipe.vocabulary import AnnulusError
from tools.bench.blind.cases import guarded, run_all
from tools.bench.blind.draw import draw
from tools.bench.blind.others import KINDS
from tools.bench.blind.others.run import run as others
from tools.bench.blind.pipe import Scene
from tools.bench.blind.pov import need_povray
from tools.bench.blind.results import read_results
from tools.bench.blind.scan import LIGHTS, TRUTH, write_scan
from tools.bench.blind.score import Score, score
from tools.bench.blind.table import markdown, totals
from tools.bench.blind.truths import write_truths
from tools.bench.scenes.run import measure

PIPES, CASES = 60, 10
PER_SEED = 1000  # pipes that one seed can have
EPILOG = """Even seeds are for setting constants by. Odd seeds make the table, once: a seed that was looked at is
blind no more, and what was set on it says nothing of the next pipe."""


def main(arguments: list[str]) -> int:
    asked = _asked(arguments)
    seeds = seeds_of(asked.seed, asked.pipes)
    use = "even: for setting constants by" if asked.seed % 2 == 0 else "odd: for the table, once"
    print(f"seed {asked.seed} ({use}), {len(seeds)} {'pipes' if asked.of == 'rings' else asked.of}", flush=True)
    if asked.of != "rings":
        return others(asked, seeds, use)
    try:
        if not asked.score_only and asked.light == "povray":
            need_povray()
    except AnnulusError as error:
        print(error, file=sys.stderr)
        return 2
    light = "" if asked.light == LIGHTS[0] else f" --light {asked.light}"
    again = ", scored again" if asked.score_only else ""
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.keep or Path(scratch)
        return run_all(
            partial(one_pipe, folder=folder, score_only=asked.score_only, light=asked.light),
            seeds,
            asked.jobs,
            title=f"Blind, seed {asked.seed} ({use}){again}",
            command=f"python -m tools.bench blind --seed {asked.seed} --pipes {asked.pipes}{light}",
            line=_line,
            markdown=markdown,
            totals=totals,
            keep=asked.keep,
        )


def _asked(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench blind",
        epilog=EPILOG,
        description="Pipes drawn from a seed, photographed by POV-Ray or Mitsuba, surveyed, held against their truth.",
    )
    kinds = "; ".join(f"{name}: {what}" for name, what in KINDS.items())
    parser.add_argument("--of", choices=("rings", *KINDS), default="rings", help=f"rings: pipes as above; {kinds}")
    parser.add_argument("--seed", type=int, required=True, metavar="N", help="even: to set constants; odd: the table")
    parser.add_argument(
        "--pipes",
        default=None,
        metavar="K",
        help=f"how many, {PIPES} of rings and {CASES} of others; or single seeds, 2003,2007 (2003, for one alone)",
    )
    parser.add_argument("--light", choices=LIGHTS, default=LIGHTS[0], help="who draws, and as light goes there")
    parser.add_argument("--jobs", type=int, default=2, help="pipes worked on at a time")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keeps scans, truths.csv, results and tables")
    parser.add_argument("--score-only", action="store_true", help="of what --keep has; nothing is drawn or surveyed")
    asked = parser.parse_args(arguments)
    asked.pipes = asked.pipes or str(PIPES if asked.of == "rings" else CASES)
    if asked.score_only and asked.of != "rings":
        parser.error("--score-only is for rings; other cases are drawn and measured in one")
    if asked.score_only and asked.keep is None:
        parser.error("--score-only needs --keep FOLDER, where the pipes are")
    try:
        seeds_of(asked.seed, asked.pipes)
    except ValueError as error:
        parser.error(str(error))
    return asked


def seeds_of(seed: int, pipes: str) -> list[int]:
    """Of so many pipes, or of those that are named. Raises ValueError."""
    try:
        numbers = [int(one) for one in pipes.split(",") if one]
    except ValueError:
        raise ValueError(f"--pipes {pipes}: expected how many, or seeds with commas between") from None
    if "," not in pipes and len(numbers) == 1 and 0 < numbers[0] <= PER_SEED and seed:
        return [seed * PER_SEED + i for i in range(numbers[0])]
    if not numbers or any(one // PER_SEED != seed for one in numbers):
        raise ValueError(f"--pipes {pipes}: expected 1 to {PER_SEED}, or seeds from {seed * PER_SEED} on")
    return numbers


def one_pipe(seed: int, folder: Path, score_only: bool, light: str = LIGHTS[0]) -> tuple[int, Score | str, float]:
    """Draws, surveys and scores one; what is there of it is kept. A line in place of a score where it breaks."""
    scan, out = folder / str(seed), folder / f"{seed}-results"

    def scored() -> Score:
        if not score_only:
            if not (scan / TRUTH).is_file():
                write_scan(draw(seed), scan, light)
            if not (out / "summary.json").is_file():
                measure(scan, out, scan / "limits.toml")
        scene = Scene.from_dict(json.loads((scan / TRUTH).read_text(encoding="utf-8")))
        write_truths(scene, scan)
        return score(scene, read_results(out))

    return guarded(seed, scored)


def _line(one: Score) -> str:
    states = [outcome.state for outcome in one.outcomes]
    counts = ", ".join(f"{states.count(name)} {name}" for name in dict.fromkeys(states))
    return f"{one.bore_mm:.0f} mm, {one.material}: {counts}; {len(one.false)} false; {one.decision}"
