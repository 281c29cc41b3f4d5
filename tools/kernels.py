"""All loops that a head's method and its survey need, compiled once, before several test processes would each do it.

python -m tools.kernels        nothing to do where they are compiled: they are kept by what they are made of
"""

import sys
from pathlib import Path

from annulus_pipe.reprocess import ahead
from annulus_pipe.storage.calibration_file import load_calibration

DATA = Path(__file__).resolve().parents[1] / "tests/data"


def main() -> int:
    for name in ("calibration-1.json", "calibration-2.json"):
        ahead.make_ready(load_calibration(DATA / name), print)
    return 0


if __name__ == "__main__":
    sys.exit(main())
