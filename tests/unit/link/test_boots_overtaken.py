"""A status that overtakes the edges it counts is no other boot: seen as a needless re-arming on the emulated image."""

from annulus_pipe.link.boots import BootWatch


def test_a_status_may_overtake_the_edges_it_counts() -> None:
    watch = BootWatch()
    assert watch.edge(101, recovered=False) == ""
    assert watch.status(103) == ""
    assert watch.edge(102, recovered=False) == ""
    assert watch.status(103) == ""
    assert watch.edge(103, recovered=False) == ""
    assert watch.status(5) != ""


def test_an_edge_told_before_is_another_boot() -> None:
    watch = BootWatch()
    assert watch.edge(7, recovered=False) == ""
    assert watch.edge(0, recovered=False) != ""
