"""What is known of the head now: passed on, kept for who comes later, begun anew where it must be."""

import struct
from types import SimpleNamespace
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq
from browsing import status
from fake_daemon import RADIUS_MM, profile, wall_rows
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.console import feed, wire
from annulus_pipe.console.feed import Feed
from annulus_pipe.console.hub import Hub, Viewer
from annulus_pipe.console.live import POINTS_MAX, Live
from annulus_pipe.numeric.palette import deviation_table
from annulus_pipe.report.paper import DEVIATION
from annulus_pipe.wall import profile as wall_profile


class Head:
    """A daemon's words, said straight to Live; and one viewer."""

    def __init__(self) -> None:
        self.feed = Feed(zmq.Context.instance(), "inproc://nobody")
        self.live = Live(self.feed, Hub())
        self.numbers: dict[str, int] = {}

    def say(self, topic: str, body: Any, part: bytes = b"", n: int | None = None) -> None:
        number = self.numbers.get(topic, 0) if n is None else n
        self.numbers[topic] = number + 1
        self.feed._take([topic.encode(), msgpack.packb({"n": number, "body": body}), part])

    def viewer(self) -> Viewer:
        viewer = Viewer("one", self.live.catch_up)
        self.live.welcome(viewer)
        self.live.hub.add(viewer)
        return viewer

    def wall(self, first: int, rows: int, scan: int = 1, of: str = "recent", step_mm: float = 5.0) -> None:
        body = {"scan": scan, "of": of, "step_mm": step_mm, "first": first, "rows": rows, "columns": 360}
        self.say("wall", {**body, "radius_mm": RADIUS_MM}, wall_rows(first, rows, step_mm))


@pytest.fixture
def head() -> Head:
    return Head()


def taken(viewer: Viewer) -> list[bytes]:
    return list(iter(viewer.take, None))


def cloud_of(messages: list[bytes]) -> int:
    """How many points a page shows that was told these."""
    shown = 0
    for message in messages:
        if message[0] == wire.POINTS:
            _, flags, _, _, count = struct.unpack_from("<BBHII", message)
            shown = count if flags & wire.ANEW else shown + count
    return shown


def rows_of(messages: list[bytes], of: int = 0) -> dict[int, bytes]:
    shown: dict[int, bytes] = {}
    for message in messages:
        if message[0] == wire.WALL and message[1] == of:
            _, _, columns, rows, first, *_ = struct.unpack_from("<BBHIiffI", message)
            size = 2 * columns
            shown |= {first + row: message[24 + row * size : 24 + (row + 1) * size] for row in range(rows)}
    return shown


def test_the_colours_are_the_reports_own() -> None:
    theirs = np.rint(255 * DEVIATION(np.arange(256))[:, :3])
    assert np.abs(deviation_table().astype(float) - theirs).max() <= 1


def test_points_are_coloured_by_how_far_the_wall_is_from_nominal(head: Head) -> None:
    head.wall(0, 1)
    viewer = head.viewer()
    taken(viewer)
    body = profile(1, 0.0)
    points = np.array([[0, -RADIUS_MM, 0], [0, 1 + RADIUS_MM, 0], [RADIUS_MM - 9, 0, 0]], "<f4")
    head.say("profile", {**body, "points": points.tobytes()})
    (message,) = taken(viewer)
    rgb = np.frombuffer(message, np.uint8, 9, 12 + 36).reshape(3, 3)
    table = deviation_table()
    assert [one.tolist() for one in rgb] == [table[128].tolist(), table[255].tolist(), table[0].tolist()]


def test_as_many_points_are_taken_as_a_profile_may_have() -> None:
    assert POINTS_MAX == wall_profile.POINTS_MAX


def test_who_comes_late_is_told_everything(head: Head) -> None:
    head.say("telemetry", {"scan": 1, "state": "scanning"})
    head.say("event", {"kind": "link", "text": "the controller restarted"})
    head.say("mark", {"z_mm": 5.0, "text": "joint"})
    head.say("sensor/supply", {"values": {"volts": 5.0}})
    for number in range(20):
        head.say("profile", profile(number, 3.0 * number))
    head.wall(0, 300)
    head.wall(-5, 3, of="whole", step_mm=10.0)
    messages = taken(head.viewer())
    topics = {status(one)[0] for one in messages if one[0] == wire.STATUS}
    assert topics == {"telemetry", "event", "mark", "sensor/supply"}
    assert 30_000 < cloud_of(messages) <= 60_000
    points = [one for one in messages if one[0] == wire.POINTS]
    assert points[0][1] & wire.ANEW and points[-1][1] & wire.LAST and not any(one[1] & wire.ANEW for one in points[1:])
    assert sorted(rows_of(messages)) == list(range(300)) and sorted(rows_of(messages, 1)) == [-5, -4, -3]
    assert b"".join(rows_of(messages)[row] for row in range(300)) == wall_rows(0, 300, 5.0)
    assert max(len(one) for one in messages) < 400_000


def test_points_that_come_while_the_cloud_is_told_are_not_missing(head: Head) -> None:
    for number in range(30):
        head.say("profile", profile(number, 300.0 * number))
    viewer = head.viewer()
    first = viewer.take()
    head.say("profile", profile(31, 9300.0))
    messages = [first or b"", *taken(viewer)]
    late = taken(head.viewer())
    assert cloud_of(messages) == cloud_of(late) > 31 * 1500


def test_a_new_scan_begins_with_nothing(head: Head) -> None:
    head.say("telemetry", {"scan": 1, "state": "scanning"})
    head.say("profile", profile(1, 0.0))
    head.wall(0, 10)
    head.say("defects", {"scan": 1, "defects": [{"id": 1}]})
    viewer = head.viewer()
    shown = taken(viewer)
    head.say("telemetry", {"scan": 2, "state": "armed"})
    shown += taken(viewer)
    assert cloud_of(shown) == 0 and shown[-2][:2] == bytes([wire.POINTS, wire.ANEW | wire.LAST])
    late = taken(head.viewer())
    assert cloud_of(late) == 0 and not rows_of(late)
    assert {status(one)[0] for one in late if one[0] == wire.STATUS} == {"telemetry"}


def test_points_before_the_first_telemetry_of_a_scan_are_not_lost(head: Head) -> None:
    head.say("state", {"state": "idle", "why": ""})
    head.say("telemetry", {"scan": 1, "state": "idle"})
    head.say("begun", {"scan": 2})
    head.say("state", {"state": "armed", "why": ""})
    head.say("profile", profile(1, 0.0))
    head.say("telemetry", {"scan": 2, "state": "scanning"})
    head.wall(0, 3, scan=2)
    assert cloud_of(taken(head.viewer())) > 1000


def test_a_pause_is_no_new_scan(head: Head) -> None:
    for state in ("idle", "armed", "scanning"):
        head.say("state", {"state": state, "why": ""})
    head.say("profile", profile(1, 0.0))
    for state in ("paused", "armed", "scanning", "fault", "armed"):
        head.say("state", {"state": state, "why": ""})
    assert cloud_of(taken(head.viewer())) > 1000


def test_a_daemon_that_began_again_is_begun_anew(head: Head) -> None:
    head.say("telemetry", {"scan": 1, "state": "scanning"}, n=100)
    head.say("profile", profile(1, 0.0), n=5000)
    head.say("event", {"kind": "link", "text": "of before"})
    viewer = head.viewer()
    shown = taken(viewer)
    head.say("telemetry", {"scan": 9, "state": "idle"}, n=0)
    assert cloud_of(shown + taken(viewer)) == 0
    head.say("profile", profile(1, 0.0), n=0)
    assert head.feed.lost == {}
    assert {status(one)[0] for one in taken(head.viewer()) if one[0] == wire.STATUS} == {"telemetry"}


def test_points_of_a_scan_that_nobody_named_do_not_outlast_a_silence(
    head: Head, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another daemon's telemetry made them its own, where the first had gone before it said which scan it was."""
    now = [100.0]
    monkeypatch.setattr(feed, "time", SimpleNamespace(monotonic=lambda: now[0]))
    head.say("profile", profile(1, 0.0))
    now[0] += feed.LOST_S - 0.1
    head.say("state", {"state": "scanning", "why": ""})
    viewer = head.viewer()
    shown = taken(viewer)
    assert cloud_of(shown) > 1000
    now[0] += feed.LOST_S + 0.1
    head.say("telemetry", {"scan": 9, "state": "idle"}, n=1)
    assert cloud_of(shown + taken(viewer)) == 0 == cloud_of(taken(head.viewer()))
    head.say("profile", profile(1, 0.0))
    now[0] += feed.LOST_S + 0.1
    head.say("telemetry", {"scan": 9, "state": "scanning"})  # the same, after all
    assert cloud_of(taken(head.viewer())) > 1000


def test_what_was_missed_is_counted_by_topic(head: Head) -> None:
    for number in (0, 1, 5, 6, 9):
        head.say("profile", profile(number, 0.0), n=number)
    for number in (3, 4, 90):
        head.say("preview/0", {}, n=number)
    assert head.feed.lost == {"profile": 5, "preview/0": 85}
    head.feed.want(frozenset({"pictures"}))
    head.say("preview/0", {}, n=500)  # nobody had asked for those between
    assert head.feed.lost["preview/0"] == 85


def test_the_wall_that_is_kept_is_bounded_and_of_one_step(head: Head) -> None:
    for first in range(0, 20_000, 500):
        head.wall(first, 500)
    assert len(rows_of(taken(head.viewer()))) <= 2400
    head.wall(0, 100, of="whole", step_mm=10.0)
    head.wall(0, 50, of="whole", step_mm=20.0)
    assert len(rows_of(taken(head.viewer()), 1)) == 50


def test_frames_that_saw_a_defect_outlast_the_others(head: Head) -> None:
    for index in range(70):
        head.say("preview/0", {"index": index, "label": "led", "camera": 0}, b"\xff\xd8" + bytes([index]) * 1_000_000)
        if index == 10:
            head.say("defects", {"scan": 1, "defects": [{"id": 1, "frames": [2, 3, 4, 5, 6, 7, 8, 9]}]})
    frames = head.live.frames
    assert all(frames.get(0, index) for index in (2, 4, 6, 8, 68, 69))
    assert not frames.get(0, 0) and not frames.get(0, 3)


def test_what_is_kept_of_defects_takes_the_room_of_the_latest_pictures(head: Head) -> None:
    """So that memory is flat from the first minutes on, however many are found."""
    frames, closeups = head.live.frames, head.live.closeups
    sizes = []
    for index in range(300):
        head.say("preview/0", {"index": index, "label": "led", "camera": 0}, b"\xff\xd8" + bytes(500_000))
        if index % 5 == 0:
            head.say("defects", {"scan": 1, "defects": [{"id": index, "frames": [index]}]})
            head.say("closeup", {"scan": 1, "id": index, "section_mm": bytes(1440)}, bytes(200_000))
        sizes.append(frames._recent.size + frames._seen.size + closeups.size)
    assert max(sizes) - min(sizes[150:]) < 2_000_000 and max(sizes) <= 57 << 20
    assert frames.get(0, 299) and head.live.closeups.get((1, 295))


WRONG = [
    ("preview/0", {"index": -1}, b"\xff\xd8"),
    ("preview/0", {"index": 1}, b"GIF"),
    ("preview/0", [], b""),
    ("preview/0", {"index": 1, "z_mm": "far"}, b"\xff\xd8"),
    ("rows/0", {"index": 1}, b"abc"),
    ("slits/0", {"index": 1}, b"abc"),
    ("slits/0", {"index": 2**40}, b""),
    ("wall", {}, b""),
    ("wall", 5, b""),
    ("wall", {"scan": 1, "of": "recent", "step_mm": 5, "first": 0, "rows": 9, "columns": 360, "radius_mm": 75}, b"ab"),
    ("profile", {"frame": 1, "points": b"abc"}, b""),
    ("profile", {"frame": 1, "points": "text"}, b""),
    ("profile", {"frame": 1, "points": np.full(3, np.nan, "<f4").tobytes()}, b""),
    ("profile", {}, b""),
    ("closeup", {"scan": 1}, b""),
    ("closeup", {"scan": 1, "id": 1, "section_mm": b"abc"}, b""),
    ("telemetry", 5, b""),
]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("topic", "body", "part"), WRONG)
def test_what_is_not_as_it_should_be_is_counted_and_not_passed_on(
    topic: str, body: Any, part: bytes, head: Head
) -> None:
    viewer = head.viewer()
    taken(viewer)
    head.say(topic, body, part)
    assert head.feed.malformed == 1 and taken(viewer) == []


@settings(max_examples=200, deadline=None)
@given(st.lists(st.binary(max_size=60), min_size=1, max_size=4))
def test_no_bytes_of_a_daemon_do_harm(parts: list[bytes]) -> None:
    Head().feed._take(parts)


TOPICS = [
    "preview/0",
    "rows/0",
    "slits/0",
    "wall",
    "profile",
    "closeup",
    "defects",
    "telemetry",
    "state",
    "event",
    "x/y",
]
SIMPLE = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=9)
    | st.binary(max_size=24)
)
BODIES = st.dictionaries(
    st.sampled_from(
        ["scan", "index", "frame", "points", "of", "rows", "columns", "defects", "state", "id", "section_mm"]
    ),
    SIMPLE | st.lists(SIMPLE | st.dictionaries(st.just("frames"), SIMPLE | st.lists(SIMPLE, max_size=3)), max_size=3),
)


@pytest.mark.deep(gate="tests/unit/console/test_live.py::test_no_bytes_of_a_daemon_do_harm")
@settings(max_examples=300, deadline=None)
@given(st.sampled_from(TOPICS), BODIES | SIMPLE, st.binary(max_size=40))
def test_no_body_of_a_daemon_does_harm(topic: str, body: Any, part: bytes) -> None:
    SHARED.say(topic, body, part)


SHARED = Head()
