from collections.abc import Callable
from pathlib import Path

import pytest
from results_folder import write_folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path / "results")


@pytest.fixture
def written(folder: Path) -> Callable[[str], Path]:
    """Write one form of the folder and give its file."""
    from annulus_pipe.export import FORMS, open_results, write

    def one(name: str) -> Path:
        files = write(open_results(folder), [name], folder / "export")
        return next(file for file in files if file.name == FORMS[name].file)

    return one


@pytest.fixture
def large(tmp_path: Path) -> Path:
    return write_folder(tmp_path / "large", points=1_000_000)
