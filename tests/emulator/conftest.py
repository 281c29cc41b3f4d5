"""The image and the emulator, made once; a fresh powered board for every test."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from emulated import BOOTED, EMULATOR, IMAGE, ROOT, EmulatedBoard


@pytest.fixture(scope="session")
def image() -> Path:
    """ANNULUS_IMAGE, when another image is to be judged by these tests, as tools/mutants.py does."""
    given = os.environ.get("ANNULUS_IMAGE")
    for tool, package in (("node", "nodejs"), ("arm-none-eabi-gcc", "gcc-arm-none-eabi")):
        if shutil.which(tool) is None and not (given and tool != "node"):
            pytest.fail(f"{tool} is missing: Debian's {package}, which `make test` installs")
    if not (EMULATOR.parent / "node_modules/rp2040js").is_dir():
        subprocess.run(["npm", "ci", "--silent", "--no-audit", "--no-fund"], cwd=EMULATOR.parent, check=True)
    if given:
        return Path(given)
    subprocess.run(["make", "--silent", "-C", str(ROOT / "firmware"), "image"], check=True, stdout=subprocess.DEVNULL)
    return IMAGE


@pytest.fixture
def board(image: Path) -> Iterator[EmulatedBoard]:
    board = EmulatedBoard(image)
    board.run(BOOTED)
    yield board
    board.close()
