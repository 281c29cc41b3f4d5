"""pytest's way to the heads: fixtures `head`, `scripted_head` and `faulty_head`. Loaded in every run of pytest where
annulus is installed, so nothing is imported before a test asks for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from annulus_pipe.testing.heads import ScriptedHead, SimulatedHead


@pytest.fixture
def head() -> Iterator[SimulatedHead]:
    """The real firmware on the native board, in virtual time: `head.url` opens with pyserial (annulus_pipe.testing)."""
    from annulus_pipe.testing.heads import SimulatedHead

    with SimulatedHead() as head:
        yield head


@pytest.fixture
def scripted_head() -> Iterator[ScriptedHead]:
    """A controller without physics that answers what you tell it; `scripted_head.controller` is the script."""
    from annulus_pipe.testing.heads import ScriptedHead

    head = ScriptedHead()
    yield head
    head.close()


@pytest.fixture
def faulty_head() -> Iterator[Callable[..., SimulatedHead]]:
    """A head on a bad line: `faulty_head("rough", seed=3)`, or with a Faults of your own. The last one made counts."""
    from annulus_pipe.testing.heads import SimulatedHead
    from annulus_pipe.twin.faults import Faults

    made: list[SimulatedHead] = []

    def make(faults: Faults | str = "rough", seed: int = 0, *, camera_fps: float = 25.0) -> SimulatedHead:
        made.append(SimulatedHead(faults=faults, seed=seed, camera_fps=camera_fps))
        return made[-1]

    yield make
    for head in made:
        head.close()
