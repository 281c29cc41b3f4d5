"""A wheel in an environment of its own, without compiler, make or the source: all that is no Python is in it.

What it depends on is lent by the environment of the tests; annulus itself comes from the wheel.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from annulus_pipe.numeric.native import LEVELS, level
from annulus_pipe.shipped import LOOPS, UNIT, shipped
from tools.wheel.hook import GLIBC, MACHINES, glibc_needed, libraries

LEVELS_OF = {
    machine: [name for level, name in LEVELS.items() if (level == 0) == (machine == "aarch64")] for machine in MACHINES
}

pytestmark = pytest.mark.deep(
    gate="tests/unit/test_extras.py::test_every_room_and_command_is_imported_without_any_extra"
)

ROOT = Path(__file__).resolve().parents[2]
Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(out)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (made,) = out.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def annulus(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs the installed command, with nothing in its PATH but itself, at home in an empty folder."""
    folder = tmp_path_factory.mktemp("field")
    subprocess.run([sys.executable, "-m", "venv", "venv"], cwd=folder, check=True)
    install = [folder / "venv/bin/pip", "install", "--quiet", "--no-index", "--no-deps", wheel]
    subprocess.run(install, check=True)
    packages = next((folder / "venv/lib").glob("python*/site-packages"))
    (packages / "lent.pth").write_text(sysconfig.get_path("purelib") + "\n")  # whose own .pth files are not looked at
    (folder / "home").mkdir()

    def run(*words: str) -> "subprocess.CompletedProcess[str]":
        environment = {"PATH": str(folder / "venv/bin"), "HOME": str(folder / "home"), "LANG": "C.UTF-8"}
        command = [folder / "venv/bin/annulus", *words]
        return subprocess.run(
            command, cwd=folder / "home", env=environment, capture_output=True, text=True, timeout=120, check=False
        )

    return run


def test_it_holds_what_a_head_needs_and_no_source_of_what_it_is_made_of(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    shipped_files = (
        "libannulus_native.so",
        *(f"{LOOPS}{level}.so" for level in LEVELS_OF[platform.machine()]),
        "annulus.uf2",
        "annulus-rp2350.uf2",
        "99-annulus.rules",
        "annulus.service",
        "build.json",
    )
    assert {f"annulus_pipe/shipped/{name}" for name in shipped_files} <= names
    assert {
        "annulus_pipe/report/page.html.j2",
        "annulus_pipe/report/style.css",
        "annulus_pipe/selftest/page.html.j2",
    } <= names
    others = {name for name in names if not name.startswith(("annulus_pipe/", "annulus_pipe-"))}
    assert not others
    assert not [name for name in names if name.endswith((".c", ".h", ".mjs", ".nbi", ".nbc", ".pyc", ".elf"))]
    assert not [name for name in names if Path(name).name.startswith(("test_", "conftest"))]
    assert wheel.name.endswith(f"-py3-none-manylinux_2_17_{platform.machine()}.whl")


@pytest.mark.parametrize("machine", MACHINES)
def test_the_library_runs_where_glibc_is_of_2_17(machine: str, tmp_path: Path) -> None:
    made = libraries(ROOT, machine, tmp_path)
    assert [one.name for one in made] == [
        "libannulus_native.so",
        *(f"loops-{level}.so" for level in LEVELS_OF[machine]),
    ]
    for library in made:
        assert (2, 0) < glibc_needed(library) <= GLIBC
        head = library.read_bytes()[:20]
        assert (head[:4], head[18]) == (b"\x7fELF", {"x86_64": 62, "aarch64": 183}[machine])


def test_it_says_which_commit_it_is_and_so_does_its_image(annulus: Run) -> None:
    commit = subprocess.run(["git", "rev-parse", "--short=8", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    assert commit.stdout.strip() in annulus("--version").stdout
    info = annulus("firmware", "info", "--json")
    assert info.returncode == 0, info.stderr
    image = json.loads(info.stdout)
    assert image["git"] == commit.stdout.strip()


def test_flashing_gets_as_far_as_the_board_that_is_not_there(annulus: Run) -> None:
    flash = annulus("firmware", "flash")
    assert flash.returncode == 1
    assert flash.stderr.count("\n") == 1
    assert "board" in flash.stderr and "missing" not in flash.stderr


def test_the_firmwares_own_code_runs_in_virtual_time(annulus: Run) -> None:
    test = annulus("head", "selftest", "--port", "native://", "--yes", "--edges", "20", "--json")
    assert test.returncode == 0, test.stderr
    assert json.loads(test.stdout)


def test_what_only_a_checkout_has_is_one_line(annulus: Run) -> None:
    emulated = annulus("head", "selftest", "--port", "emulated://", "--yes")
    assert emulated.returncode == 1
    assert "Run it in a checkout" in emulated.stderr or "node: not found" in emulated.stderr
    assert emulated.stderr.count("\n") == 1


def test_a_scan_is_drawn_and_measured(annulus: Run) -> None:
    """The loops, with no compiler to be found and none to wait for."""
    drawn = annulus("twin", "scan", "--world", "clean", "--frames", "10", "-o", "scan")
    assert drawn.returncode == 0, drawn.stderr
    done = annulus("reconstruct", "scan", "--calibration", "scan/calibration.json", "--workers", "1", "-o", "results")
    assert done.returncode == 0, done.stderr
    assert "report.html" in done.stdout


def test_doctor_says_what_is_installed_and_where_the_rule_is(annulus: Run) -> None:
    where = Path(annulus("doctor", "--where").stdout.strip())
    assert (where / "99-annulus.rules").is_file() and (where / "annulus.service").is_file()
    said = annulus("doctor", "--json")
    rows = {row["what"]: row for row in json.loads(said.stdout)}
    assert (said.returncode == 1) == any(row["ok"] is False for row in rows.values())
    assert rows["annulus"]["ok"] and rows["simulation"]["ok"] and rows["image"]["ok"]
    assert rows["loops"]["ok"] and level() in rows["loops"]["text"]


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_takes_the_unit(tmp_path: Path) -> None:
    text = shipped(UNIT).read_text()
    assert "ExecStart=/opt/annulus/bin/annulus daemon --config /etc/annulus/head.toml\n" in text
    unit = tmp_path / UNIT
    unit.write_text(text.replace("/opt/annulus/bin/annulus", "/bin/true"))
    verify = ["systemd-analyze", "verify", "--man=no", str(unit)]
    verified = subprocess.run(verify, capture_output=True, text=True, env=os.environ, check=False)
    assert (verified.returncode, verified.stderr) == (0, "")
