"""Puts named faults into copies of the firmware, builds each, and expects the emulator's tests to catch every one.

python tools/mutants.py [NAME ..]        needs what `make test` installs; about 10 s a mutant
"""

import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True, slots=True)
class Mutant:
    """One line of the firmware gone wrong. `tests`: the pytest expression that should notice, kept narrow for speed."""

    name: str
    file: str
    right: str
    wrong: str
    tests: str


MUTANTS = tuple(Mutant(**entry) for entry in tomllib.loads((ROOT / "tools/mutants.toml").read_text())["mutant"])


def judge(mutant: Mutant, scratch: Path) -> str:
    """'caught', or what went wrong with the experiment or, worst, 'SURVIVED'."""
    firmware = scratch / mutant.name
    shutil.copytree(ROOT / "firmware", firmware, ignore=shutil.ignore_patterns("build", "corpus"))
    source = firmware / mutant.file
    text = source.read_text()
    if text.count(mutant.right) == 0:
        return "STALE: the line it changes is gone"
    source.write_text(text.replace(mutant.right, mutant.wrong))
    build = subprocess.run(
        ["make", "--silent", "-C", str(firmware), "image", "GIT=mutant00", "BUILD=build"],
        capture_output=True,
        text=True,
    )
    if build.returncode != 0:
        return "NOT BUILT: " + build.stderr.splitlines()[0]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-x", "-q", "--timeout", "120", "tests/emulator", "-k", mutant.tests],
        cwd=ROOT,
        env=os.environ | {"ANNULUS_IMAGE": str(firmware / "build/annulus.uf2")},
        capture_output=True,
        text=True,
    )
    return {0: "SURVIVED", 1: "caught"}.get(run.returncode, f"NO TEST RAN: {run.stdout.splitlines()[-1:]}")


def main(names: list[str]) -> int:
    chosen = [mutant for mutant in MUTANTS if not names or mutant.name in names]
    with tempfile.TemporaryDirectory() as scratch:
        verdicts = []
        for mutant in chosen:
            verdicts.append(judge(mutant, Path(scratch)))
            print(f"{mutant.name:32} {verdicts[-1]}", flush=True)
    caught = verdicts.count("caught")
    print(f"{caught} of {len(chosen)} mutants caught")
    return 0 if chosen and caught == len(chosen) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
