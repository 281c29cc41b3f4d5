"""A command that failed before its first step of work printed an empty progress bar above its one line (b3be5c1). Fails
when the bar starts before anything is reported."""

import pytest

from annulus_pipe.cli.show import progress


def test_work_that_never_began_shows_no_bar(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="bad input"), progress():
        raise ValueError("bad input")
    said = capsys.readouterr()
    assert said.out == said.err == ""
