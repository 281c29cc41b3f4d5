"""What the daemon publishes, for who has Foxglove's viewer: pictures, points, places and a log as its own messages.

Only when asked for, and on loopback: this server asks nobody where a page comes from. It takes no commands.
"""

import time
from collections.abc import Iterator, Mapping
from typing import Any

from annulus_pipe.console.feed import Feed
from annulus_pipe.extras import need
from annulus_pipe.stream.frames import CAMERAS_MAX
from annulus_pipe.untrusted import one_line, whole
from annulus_pipe.vocabulary import AnnulusError

PORT = 8765
BACKLOG = 64  # messages for a viewer that is slow; the oldest go


class Foxglove:
    """A server beside the page's. `hear` every word of the feed; `wants` what is to be asked of the daemon for it."""

    def __init__(self, feed: Feed, port: int = PORT) -> None:
        """Raises AnnulusError, one line, when it cannot be."""
        from annulus_pipe.record import viewers  # late: few consoles have one

        self._viewers, self._foxglove = viewers, need("foxglove")
        self._channels: dict[str, Any] = {}
        self._context = self._foxglove.Context()
        try:
            self._server = self._foxglove.start_server(
                name="annulus", host="127.0.0.1", port=port, context=self._context, message_backlog_size=BACKLOG
            )
        except Exception as error:  # the library's own, which says no more
            why = one_line(str(error))
            raise AnnulusError(f"no Foxglove server at port {port} ({why}), expected a free port") from None
        feed.reads_labels = True
        self.port = int(self._server.port)
        self._channel_of(
            f"{self._viewers.PREVIEW_TOPIC}/0", self._viewers.jpeg_message(b"", self._viewers.PREVIEW, 0)
        )  # there to be asked for before one is sent

    @property
    def wants(self) -> frozenset[str]:
        """Pictures, while somebody looks at them."""
        pictures = (
            channel for topic, channel in self._channels.items() if topic.startswith(self._viewers.PREVIEW_TOPIC)
        )
        looked_at = any(channel.has_sinks() for channel in pictures)
        return frozenset({"pictures"}) if looked_at else frozenset()

    def hear(self, topic: str, body: Any, part: bytes) -> None:
        """One word of the daemon's. ValueError when it is not as it should be."""
        if isinstance(body, Mapping):
            for to, message in self._messages(topic, body, part, time.time_ns()):
                channel = self._channel_of(to, message)
                if channel.has_sinks():
                    channel.log(message.SerializeToString())

    def close(self) -> None:
        self._server.stop()

    def _messages(self, topic: str, body: Mapping[str, Any], part: bytes, now_ns: int) -> Iterator[tuple[str, Any]]:
        if topic.startswith("preview/"):
            camera = whole(body.get("camera", 0), "preview: camera", 0, CAMERAS_MAX - 1)
            yield (
                f"{self._viewers.PREVIEW_TOPIC}/{camera}",
                self._viewers.jpeg_message(part, self._viewers.of_camera(camera, self._viewers.PREVIEW), now_ns),
            )
        elif topic == "label":
            yield from self._viewers.of_label(body, now_ns)
        else:
            yield from self._viewers.of_note(f"/{topic}", body, now_ns)

    def _channel_of(self, topic: str, message: Any) -> Any:
        channel = self._channels.get(topic)
        if channel is None:
            form = self._viewers.form(type(message))
            schema = self._foxglove.Schema(name=form.name, encoding=form.encoding, data=form.data)
            channel = self._channels[topic] = self._foxglove.Channel(
                topic, schema=schema, message_encoding="protobuf", context=self._context
            )
        return channel
