"""What a scan endures: a crowd of viewers, many frames and cameras, processes that die and memory that is refused, a
day of comings and goings, a second daemon, lamps that are tuned meanwhile. All of it takes a quarter of an hour.

    python -m tools.bench.speed.endurance [--short] [NAME ..]      NAME: one of ROWS; status 1 when a row does not hold

`what` was done, `asked` was expected, `this project` was observed. The head is the twin's, on the same machine: bounds
of milliseconds are for two cores on which twin, viewers and consoles run, too. tests/system/test_endurance.py runs
what does not depend on how busy the machine is, in its short form.
"""

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from tools.bench.speed import crowd, hardship, neighbours
from tools.bench.table import Row

ROWS: Mapping[str, Callable[[], list[Row]]] = {
    "viewers": crowd.viewers,
    "sixty": crowd.sixty,
    "four": crowd.four,
    "loops": hardship.loops,
    "memory": hardship.memory,
    "day": neighbours.day,
    "second": neighbours.second,
    "tune": neighbours.tune,
}
SHORT: Mapping[str, Callable[[], list[Row]]] = {
    **ROWS,
    "viewers": partial(crowd.viewers, 4.0, 40, 4),
    "sixty": partial(crowd.sixty, 6.0),
    "four": partial(crowd.four, 6.0),
    "loops": partial(hardship.loops, 5.0, ("worker", "publisher")),
    "memory": partial(hardship.memory, ("recorder",), console=False),
    "day": partial(neighbours.day, 8),
    "second": partial(neighbours.second, ("everything", "recording folder")),
}


def rows(wanted: Sequence[str] = (), short: bool = False) -> list[Row]:
    """In order; one that breaks is a row that did not hold."""
    out = []
    for name in wanted or ROWS:
        began = time.monotonic()
        try:
            found = (SHORT if short else ROWS)[name]()
        except Exception as error:  # must not cost the others their minutes
            found = [Row(name, "-", "runs", f"{type(error).__name__}: {' '.join(str(error).split())}", False)]
        for row in found:
            print(f"{name}: {row.what} | {row.measured} | {row.ok}", file=sys.stderr, flush=True)
        print(f"{name}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
        out += found
    return [*out, Row("load of the last minute, at the end", "-", "-", f"{os.getloadavg()[0]:.1f}")]


def main(arguments: Sequence[str]) -> int:
    wanted = [one for one in arguments if one != "--short"]
    if unknown := set(wanted) - ROWS.keys():
        print(f"no such row: {', '.join(sorted(unknown))}; there are {', '.join(ROWS)}", file=sys.stderr)
        return 2
    return 1 if any(row.ok is False for row in rows(wanted, "--short" in arguments)) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
