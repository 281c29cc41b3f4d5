"""Loops that stop at the first load or store outside of a table, at a number that does not fit, at whatever C leaves
undefined: silent in real work, on frames that no pipe shows, and with tables that hold anything."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from recorded import NATIVE, differing_on
from small_work import hostile_calls, real_calls

ROOT = Path(__file__).resolve().parents[3]
# The loops are built anew for it: half a minute. The gate tries the same tables on the usual library.
pytestmark = pytest.mark.deep(
    gate="tests/unit/rings/test_hostile.py::test_whatever_tables_hold_no_other_memory_is_touched"
)
SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


@pytest.fixture(scope="module")
def build() -> Path:
    subprocess.run(["make", "--silent", "-C", str(NATIVE), "sanitized"], check=True)
    return NATIVE / "build"


def test_no_call_leaves_its_tables(build: Path, tmp_path: Path) -> None:
    """By a program in which every array is allocated by itself; what it writes is what the usual loops wrote."""
    calls = [*real_calls(), *hostile_calls(1, 0.5)]
    objects = sorted(str(path) for path in (build / "sanitized").glob("*.o"))
    assert differing_on(calls, tmp_path, ["gcc", "-O1", "-g", *SANITIZE, *objects], []) == []


def test_a_store_outside_of_a_table_is_noticed(build: Path, tmp_path: Path) -> None:
    """A table that is a byte too small for what is filled to its end."""
    call = next(call for call in real_calls() if call.name == "rings_sample")
    short = [block._replace(before=block.before[:-1], after=block.after[:-1]) for block in call.blocks]
    objects = sorted(str(path) for path in (build / "sanitized").glob("*.o"))
    with pytest.raises(AssertionError, match="heap-buffer-overflow"):
        differing_on([call._replace(blocks=short)], tmp_path, ["gcc", "-O1", "-g", *SANITIZE, *objects], [])


@pytest.mark.timeout(1500)  # ten minutes beside other work
@pytest.mark.parametrize(
    "tests", [["tests/unit/rings/test_hostile.py"], sorted(str(path) for path in ROOT.glob("tests/**/test_*_in_c.py"))]
)
def test_the_library_itself_is_silent_in_python(build: Path, tests: list[str]) -> None:
    asked = ["gcc", "-print-file-name=libasan.so", "-print-file-name=libstdc++.so.6"]  # what C++ throws, it has to know
    before = [subprocess.run([asked[0], one], capture_output=True, text=True, check=True).stdout for one in asked[1:]]
    loops = {"ANNULUS_LOOPS": str(build / "loops-sanitized.so"), "ANNULUS_EXAMPLES": "100"}
    loops["LD_PRELOAD"] = " ".join(one.strip() for one in before)
    running = [sys.executable, "-m", "pytest", "-q", "-s", "-p", "no:cacheprovider", *tests]
    environment = os.environ | loops | {"ASAN_OPTIONS": "detect_leaks=0"}
    done = subprocess.run(running, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
