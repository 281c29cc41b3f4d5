"""What waits for a viewer: the newest picture, all points while it reads, and never more than so many bytes."""

import itertools
import time

import pytest

from annulus_pipe.console import wire
from annulus_pipe.console.hub import BACKLOG_MAX, WANTS, Hub, Viewer


def taken(viewer: Viewer) -> list[bytes]:
    return list(iter(viewer.take, None))


def started(*, wants: frozenset[str] = frozenset(WANTS)) -> Viewer:
    """One that has been told the cloud so far: there was none."""
    viewer = Viewer()
    viewer.want(wants)
    assert taken(viewer) == []
    return viewer


def test_of_pictures_only_the_newest_waits() -> None:
    hub, viewer = Hub(), started()
    hub.add(viewer)
    for number in range(100):
        hub.newest(("picture", number % 2), "pictures", b"%d" % number)
    assert sorted(taken(viewer)) == [b"98", b"99"]
    assert not viewer.ready.is_set()


def test_points_are_all_told_and_in_order_while_a_viewer_reads() -> None:
    viewer = started()
    for number in range(1000):
        viewer.tell("points", b"%04d" % number + bytes(45_000))
        if number % 50 == 49:  # two seconds of a scan
            assert [int(one[:4]) for one in taken(viewer)] == list(range(number - 49, number + 1))
    assert viewer.dropped == 0


def test_pictures_do_not_keep_points_waiting_nor_points_pictures() -> None:
    viewer = started()
    for number in range(10):
        viewer.tell("points", b"p%d" % number)
    order = []
    for number in range(20):
        viewer.newest("picture", "pictures", b"j%d" % number)
        order.append((viewer.take() or b"?")[:1])
    assert order.count(b"p") == order.count(b"j") == 10


def test_one_that_does_not_read_costs_bounded_memory_and_is_told_the_cloud_anew() -> None:
    told: list[frozenset[str]] = []

    def catch_up(what: frozenset[str]) -> "itertools.chain[bytes]":
        told.append(what)
        return itertools.chain([b"cloud"])

    viewer = Viewer(catch_up=catch_up)
    taken(viewer)
    viewer.tell("status", b"kept")
    most = 0
    for _ in range(1000):
        viewer.tell("points", bytes(45_000))
        most = max(most, viewer.backlog)
    assert most <= BACKLOG_MAX
    assert viewer.dropped == BACKLOG_MAX // 45_000 + 1  # what comes after is in the cloud when it is told
    assert taken(viewer) == [b"kept", b"cloud"]
    assert told == [frozenset({"points", "wall"})] * 2
    viewer.tell("points", b"again")
    assert taken(viewer) == [b"again"]


def test_status_alone_cannot_fill_the_memory_either() -> None:
    viewer = started()
    for _ in range(50):
        viewer.tell("status", bytes(1 << 20))
    for _ in range(10_000):
        viewer.tell("status", b"x")
    assert viewer.backlog <= BACKLOG_MAX
    assert len(taken(viewer)) <= 2001


def test_a_hidden_page_is_told_status_only_and_the_cloud_when_it_is_back() -> None:
    viewer = Viewer(catch_up=lambda what: iter([b"anew"] if "points" in what else []))
    assert taken(viewer) == [b"anew"]
    viewer.tell("points", b"old")
    viewer.newest("picture", "pictures", b"old")
    viewer.want(hidden=True)
    for what in WANTS:
        viewer.tell(what, what.encode())
        viewer.newest(what, what, what.encode())
    assert set(taken(viewer)) == {b"status"}
    viewer.want(hidden=False)
    assert taken(viewer) == [b"anew"]


def test_what_viewers_want_is_what_is_asked_of_the_daemon() -> None:
    hub, asked = Hub(), []
    hub.on_wants = asked.append
    one, other = started(), started(wants=frozenset({"points"}))
    for change in (lambda: hub.add(other), lambda: hub.add(one), lambda: hub.remove(one), lambda: hub.remove(other)):
        change()
    assert asked == [{"points", "status"}, set(WANTS), {"points", "status"}, set()]


def test_a_message_is_made_once_for_all_viewers() -> None:
    hub = Hub()
    viewers = [started() for _ in range(20)]
    for viewer in viewers:
        hub.add(viewer)
    hub.tell("state", {"state": "idle"})
    hub.newest("picture", "pictures", picture := wire.picture(0, 1, 5, None, 0.0, bytes(38_000)))
    messages = [taken(viewer) for viewer in viewers]
    assert all(one[0] is messages[0][0] and one[1] is messages[0][1] for one in messages)
    assert any(one is picture for one in messages[0])


@pytest.mark.parametrize("viewers", [64])
def test_a_second_of_a_scan_costs_many_viewers_little(viewers: int) -> None:
    hub = Hub()
    for _ in range(viewers):
        hub.add(started())
    begun = time.process_time()
    for _ in range(25):
        hub.newest("picture", "pictures", b"jpeg")
        hub.send("points", b"points")
        for viewer in hub.viewers:
            taken(viewer)
    assert time.process_time() - begun < 0.1
