"""Builds the core for this machine and runs its C tests, its coverage and its fuzzer. The build folder is the cache."""

import fcntl
import json
import shutil
import subprocess
from pathlib import Path

import pytest

FIRMWARE = Path(__file__).resolve().parents[3] / "firmware"
GCOVR = shutil.which("gcovr") or str(FIRMWARE.parent / ".venv/bin/gcovr")


def make(*arguments: str) -> str:
    command = ["make", "-C", str(FIRMWARE), "--no-print-directory", *arguments]
    (FIRMWARE / "build").mkdir(exist_ok=True)
    with (FIRMWARE / "build/.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # two test runs in one tree share the cache, coverage counters included
        run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


def test_every_promise_of_the_c_tests_holds_under_sanitizers_and_the_corpus_runs_clean() -> None:
    said = make("check")
    assert " 0 failures" in said
    assert " inputs" in said


@pytest.mark.skipif(not Path(GCOVR).is_file(), reason="gcovr is not installed")
def test_95_percent_of_the_cores_branches_are_taken() -> None:
    make("coverage", f"GCOVR={GCOVR}", "COVERAGE_MIN=95")
    summary = json.loads((FIRMWARE / "build/coverage/summary.json").read_text())
    assert summary["branch_percent"] >= 95
    assert {Path(entry["filename"]).name for entry in summary["files"]} >= {"link.c", "sequencer.c", "safety.c"}


@pytest.mark.skipif(not (shutil.which("clang-14") or shutil.which("clang")), reason="libFuzzer needs clang")
def test_a_short_fuzz_of_the_link_with_a_fixed_seed_finds_nothing(tmp_path: Path) -> None:
    make("build/fuzz")
    fuzzer = [str(FIRMWARE / "build/fuzz"), "-seed=1", "-runs=400", "-max_len=1024", "-timeout=20"]
    fuzzer += [f"-artifact_prefix={tmp_path}/", str(tmp_path), str(FIRMWARE / "fuzz/corpus")]
    run = subprocess.run(fuzzer, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr[-3000:]


def test_the_core_includes_nothing_of_a_board_but_board_h() -> None:
    allowed = {"stdbool.h", "stddef.h", "stdint.h", "string.h", "../board.h"}
    own = {path.name for path in (FIRMWARE / "core").glob("*.h")}
    for path in (FIRMWARE / "core").glob("*.[ch]"):
        for line in path.read_text().splitlines():
            if line.startswith("#include"):
                assert line.split()[1].strip('<">') in allowed | own, f"{path.name}: {line}"
            assert "malloc" not in line
