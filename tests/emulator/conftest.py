"""The image and the emulator, made once; a fresh powered board for every test."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from emulated import BOOTED, MS, ROUND_MAX, EmulatedBoard, end_idle, made_image, made_image_of

from annulus_pipe.flash.image import Application, application, read_image


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
def new(other: Path) -> Application:
    return application(read_image(other))


@pytest.fixture
def ours(image: Path) -> str:
    identity = read_image(image).identity
    assert identity is not None
    return identity.git


@pytest.fixture
def pair(image: Path, new: Application, ours: str) -> list[tuple[str, Application]]:
    """What runs, and what comes; each update turns them round."""
    return [(ours, application(read_image(image))), ("0therone", new)]


@pytest.fixture
def board(image: Path) -> Iterator[EmulatedBoard]:
    board = EmulatedBoard(image)
    board.run(BOOTED)
    yield board
    board.close()
    took, began = board.longest
    assert took <= ROUND_MAX, f"a round of {took / 100:.0f} us at {began / MS:.2f} ms, at most {ROUND_MAX / 100:.0f}"


@pytest.fixture(scope="module", autouse=True)
def emulators() -> Iterator[None]:
    """A process is one module's: what it cost is then known by that module."""
    yield
    end_idle()
