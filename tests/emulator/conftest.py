"""The image and the emulator, made once; a fresh powered board for every test."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from emulated import BOOTED, EmulatedBoard, made_image


@pytest.fixture(scope="session")
def image() -> Path:
    return made_image()


@pytest.fixture
def board(image: Path) -> Iterator[EmulatedBoard]:
    board = EmulatedBoard(image)
    board.run(BOOTED)
    yield board
    board.close()
