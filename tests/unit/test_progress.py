"""Promise: whoever starts annulus as a child hears how far it is."""

import json

import pytest

from annulus_pipe.cli.show import Bars, progress


def test_a_program_hears_of_progress_a_line_at_a_time_and_not_of_every_step(capsys: pytest.CaptureFixture[str]) -> None:
    with progress(Bars.JSON) as report:
        for done in range(1001):
            report("frames", done, 1000)
        report("texture", 3, 3)
    out, error = capsys.readouterr()
    said = [json.loads(line) for line in error.splitlines()]
    assert out == ""
    assert said[0] == {"what": "frames", "done": 0, "total": 1000}
    assert said[-2:] == [{"what": "frames", "done": 1000, "total": 1000}, {"what": "texture", "done": 3, "total": 3}]
    assert len(said) < 20
