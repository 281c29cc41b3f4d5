"""Builds the core for this machine and runs its C tests, its coverage and its fuzzer. The build folder is the cache."""

import fcntl
import graphlib
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


@pytest.mark.deep(
    gate="tests/unit/firmware/test_firmware_builds.py::test_the_core_includes_nothing_of_a_board_but_board_h"
)
def test_every_promise_of_the_c_tests_holds_under_sanitizers_and_the_corpus_runs_clean() -> None:
    said = make("check")
    assert " 0 failures" in said
    assert " inputs" in said  # replay fails where a command is carried out by none of them


@pytest.mark.deep(
    gate="tests/unit/firmware/test_firmware_builds.py::test_the_core_includes_nothing_of_a_board_but_board_h"
)
@pytest.mark.skipif(not Path(GCOVR).is_file(), reason="gcovr is not installed")
def test_98_percent_of_the_cores_lines_run_and_95_of_its_branches_are_taken() -> None:
    make("coverage", f"GCOVR={GCOVR}", "LINES_MIN=98", "COVERAGE_MIN=95")
    summary = json.loads((FIRMWARE / "build/coverage/summary.json").read_text())
    assert summary["line_percent"] >= 98 and summary["branch_percent"] >= 95
    assert {Path(entry["filename"]).name for entry in summary["files"]} >= {"link.c", "sequencer.c", "safety.c"}


@pytest.mark.deep(
    gate="tests/unit/firmware/test_firmware_builds.py::test_the_core_includes_nothing_of_a_board_but_board_h"
)
@pytest.mark.skipif(not (shutil.which("clang-14") or shutil.which("clang")), reason="libFuzzer needs clang")
def test_a_short_fuzz_of_the_link_with_a_fixed_seed_finds_nothing(tmp_path: Path) -> None:
    make("build/fuzz")
    fuzzer = [str(FIRMWARE / "build/fuzz"), "-seed=1", "-runs=400", "-max_len=1024", "-timeout=20"]
    # A child counts its parent's memory as its own peak: what is bounded is what it asks for.
    fuzzer += ["-rss_limit_mb=0", "-malloc_limit_mb=256"]
    fuzzer += [f"-artifact_prefix={tmp_path}/", str(tmp_path), str(FIRMWARE / "fuzz/corpus")]
    run = subprocess.run(fuzzer, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr[-3000:]


def test_the_core_includes_nothing_of_a_board_but_board_h() -> None:
    allowed = {
        "stdbool.h",
        "stddef.h",
        "stdint.h",
        "string.h",
        "../application.h",
        "../board.h",
        "../duty.h",
        "../ticks.h",
    }
    own = {path.name for path in (FIRMWARE / "core").glob("*.h")}
    for path in (FIRMWARE / "core").glob("*.[ch]"):
        for line in path.read_text().splitlines():
            if line.startswith("#include"):
                assert line.split()[1].strip('<">') in allowed | own, f"{path.name}: {line}"
            assert "malloc" not in line


@pytest.mark.parametrize(("board", "prefix"), [("native", ""), ("rp2040", "arm-none-eabi-")])
def test_no_file_needs_one_that_needs_it(board: str, prefix: str, tmp_path: Path) -> None:
    """By what the linker sees, so no header hides it: core on either board is a graph without circles."""
    if shutil.which(f"{prefix}gcc") is None:
        pytest.skip(f"{prefix}gcc is not installed")
    cpu = ["-mcpu=cortex-m0plus", "-mthumb", "-ffreestanding", "-Irp2040/libc", f"-I{board}"] if prefix else []
    defines: dict[str, str] = {}
    needs: dict[str, set[str]] = {}
    for source in sorted([*FIRMWARE.glob("core/*.c"), *FIRMWARE.glob(f"{board}/*.c")]):
        name = f"{source.parent.name}/{source.name}"
        made = tmp_path / f"{source.stem}.o"
        command = [f"{prefix}gcc", "-std=c11", *cpu, "-Icore", '-DANNULUS_VERSION=""', '-DANNULUS_GIT=""', "-c"]
        subprocess.run([*command, name, "-o", str(made)], cwd=FIRMWARE, check=True)
        nm = subprocess.run([f"{prefix}nm", made], capture_output=True, text=True, check=True)
        words = [line.split()[-2:] for line in nm.stdout.splitlines()]
        defines |= {symbol: name for kind, symbol in words if kind in "TDBRC"}
        needs[name] = {symbol for kind, symbol in words if kind == "U"}
    graph = {name: {defines[s] for s in symbols & defines.keys()} - {name} for name, symbols in needs.items()}
    assert sum(map(len, graph.values())) > 40  # it was found at all
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))
