"""Promises of scenes kept between runs: the same as drawn anew, and never those of other arguments."""

from pathlib import Path

import numpy as np
import pytest

from tests import kept


@pytest.fixture(autouse=True)
def shelf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "_shelf", lambda: tmp_path)


def test_a_picture_is_drawn_once_for_what_it_is_made_of() -> None:
    drawn: list[int] = []

    def draw(seed: int) -> kept.NDArray[np.uint8]:
        drawn.append(seed)
        return np.full((2, 3), seed, np.uint8)

    for seed in (1, 2, 1, 2):
        assert (kept.picture(lambda seed=seed: draw(seed), "a picture", seed) == seed).all()  # type: ignore[misc]
    assert drawn == [1, 2]


def test_what_has_a_function_in_it_is_drawn_each_time() -> None:
    """A function of one name may be another tomorrow."""
    drawn = []
    for _ in range(2):
        kept.picture(lambda: drawn.append(1) or np.zeros((1, 1), np.uint8), lambda x: x)  # type: ignore[func-returns-value]
    assert len(drawn) == 2


def test_a_kept_folder_may_be_changed_by_who_took_it(tmp_path: Path) -> None:
    def write(folder: Path) -> None:
        folder.mkdir()
        (folder / "frames.csv").write_text("whole")

    for name in ("one", "two"):
        kept.folder(write, tmp_path / name, "a scan")
        assert (tmp_path / name / "frames.csv").read_text() == "whole"
        (tmp_path / name / "frames.csv").write_text("changed")


def test_a_change_of_anything_that_a_drawer_uses_is_another_shelf(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A twin's slide is drawn by fringe/, which lies in no room of the twin's own."""
    used = tmp_path / "host/annulus_pipe/wings/fringe/measure/projector.py"
    used.parent.mkdir(parents=True)
    used.write_text("PHASE0 = 0.0\n")
    monkeypatch.setattr(kept, "ROOT", tmp_path)
    before = kept._digest()
    used.write_text("PHASE0 = 1.0\n")
    assert kept._digest() != before
