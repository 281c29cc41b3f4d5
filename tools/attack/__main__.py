"""`python -m tools.attack --board native|emulated --edges N --seed S`: until N edges have fallen or a promise breaks.

--meet plays scenes in which subsystems meet (tools/attack/products.py) in place of those that try one after another.
--jobs J plays the seeds from S on, J at a time. --scene K plays scene K of seed S alone. --every goes on after a broken
promise, and lists each kind with the number of edges that found it. --other FILE: another revision's library or image.
Ends with status 1 when a promise was broken, and says how to see it again.
"""

import argparse
import re
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from annulus_pipe.link.messages import PolarityFlag
from tools.attack import products
from tools.attack.boards import MS, Board, BrokenPromiseError, Emulated, Native
from tools.attack.play import Player
from tools.attack.scenes import draw
from tools.attack.truth import Truth


@dataclass(slots=True)
class Outcome:
    """What one seed came to."""

    seed: int
    edges: int = 0
    scenes: int = 0
    virtual_s: float = 0.0
    seconds: float = 0.0
    longest_us: float = 0.0
    broken: list[tuple[int, int, str]] = field(default_factory=list)  # scene, edges played by then, what
    before: list[str] = field(default_factory=list)  # what was done before the first


def kind(what: str) -> str:
    """A broken promise without its numbers."""
    return re.sub(r"[-\d.]+", "#", re.sub(r"\w+\([^()]*(\([^()]*\)[^()]*)*\)", "it", what))


def open_board(board: str, seed: int, other: Path | None) -> Board:
    return Native(seed, other) if board == "native" else Emulated(other)


def attack(
    board: str,
    seed: int,
    edges: int,
    other: Path | None = None,
    every: bool = False,
    only: int | None = None,
    meet: bool = False,
) -> Outcome:
    """Scenes until enough edges have fallen; after a broken promise the next one begins on a fresh board. `meet`: those
    in which subsystems meet.
    """
    began, outcome = time.monotonic(), Outcome(seed)
    number, kinds, player = only or 0, set[str](), None
    while outcome.edges < edges and (not outcome.broken or every) and (only is None or number == only):
        scene = products.draw(seed, number, board) if meet else draw(seed, number, board)
        try:
            if player is None:
                inverted = products.wiring(seed, number) if meet else PolarityFlag(0)
                player = Player(open_board(board, seed, other), inverted)
                truth = Truth(player)
            player.play(scene)
            found = truth.judge(scene)
        except BrokenPromiseError as error:
            found = [str(error)]
        outcome.edges += len(player.kept.falls) if player else len(scene.falls)
        new = [what for what in found if kind(what) not in kinds]
        outcome.broken += [(number, outcome.edges, what) for what in new]
        kinds |= {kind(what) for what in new}
        number += 1
        if player is None:
            break
        outcome.longest_us = max(outcome.longest_us, truth.longest / MS * 1000)
        another = meet and number % products.SCENES_A_BOARD == 0
        if found or another or outcome.edges >= edges or only is not None:
            outcome.before = outcome.before or (list(player.done) if found else [])
            outcome.virtual_s += player.board.now / MS / 1000
            player.board.close()
            player = None
    outcome.scenes = number - (only or 0)
    outcome.seconds = time.monotonic() - began
    return outcome


def tell(outcome: Outcome, board: str, edges: int, every: bool, meet: bool) -> None:
    longest = f", longest round {outcome.longest_us:.0f} us" if outcome.longest_us else ""
    print(
        f"seed {outcome.seed}: {outcome.edges} edges in {outcome.scenes} scenes, {outcome.virtual_s:.0f} s of the "
        f"board's time in {outcome.seconds:.0f} s{longest}",
        flush=True,
    )
    for scene, by_then, what in outcome.broken:
        print(f"BROKEN after {by_then} edges, seed {outcome.seed}, scene {scene}: {what}")
    if outcome.broken and not every:
        print(*outcome.before, sep="\n")
        scene = outcome.broken[0][0]
        alone = attack(board, outcome.seed, edges, only=scene, meet=meet).broken
        again = f"--seed {outcome.seed} --scene {scene}" if alone else f"--seed {outcome.seed} --edges {edges}"
        print(f"again: python -m tools.attack --board {board} {'--meet ' if meet else ''}{again}")


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.attack")
    parser.add_argument("--board", choices=("native", "emulated"), default="native")
    parser.add_argument("--edges", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--scene", type=int)
    parser.add_argument("--every", action="store_true")
    parser.add_argument("--other", type=Path)
    parser.add_argument("--meet", action="store_true")
    given = parser.parse_args(arguments)
    share, broken = -(-given.edges // given.jobs), False
    seeds = range(given.seed, given.seed + given.jobs)
    calls = [(given.board, seed, share, given.other, given.every, given.scene, given.meet) for seed in seeds]
    with ProcessPoolExecutor(given.jobs) as pool:
        for outcome in pool.map(attack, *zip(*calls, strict=True)):
            tell(outcome, given.board, share, given.every, given.meet)
            broken |= bool(outcome.broken)
    print("a promise was broken" if broken else "no promise broken")
    return int(broken)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
