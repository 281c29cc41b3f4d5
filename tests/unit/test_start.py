"""What a command, a refusal or a worker imports before it does anything: seconds of processor, of every process."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.reprocess.executors import Processes
from annulus_pipe.storage.calibration_file import save_calibration
from annulus_pipe.twin.worlds.pipes import demo_world

HEAVY = {"scipy", "matplotlib", "mpl_toolkits", "PIL", "jinja2", "google", "mcap", "rich", "pyarrow", "duckdb"}
TYPED = """
import sys
from annulus_pipe.cli import main
sys.argv = ["annulus", *sys.argv[1:]]
try:
    main()
finally:
    print("\\n" + " ".join(sys.modules), file=sys.stderr)
"""


def imported(*words: str) -> tuple[str, set[str]]:
    """What a command says, and what it had imported when it ended: packages, and modules by their whole names."""
    done = subprocess.run([sys.executable, "-c", TYPED, *words], capture_output=True, text=True, check=False)
    *errors, modules = done.stderr.splitlines()
    whole = modules.split()
    return done.stdout + "\n".join(errors), {*whole, *(name.partition(".")[0] for name in whole)}


@pytest.mark.parametrize("words", [["--help"], ["record", "--help"], ["timing", "--nonsense"]])
def test_what_is_known_without_numbers_imports_none(words: list[str]) -> None:
    _, packages = imported(*words)
    assert "typer" in packages and not packages & {*HEAVY, "numpy", "cv2"}


@pytest.mark.parametrize(
    "words, expected",
    [
        (["reconstruct", "{}/none", "-o", "{}/out"], "no such scan"),
        (["reconstruct", "{}", "--calibration", "{}/none.json", "-o", "{}/out"], "no such file"),
        (["record", "info", "{}/none.mcap"], "No such file"),
        (["daemon", "--config", "{}/none.toml"], "expected a head.toml"),
        (["calibrate", "camera", "{}/none", "-o", "{}/head.json"], "no such file"),
    ],
)
def test_a_refusal_imports_nothing_that_only_the_work_needs(words: list[str], expected: str, tmp_path: Path) -> None:
    printed, packages = imported(*(word.format(tmp_path) for word in words))
    assert expected.lower() in printed.lower() and not packages & HEAVY


@pytest.mark.parametrize(
    "command, late",
    [
        ("reconstruct", {"annulus_pipe.wall.survey", "annulus_pipe.reprocess.engine", "annulus_pipe.report"}),
        ("reprocess", {"annulus_pipe.reprocess.engine"}),  # makes its folder before it opens any of many scans
    ],
)
def test_pictures_of_another_size_are_refused_before_the_work_is_imported(
    command: str, late: set[str], tmp_path: Path
) -> None:
    head, scan = tmp_path / "head.json", tmp_path / "scan"
    save_calibration(head, demo_world().calibration())
    scan.mkdir()
    (scan / "0.png").write_bytes(cv2.imencode(".png", np.zeros((30, 40, 3), np.uint8))[1].tobytes())
    (scan / "frames.csv").write_text("index,file,light,z_mm\n0,0.png,projector,0\n")
    printed, modules = imported(command, str(scan), "--calibration", str(head), "-o", str(tmp_path / "out"))
    assert "0.png is 40x30" in printed
    assert not modules & HEAVY and not modules & late


@dataclass(frozen=True)
class Modules:
    """Work: which packages the worker has imported."""

    def ready(self) -> Callable[[str], set[str]]:
        __import__("annulus_pipe.reprocess.ranges")  # what measures a range
        return lambda _: set(sys.modules)


def test_workers_import_neither_scipy_nor_what_draws() -> None:
    for _, modules in Processes(1, apart=True)(Modules(), ["one"]):
        assert not {name.partition(".")[0] for name in modules} & HEAVY
        assert "annulus_pipe.rings.reconstructor" in modules and "annulus_pipe.wall.survey" not in modules
    code = "import sys, annulus_pipe.daemon.worker; print(*sys.modules)"
    live = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {name.partition(".")[0] for name in live} & HEAVY and "annulus_pipe.wall.survey" not in live
