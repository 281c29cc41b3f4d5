"""Promises of what a process of the daemon does for itself."""

import subprocess
import sys

TOLD = """
import gc
import annulus_pipe.daemon.run
from annulus_pipe.stream.working import leave_uncollected
before = len(gc.get_objects())
leave_uncollected()
print(before, gc.get_freeze_count(), len(gc.get_objects()))
"""


def test_what_is_there_from_the_beginning_is_not_looked_through_for_garbage_again() -> None:
    """It is some 100 000 objects, and took 40 to 96 ms in one go."""
    done = subprocess.run([sys.executable, "-c", TOLD], capture_output=True, text=True, check=True)
    before, frozen, left = (int(word) for word in done.stdout.split())
    assert before > 30_000 and frozen > 0.9 * before
    assert left < 100
