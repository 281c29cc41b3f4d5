"""Everything a label followed from, row by row in the order in which it came: so that it can be said again off line.

    navigation.write_down(write)                      # from now on `write` is given every row, a dict of plain types

A label depends on nothing but the order of what came and the moments at which the offset was looked for, and both are
rows. So the same program says the same labels again, to the bit (replay.py); another says what it would have said.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from typing import Any

from annulus_pipe.capture.photometry import Photometry
from annulus_pipe.link.head import EdgeSeen, HeadEvent, LampsCut, PhaseChanged
from annulus_pipe.link.messages import Edge, PingReply, Reply
from annulus_pipe.link.session import Answer, EventReceived, EventsLost, Rebooted, Unanswered
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import CameraSequence, Flash

Row = dict[str, Any]
Write = Callable[[Row], None]

UNPLACED_AFTER = 128  # edges: one that was heard so many edges ago and is not placed never will be
LABEL = (
    "camera",
    "arrived_ns",
    "index",
    "label",
    "reason",
    "edge",
    "slot",
    "odometer",
    "z_mm",
    "roll_deg",
    "z_assumed",
    "z_bound_mm",
    "segment",
)
METADATA = (
    "Light",
    "ZMm",
    "RollDeg",
    "ExposureTime",
    "AnalogueGain",
    "DigitalGain",
    "FrameDuration",
)  # kept of a frame


@dataclass(slots=True)
class _Heard:
    edge: Edge
    at_ns: int
    recovered: bool


class Journal:
    """Writes rows while somebody wants them."""

    def __init__(self) -> None:
        self._write: Write | None = None
        self._rows = 0
        self._known: Row = {}
        self._cameras: dict[int, Row] = {}
        self._looked: dict[int, int] = {}  # camera -> rows when it looked for its offset last
        self._heard: dict[tuple[int, int], _Heard] = {}  # (edge, tick) -> an edge that is not placed yet

    def write_to(self, write: Write | None) -> None:
        """None: nobody wants them any more."""
        self._write = write

    def camera(self, alone: bool, **mode: Any) -> None:
        """One whose frames are labelled from now on; `alone`: without a controller."""
        self._cameras[mode["camera"]] = {**mode, "alone": alone}
        self.note("camera", **self._cameras[mode["camera"]])

    def cameras(self) -> None:
        """The same again, for one who was not there."""
        for camera in self._cameras.values():
            self.note("camera", **camera)

    def note(self, what: str, **values: Any) -> None:
        self._rows += 1
        if self._write is not None:
            self._write({"what": what, **values, **self._known})

    @contextmanager
    def known(self) -> Iterator[None]:
        """Rows of what was known before: for one who begins here, and nobody else."""
        self._known = {"known": True}
        yield
        self._known = {}

    # ---- what comes ----

    def heard(self, event: HeadEvent) -> None:
        """Whatever the controller's line brought."""
        if self._write is None:
            return
        match event:
            case EventReceived(Edge() as edge, _, _, at_ns, recovered):
                self._heard[edge.edge, edge.tick] = _Heard(edge, at_ns, recovered)
                if len(self._heard) > UNPLACED_AFTER:
                    self._unplaced(next(iter(self._heard)))
            case EdgeSeen():
                self.edge(event)
            case EventReceived(other, sequence, boot, at_ns, recovered):
                name = type(other).__name__
                self.note(
                    "event",
                    name=name,
                    sequence=sequence,
                    boot=boot,
                    heard_ns=at_ns,
                    recovered=recovered,
                    **asdict(other),
                )
            case Answer(command=command, reply=PingReply() as reply):
                self.note(
                    "ping", tick=reply.tick, sent_ns=event.sent_ns, received_ns=event.received_ns, tries=event.tries
                )
            case Answer(command=command, reply=Reply() as reply):
                self.note("answer", to=type(command).__name__, received_ns=event.received_ns, **asdict(reply))
            case Unanswered(_, command, why):
                self.note("unanswered", to=type(command).__name__, why=why)
            case LampsCut():
                self.note("cut", **asdict(event))
            case Rebooted():
                for unplaced in list(self._heard):
                    self._unplaced(unplaced)
                self.note("rebooted", **asdict(event))
            case EventsLost():
                self.note("events_lost", **asdict(event))
            case PhaseChanged(phase, why):
                self.note("phase", phase=phase.value, why=why)

    def edge(self, seen: EdgeSeen) -> None:
        """One that has its place in host time."""
        flash = seen.flash
        heard = self._heard.pop((flash.edge, flash.tick % (1 << 32)), None)
        self.note(
            "edge",
            epoch=seen.boot_epoch,
            nonce=seen.nonce,
            host_ns=seen.host_ns,
            error_ns=seen.error_ns,
            **_plain(flash),
            **({"heard_ns": heard.at_ns, "recovered": heard.recovered} if heard is not None else {}),
        )

    def saw(
        self,
        camera: int,
        sequence: CameraSequence | None,
        timestamp_ns: int,
        arrived_ns: int,
        picture: Photometry,
        metadata: Mapping[str, Any],
    ) -> None:
        """A frame, before its label."""
        if self._write is None:
            return
        self.note(
            "frame",
            camera=camera,
            sequence=sequence,
            timestamp_ns=timestamp_ns,
            arrived_ns=arrived_ns,
            picture=_picture(picture),
            metadata={key: metadata[key] for key in METADATA if key in metadata},
        )

    def looks(self, camera: int, now_s: float) -> bool:
        """Whether anything has come since a camera looked for its offset. What is not written down does not happen."""
        if self._write is None:
            return True
        if self._looked.get(camera) == self._rows:
            return False
        self.note("look", camera=camera, now_s=now_s)
        self._looked[camera] = self._rows
        return True

    def label(self, header: FrameHeader) -> None:
        """The label of a frame."""
        if self._write is None:
            return
        data = header.to_dict()
        self.note("label", **{name: data[name] for name in LABEL})

    def _unplaced(self, which: tuple[int, int]) -> None:
        heard = self._heard.pop(which)
        self.note("unplaced", heard_ns=heard.at_ns, recovered=heard.recovered, **asdict(heard.edge))


def _plain(flash: Flash) -> Row:
    row = {field.name: getattr(flash, field.name) for field in fields(flash) if field.name != "epoch"}
    return {**row, "lamp": int(flash.lamp), "flags": int(flash.flags)}


def _picture(picture: Photometry) -> Row:
    row = asdict(picture)
    row["bands"] = [band.value for band in picture.bands]
    if picture.fingerprint is not None:
        row["fingerprint"] = f"{picture.fingerprint:016x}"  # some readers' numbers have 53 bits
    return row
