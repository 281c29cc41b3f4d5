"""The image and the emulator, made once; a fresh powered board for every test."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from emulated import BOOTED, EmulatedBoard, end_idle, made_image, made_image_of


@pytest.fixture(scope="session")
def image() -> Path:
    return made_image()


@pytest.fixture(scope="session")
def other(image: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_image_of(image, tmp_path_factory.mktemp("other"), "0therone")


@pytest.fixture(scope="session")
def third(image: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_image_of(image, tmp_path_factory.mktemp("third"), "athird00")


@pytest.fixture
def board(image: Path) -> Iterator[EmulatedBoard]:
    board = EmulatedBoard(image)
    board.run(BOOTED)
    yield board
    board.close()


@pytest.fixture(scope="module", autouse=True)
def emulators() -> Iterator[None]:
    """A process is one module's: what it cost is then known by that module."""
    yield
    end_idle()
