"""On a line whose answers took 30 ms edges were placed in time by a clock coarser than the labels' window (e45d243).
Fails without the bound on the clock's error in HeadControl's placing of edges."""

from annulus_pipe.link.head import EdgeSeen, HeadControl
from annulus_pipe.link.messages import Edge, Stage
from annulus_pipe.testing.scripted import ScriptedController
from annulus_pipe.vocabulary import EdgeFlag, Lamp

MS = 1_000_000
STAGE = Stage(1, 4, 4_000_000, 3_800_000, 2_800_000, 50, 0, 450_000, 500_000, 575_000, 250_000)


def test_on_a_line_slower_than_the_labels_need_no_edge_is_placed() -> None:
    head, controller, now = HeadControl(STAGE), ScriptedController(), 10**12
    heard: list[object] = []
    for number in range(40):
        controller.receive(head.pending(now), now)
        now += 30 * MS  # every answer takes that long
        tick = (now - (controller.tick_origin_ns or 0)) // 10
        controller.emit(Edge(number, tick, number % 5, Lamp.PROJECTOR, 450_000, 500_000, 0, 1, EdgeFlag(0)))
        heard += head.receive(controller.take(), now)
    assert head.clock.locked and head.edges_unplaced > 20
    assert not [news for news in heard if isinstance(news, EdgeSeen)]
