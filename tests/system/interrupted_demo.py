"""The demo with a quarter-size camera, so that it runs as it does for a user, only faster. For test_interrupt.py."""

import sys
from pathlib import Path

from annulus_pipe.demo import run_demo
from annulus_pipe.twin.worlds import demo_world

if __name__ == "__main__":
    try:
        run_demo(float(sys.argv[2]), Path(sys.argv[1]), False, world=demo_world(travel_mm=330.0).scaled(416))
    except KeyboardInterrupt:
        sys.exit(130)
