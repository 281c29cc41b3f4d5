"""A second server for Foxglove's viewer: what it is told, by its own protocol; and that it takes no commands."""

import json
import struct
from collections.abc import Iterator

import pytest
import zmq
from fake_daemon import jpeg, profile
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from websockets.sync.client import ClientConnection, connect

from annulus_pipe.console.feed import Feed
from annulus_pipe.console.foxglove import Foxglove
from annulus_pipe.vocabulary import AnnulusError

pytest.importorskip("foxglove")


@pytest.fixture
def server() -> Iterator[Foxglove]:
    one = Foxglove(Feed(zmq.Context.instance(), "inproc://nobody"), port=0)
    yield one
    one.close()


def viewer(server: Foxglove) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{server.port}", subprotocols=["foxglove.sdk.v1"], max_size=None)  # type: ignore[list-item]


def channels(page: ClientConnection, least: int) -> dict[str, int]:
    found: dict[str, int] = {}
    while len(found) < least:
        said = page.recv(30.0)
        if isinstance(said, str) and (told := json.loads(said))["op"] == "advertise":
            found |= {one["topic"]: one["id"] for one in told["channels"]}
    return found


def message(page: ClientConnection) -> tuple[int, bytes]:
    while True:
        said = page.recv(30.0)
        if isinstance(said, bytes) and said[0] == 1:
            return struct.unpack_from("<I", said, 1)[0], said[13:]


def test_pictures_are_asked_for_while_a_viewer_looks_and_points_come_as_a_cloud(server: Foxglove) -> None:
    header = {"camera": 0, "index": 1, "label": "led"}
    server.hear("profile", profile(1, 0.0), b"")  # its channel is there from now on
    with viewer(server) as page:
        known = channels(page, 2)
        assert server.wants == frozenset()
        page.send(
            json.dumps(
                {
                    "op": "subscribe",
                    "subscriptions": [
                        {"id": 1, "channelId": known["/preview/0"]},
                        {"id": 2, "channelId": known["/points"]},
                    ],
                }
            )
        )
        while server.wants != {"pictures"}:
            pass
        picture = jpeg(0, "led")
        server.hear("preview/0", header, picture)
        assert (1, picture) == (lambda got: (got[0], CompressedImage.FromString(got[1]).data))(message(page))
        server.hear("profile", profile(2, 3.0), b"")
        number, data = message(page)
        cloud = PointCloud.FromString(data)
        assert number == 2 and len(cloud.data) == 3000 * cloud.point_stride


def test_it_takes_no_commands(server: Foxglove) -> None:
    with viewer(server) as page:
        told = json.loads(page.recv(30.0))
        assert told["op"] == "serverInfo" and told.get("capabilities", []) == []


def test_what_is_no_word_of_the_daemons_does_no_harm(server: Foxglove) -> None:
    for topic, body in (("preview/0", {}), ("label", {"z_mm": "far"}), ("profile", {"points": b"x"}), ("event", 5)):
        server.hear(topic, body, b"")


def test_a_port_that_is_taken_is_said_in_a_line(server: Foxglove) -> None:
    with pytest.raises(AnnulusError, match="no Foxglove server at port"):
        Foxglove(Feed(zmq.Context.instance(), "inproc://nobody"), port=server.port)
