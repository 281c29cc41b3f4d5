"""Every process of a scan killed and stopped in turn, its disk full, slow and gone, its camera away: how soon it goes
on, whether the ledger of frames adds up, whether the lamps are dark in time, and what is left behind.

    python -m tools.bench.speed.kills [BLOWS] [LOAD] [--row NAME ...] [--seconds N]     LOAD: processes that spin

NAME: a part of the names of the rows wanted; --row ? lists them. Rows that share a scan (all but the daemon's own, and
the disk's) are struck in turn, and answer together for the ledger and for what is left; after N seconds such a scan
ends, with fewer blows. Disks need root.
"""

import argparse
import os
import random
import time
from collections.abc import Callable, Sequence
from statistics import median

from annulus_pipe.vocabulary import AnnulusError
from tools.bench.speed import blows, daemons
from tools.bench.speed.blows import Blow
from tools.bench.speed.live import spinning
from tools.bench.table import Row

TIMES, LOAD = 20, 3
SOON_S = 2.0

NOTE = "Recovery: from the blow, or its end, until a frame that came after it is labelled and has got where it should."

Told = Callable[[Row], None]
DAEMON: dict[str, Callable[[int], daemons.Outcome]] = {
    "daemon SIGKILL": daemons.killed,
    "daemon SIGKILL, its children stopped": lambda times: daemons.killed(times, stop_children=True),
    "daemon stopped for 1.5 s": lambda times: daemons.stopped(times, daemons.STOP_S),
    "daemon paused": lambda times: daemons.stopped(times, daemons.PAUSE_S),
}
ROOT: dict[str, Callable[[int], daemons.Outcome]] = {"disk full": daemons.filled}


def names() -> list[str]:
    """Of all rows that can be had here."""
    scans = [blow.name for group in _groups() for blow in group]
    return [*scans, *DAEMON, *(ROOT if os.geteuid() == 0 else ())]


def _groups() -> list[list[Blow]]:
    """Blows that share a scan."""
    groups = [list(blows.process_blows()), list(blows.other_blows())]
    return groups + ([list(blows.disk_blows())] if os.geteuid() == 0 else [])


def rows(
    times: int = TIMES,
    load: int = LOAD,
    wanted: Sequence[str] = ("",),
    tell: Told = lambda row: None,
    seconds: float = float("inf"),
) -> list[Row]:
    """`seconds`: a scan ends after so long, with fewer blows."""
    table: list[Row] = []

    def done(row: Row) -> None:
        table.append(row)
        tell(row)

    chosen = {name for name in names() if any(part in name for part in wanted)}
    with spinning(load):
        for number, group in enumerate(_groups()):
            mine = [blow for blow in group if blow.name in chosen]
            if mine:
                _scan(mine, times, number, seconds, done)
        for name, strike in (DAEMON | ROOT).items():
            if name in chosen:
                _daemon(name, strike, times, done)
    return table


def _scan(group: list[Blow], times: int, seed: int, seconds: float, done: Told) -> None:
    until_s, on_disk = time.monotonic() + seconds, group[0].name.startswith("disk")
    try:
        outcome = blows.struck(_in_turn(group, times, seed), seed + 1, on_disk, until_s)
    except AnnulusError as error:
        done(Row(", ".join(blow.name for blow in group), "-", "runs", str(error), False))
        return
    for blow in group:
        took = outcome.took_s[blow.name]
        ok = len(took) == times and max(took) <= SOON_S
        done(Row(f"{blow.name}, {len(took)} times", "-", f"{SOON_S:g} s", _spread(took), ok))
    ledger = outcome.report.ledger
    lost = ", ".join(f"{count} {kind}" for kind, count in (*ledger.before.items(), *ledger.after.items()))
    unknown = outcome.report.frames.get("unknown", 0)
    text = f"{ledger.taken} frames, {ledger.labelled} labelled ({unknown} unknown), {ledger.recorded} recorded; "
    text += f"lost: {lost or 'none'}; "
    text += "; ".join(outcome.problems) or "adds up, dark, nothing left"
    done(Row("their scan", "-", "adds up, dark, nothing left", text, not outcome.problems))


def _in_turn(group: list[Blow], times: int, seed: int) -> list[Blow]:
    """Each as often, in rounds of a drawn order; what takes something away before what puts it back."""
    chance, order = random.Random(seed), []
    for _ in range(times):
        fixed = any("put back" in blow.name for blow in group)
        order += group if fixed else chance.sample(group, len(group))
    return order


def _daemon(name: str, strike: Callable[[int], daemons.Outcome], times: int, done: Told) -> None:
    try:
        outcome = strike(times)
    except AnnulusError as error:
        done(Row(name, "-", "runs", str(error), False))
        return
    ok, said, asked = not outcome.problems, [], []
    if outcome.took_s:
        said.append("recovery " + _spread(outcome.took_s))
        asked.append(f"{SOON_S:g} s")
        ok = ok and len(outcome.took_s) == times and max(outcome.took_s) <= SOON_S
    if outcome.ended_s:
        said.append("scan ended after " + _spread(outcome.ended_s))
        asked.append(f"ended in {daemons.ENDED_S:g} s")
        ok = ok and len(outcome.ended_s) == times and max(outcome.ended_s) <= daemons.ENDED_S
    if outcome.dark_s:
        said.append("dark after " + _spread(outcome.dark_s))
        asked.append(f"dark in {daemons.DARK_S:.2f} s")
        ok = ok and len(outcome.dark_s) == times and max(outcome.dark_s) <= daemons.DARK_S
    said.append("; ".join(outcome.problems) or "adds up, dark, nothing left")
    if outcome.statuses:
        said.append(f"exit status {outcome.statuses[-1]}")
    done(Row(f"{name}, {times} times", "-", ", ".join(asked), "; ".join(said), ok))


def _spread(took_s: Sequence[float]) -> str:
    return f"{median(took_s):.2f}, at most {max(took_s):.2f} s" if took_s else "none"


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("blows", nargs="?", type=int, default=TIMES)
    parser.add_argument("load", nargs="?", type=int, default=LOAD)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--row", action="append", default=[])
    given = parser.parse_args()
    if "?" in given.row:
        print("\n".join(names()))
        return 0

    def tell(row: Row) -> None:
        print(row.what, "|", row.measured, "|", row.ok, flush=True)

    table = rows(given.blows, given.load, given.row or [""], tell, given.seconds)
    return 0 if all(row.ok for row in table) else 1


if __name__ == "__main__":
    raise SystemExit(main())
