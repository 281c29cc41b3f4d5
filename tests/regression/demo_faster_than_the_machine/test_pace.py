"""`annulus console --demo` ran at 10 fps on any machine: on a busy one of two cores nobody ever saw a picture."""

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import annulus_pipe.console.demo
import annulus_pipe.console.serving
from annulus_pipe.cli import main


@pytest.mark.parametrize("typed, begun", [([], 3.5), (["--fps", "7"], 7.0)])
def test_the_page_of_a_simulated_head_runs_at_a_rate_that_holds(
    tmp_path: Path, typed: list[str], begun: float, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    rates: list[float] = []

    @contextlib.contextmanager
    def simulated(out: Path, fps: float) -> Iterator[tuple[str, str]]:
        rates.append(fps)
        yield "tcp://127.0.0.1:5601", "tcp://127.0.0.1:5602"

    for name, parts in {  # of modules that take seconds to import, and are not asked for more
        "annulus_pipe.demo": {"measure_pace": lambda world: SimpleNamespace(fps=3.5, why="what 2 cores hold")},
        "annulus_pipe.twin.worlds": {"demo_world": lambda: SimpleNamespace(calibration=lambda: None)},
    }.items():
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(**parts))
    monkeypatch.setattr(annulus_pipe.console.demo, "simulated", simulated)
    monkeypatch.setattr(annulus_pipe.console.serving, "serve", lambda program: None)
    monkeypatch.setattr("sys.argv", ["annulus", "console", "--demo", "-o", str(tmp_path), *typed])
    with contextlib.suppress(SystemExit):
        main()
    assert rates == [begun]
    assert ("what 2 cores hold" in capsys.readouterr().err) == (not typed)
