"""The bench a self-test is run at: a person who moves a wire, or a simulated head that moves its own."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer

from annulus_pipe.selftest.run import BEFORE_IT_BEGINS, MoveWire, WireGoes
from annulus_pipe.vocabulary import AnnulusError

SIMULATED = ("native://", "emulated://")
STEP_TO_SYNC, GATE_TO_INTERLOCK = (8, 2), (5, 7)


@contextmanager
def at_the_bench(port: str, yes: bool) -> Iterator[tuple[str, MoveWire]]:
    """A port on which every output may fire, and what moves the wire. AnnulusError when nobody confirms that."""
    if port in SIMULATED:
        from annulus_pipe.testing.heads import SimulatedHead

        with SimulatedHead(port.removesuffix("://"), wires=(STEP_TO_SYNC,)) as head:

            def move(wire: WireGoes) -> bool:
                head.interlock(is_open=wire is WireGoes.OFF)
                if wire is WireGoes.TO_GATE:
                    head.wire(STEP_TO_SYNC, GATE_TO_INTERLOCK)
                head.run(0.001)
                return True

            yield head.url, move
        return
    print(BEFORE_IT_BEGINS, file=sys.stderr)
    if not yes and not _agrees("Is that so?"):
        raise AnnulusError("nothing was done, expected somebody who says that everything is unplugged")
    yield port, lambda wire: not yes and _agrees(f"{wire} Done?")


def _agrees(question: str) -> bool:
    return sys.stdin.isatty() and typer.confirm(question, err=True)
