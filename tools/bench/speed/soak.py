"""The daemon's labels under every fault at once, and under each alone.

python -m tools.bench.speed.soak [FRAMES] [PROFILE ..]     each alone; by default 100 000 frames of each in EACH
"""

import sys
from typing import Any

from annulus_pipe.twin.profiles import PROFILES
from annulus_pipe.twin.soak import soak
from tools.bench.table import Row, line, section

MANY, FRAMES, SEED = 1_000_000, 100_000, 1
UNKNOWN_MAX, RELOCK_MAX, SECONDS_MAX = 0.025, 8, 300.0
EACH = (
    "five-steps",
    "stamp-steps",
    "stamps-ahead",
    "stamps-late",
    "drift",
    "drift-slow",
    "drift-50",
    "drift-turns",
    "one-stamp-late",
    "torn",
    "repeated",
    "frozen",
    "part-steps",
    "ratio-0",
    "ratio-1",
    "same-boot",
    "resets",
    "winch-at-rest",
    "disconnects",
    "counts",
    "stalls",
    "late",
    "unplugged",
    "rough",
)

NOTE = (
    "Wrong: a lamp or a place. Unknown: share of all frames, those included in which nothing could be known. Relock:"
    " frames from the end of a disturbance to the next right label, the worst of all."
)


SLIDES_FRAMES, SLIDES_SEED, SLIDES_UNKNOWN_MAX = 20_000, 11, 0.2  # the seed none of it was set on
SLIDES = ("all", "rough", "resets", "stalls", "repeated", "torn")


def _slides(name: str) -> Row:
    """A head whose four slides are lit in turn, through all of its eight cameras."""
    frames = SLIDES_FRAMES
    result = soak(frames, SLIDES_SEED, faults=name, jobs=None, world_frames=frames // 8, head="fringe-modules")
    ok = result["wrong"] == 0 and result["untold"] == 0 and result["unknown_share"] <= SLIDES_UNKNOWN_MAX
    what = f"{frames} frames of slides lit in turn (Model B), {name}: {PROFILES[name].says}"
    target = f"0 wrong slots, 0 wrong, {SLIDES_UNKNOWN_MAX:.0%} unknown"
    return Row(what, "-", target, f"{result['wrong_slots']} wrong slots, {_told(result)}", ok)


def _row(name: str, frames: int, what: str, *, all_of_it: bool = False) -> Row:
    result = soak(frames, SEED, faults=name, jobs=None, world_frames=min(50_000, frames // 2))
    ok, target = result["wrong"] == 0 and result["untold"] == 0, "0 wrong"
    if all_of_it:
        target = f"0 wrong, {UNKNOWN_MAX:.1%} unknown, relock {RELOCK_MAX}, {SECONDS_MAX:.0f} s"
        relock, seconds = result["relock_frames_max"], result["seconds"]
        ok = ok and result["unknown_share"] <= UNKNOWN_MAX and relock <= RELOCK_MAX and seconds <= SECONDS_MAX
    return Row(what, "-", target, _told(result), ok)


def _told(result: dict[str, Any]) -> str:
    return (
        f"{result['wrong']} wrong, {result['unknown_share']:.2%} unknown, relock {result['relock_frames_max']},"
        f" {result['seconds']:.0f} s"
    )


def each(names: tuple[str, ...] = EACH, frames: int = FRAMES) -> list[Row]:
    rows = []
    for name in names:
        rows.append(_row(name, frames, f"{frames} frames, {name}: {PROFILES[name].says}"))
        print(line([rows[-1].what, rows[-1].measured]), flush=True)
    return rows


def rows() -> list[Row]:
    return [_row("all", MANY, f"{MANY} frames of everything", all_of_it=True), *map(_slides, SLIDES), *each()]


if __name__ == "__main__":
    arguments = sys.argv[1:]
    found = each(tuple(arguments[1:]) or EACH, int(arguments[0]) if arguments else FRAMES)
    print("\n".join(section("Each fault alone", found, NOTE)))
    sys.exit(any(row.ok is False for row in found))
