"""Two scans that `mcap merge` joined in one file were opened as one: the first's pictures got the second's labels, 43
lamps of 50 were wrong, and `record verify` found nothing, as every chunk was as it was written."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from annulus_pipe.record import recording as opening
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.frames import from_json, to_json
from annulus_pipe.record.parts import Part
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.vocabulary import AnnulusError

Entry = tuple[Any, Any, Any]  # schema, channel, message
SHAPE = 24, 32
CLOCK, LATER = Clock(1_000, 10**18), Clock(1_040, 10**18 + 3600 * 10**9)
ATTACHED = "clock.json", "calibration.json", "configuration.json", "part.json"


def scan(
    path: Path, lamp: str, clock: Clock, indices: Iterable[int], part: Part | None = None, camera: int = 0
) -> Path:
    with RecordingWriter(
        path, calibration={"of": lamp}, configuration={}, now_ns=clock.host_ns, clock=clock, part=part
    ) as writer:
        if part is None or part.number == 1:
            writer.note("/identity", {"why": "start", "host_ns": clock.host_ns}, clock.host_ns)
        for n in indices:
            time_ns = clock.host_ns + 40_000_000 * n
            label = {
                "index": n,
                "camera": camera,
                "label": lamp,
                "z_mm": 2.0 * n,
                "timestamp_ns": time_ns,
                "encoding": "mono8",
                "width": SHAPE[1],
                "height": SHAPE[0],
            }
            writer.frame(label, np.full(SHAPE, n, np.uint8), time_ns)
    return path


def merged(
    out: Path,
    *paths: Path,
    attached: tuple[str, ...] = ATTACHED,
    by_time: bool = False,
    left_out: tuple[str, ...] = (),
    camera: int = 0,
) -> Path:
    """As `mcap merge` does it. camera : what all frames but the first file's are of."""
    messages: list[tuple[int, int, Entry]] = []
    attachments = []
    for n, path in enumerate(paths):
        with path.open("rb") as file:
            reader = make_reader(file)
            messages += [(one[2].log_time, n, one) for one in reader.iter_messages(log_time_order=False)]
            attachments += [one for one in reader.iter_attachments() if one.name in attached]
    if by_time:
        messages.sort(key=lambda one: one[:2])
    with out.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="merged")
        numbers: dict[tuple[int, int], int] = {}
        for _, n, (schema, channel, message) in messages:
            if channel.topic in left_out:
                continue
            topic, data = channel.topic, message.data
            if n and camera:
                topic = topic.replace("/frame/0", f"/frame/{camera}")
                data = to_json(from_json(data) | {"camera": camera}) if topic == "/label" else data
            if (n, channel.id) not in numbers:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[n, channel.id] = writer.register_channel(topic, channel.message_encoding, kind)
            writer.add_message(numbers[n, channel.id], message.log_time, data, message.publish_time, message.sequence)
        for one in {(one.name, one.data): one for one in attachments}.values():
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        writer.finish()
    return out


Merge = Callable[[Path, Path, Path], Path]
WAYS: dict[str, Merge] = {
    "one behind the other": lambda out, a, b: merged(out, a, b),
    "the second first": lambda out, a, b: merged(out, b, a),
    "by time, nothing attached": lambda out, a, b: merged(out, b, a, attached=(), by_time=True),
    "of two cameras": lambda out, a, b: merged(out, a, b, attached=(), camera=1, left_out=("/identity",)),
    "of two cameras and one clock": lambda out, a, b: merged(
        out, a, scan(b.with_name("c.mcap"), "led", CLOCK, range(5)), attached=("clock.json",), camera=1
    ),
    "only attachments of two": lambda out, a, b: merged(
        out, a, scan(b.with_name("c.mcap"), "led", CLOCK, range(50, 55)), left_out=("/identity",)
    ),
    "frames of one, labels of the other": lambda out, a, b: merged(
        out,
        merged(out.with_name("f.mcap"), a, left_out=("/label",)),
        merged(out.with_name("l.mcap"), b, left_out=("/frame/0", "/identity"), attached=()),
        attached=("clock.json",),
    ),
    "a clock read twice": lambda out, a, b: merged(
        out,
        a,
        scan(b.with_name("c.mcap"), "led", Clock(1_000, 10**18 + 1), range(50, 55)),
        attached=(),
        left_out=("/identity",),
    ),
}


@pytest.mark.parametrize("kept", [False, True], ids=["walked", "a walk that is kept"])
@pytest.mark.parametrize("way", WAYS)
def test_two_scans_are_refused(way: str, kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if kept:
        monkeypatch.setattr(opening, "is_kept", lambda *_: True)
    one = scan(tmp_path / "a.mcap", "projector", CLOCK, range(10))
    other = scan(tmp_path / "b.mcap", "led", LATER, range(10))
    both = WAYS[way](tmp_path / "both.mcap", one, other)
    for _ in range(2):
        with pytest.raises(AnnulusError, match=r"both\.mcap: holds more than one scan .*Expected one") as raised:
            open_recording(both)
        assert "\n" not in str(raised.value)


def test_a_later_part_that_is_two_scans_is_refused_too(tmp_path: Path) -> None:
    first = scan(tmp_path / "a.mcap", "projector", CLOCK, range(5), Part("one", 1))
    later = scan(tmp_path / "l.mcap", "projector", CLOCK, range(5, 9), Part("one", 2))
    other = scan(tmp_path / "b.mcap", "led", LATER, range(5, 9))
    merged(tmp_path / "a-002.mcap", other, later, attached=("part.json",))
    with pytest.raises(AnnulusError, match=r"a-002\.mcap: holds more than one scan"):
        open_recording(first)


@pytest.mark.parametrize("by_time", [False, True])
def test_parts_of_one_scan_may_be_joined(by_time: bool, tmp_path: Path) -> None:
    parts = [
        scan(tmp_path / "a.mcap", "projector", CLOCK, range(5), Part("one", 1)),
        scan(tmp_path / "b.mcap", "projector", CLOCK, range(5, 9), Part("one", 2)),
    ]
    joined = open_recording(merged(tmp_path / "joined.mcap", *parts, by_time=by_time))
    assert [frame.index for frame in joined.frames] == list(range(9)) and joined.calibration == {"of": "projector"}
    assert all(joined.read(frame)[0, 0, 0] == frame.index for frame in joined.frames) and not joined.check()
