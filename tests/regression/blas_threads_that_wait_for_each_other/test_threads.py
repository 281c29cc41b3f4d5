"""`annulus reconstruct` of a plain pipe that undulates took 19 s of processor where one thread takes 4: BLAS lit a
thread a core for matrices of twenty rows, and they waited for each other. Fails without what annulus/__init__ sets."""

import os
import subprocess
import sys

import pytest

COUNT = (
    "import annulus_pipe, numpy as np, os; a = np.ones((600, 600)); a @ a; print(len(os.listdir('/proc/self/task')))"
)


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core has one thread")
def test_small_matrices_are_one_threads_work() -> None:
    bare = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", COUNT], env=bare, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"
    asked = subprocess.run(
        [sys.executable, "-c", COUNT],
        env=bare | {"OPENBLAS_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=True,
    )  # who says otherwise is heard
    assert asked.stdout.strip() == "2"
