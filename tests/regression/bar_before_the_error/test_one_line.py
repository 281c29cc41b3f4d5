"""A command that failed before its first step of work printed an empty progress bar below or above its one line
(b3be5c1). Fails when the bar starts before anything is reported."""

import sys
from pathlib import Path

import pytest

from annulus.cli import main


def test_bad_input_is_one_line_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["annulus", "reconstruct", str(tmp_path / "nothing"), "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    assert ended.value.code != 0 and said.out == ""
    (line,) = said.err.splitlines()
    assert line.startswith("annulus: ") and "no such scan" in line
