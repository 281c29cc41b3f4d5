"""A head that had met a controller of another schema never asked again, though it was flashed meanwhile (05b16e0).
Fails without identify being sent in phase MISMATCH."""

from annulus_pipe.link.head import HeadControl
from annulus_pipe.link.messages import SCHEMA_HASH, Stage
from annulus_pipe.link.phase import Phase
from annulus_pipe.testing.scripted import ScriptedController

MS = 1_000_000
STAGE = Stage(1, 4, 4_000_000, 3_800_000, 2_800_000, 50, 0, 450_000, 500_000, 575_000, 250_000)


def test_a_controller_flashed_while_the_host_runs_is_armed() -> None:
    head, controller, now = HeadControl(STAGE), ScriptedController(schema=0x0BADF00D), 10**12
    for millisecond in range(1300):
        if millisecond == 200:
            assert head.phase is Phase.MISMATCH
            controller.schema = SCHEMA_HASH
        now += MS
        controller.receive(head.pending(now), now)
        head.receive(controller.take(), now)
    assert head.phase is Phase.RUNNING and controller.armed
