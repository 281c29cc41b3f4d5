"""Labels said again from evidence (evidence.py), by the same Labelling that said them on the head.

replay = Replay()
for row in rows:                                  # in their order
    for was, now in replay.feed(row):             # a label row, and what follows from the rows before it
        compare(was, now)
for was, now in replay.finish():
    ..
"""

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any

from annulus.capture.photometry import Light, Photometry
from annulus.labelling.evidence import Row
from annulus.labelling.labelling import CameraMode, FrameSeen, Labelling
from annulus.labelling.navigation import Navigation
from annulus.link.head import EdgeSeen, LampsCut
from annulus.link.messages import Fault, FaultCode
from annulus.link.session import EventReceived
from annulus.sensors.odometer import Odometer
from annulus.stream.frames import FrameHeader
from annulus.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Lamp, Slot, Tick

Said = tuple[Row, FrameHeader | None]  # None: there is no evidence of the frame
PATIENCE_NS = 3_000_000_000  # so long after its label was said a frame may wait for a better one


class _Camera:
    def __init__(self, labelling: Labelling) -> None:
        self.labelling = labelling
        self.seen: deque[FrameSeen] = deque()  # and no label was said of it
        self.due: deque[tuple[Row, FrameSeen]] = deque()  # a label was said of it, and may be said better
        self.now_ns = 0


class Replay:
    """`malformed` counts rows that could not be read."""

    def __init__(self, patience_ns: int = 0) -> None:
        """`patience_ns`: on the head a frame may have been labelled early, for want of room. Off line it waits for its
        edges, or for the offset, for so long. 0: it is labelled when it was.
        """
        self.malformed = 0
        self._patience_ns = patience_ns
        self._navigation = Navigation(1.0)
        self._cameras: dict[int, _Camera] = {}
        self._begun = False  # something has come that was not known before

    def feed(self, row: Row) -> list[Said]:
        """The next row; the labels it brings."""
        try:
            return list(self._fed(row))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
            self.malformed += 1
            return []

    def finish(self) -> list[Said]:
        """After the last row: what still waits."""
        said = [one for camera in self._cameras.values() for one in self._patient(camera, final=True)]
        self._cameras.clear()
        return said

    def _fed(self, row: Row) -> Iterator[Said]:
        known = bool(row.get("known"))
        if known and self._begun:  # a recorder took another's place: for whoever has its file alone
            return
        self._begun |= not known
        navigation = self._navigation
        match row["what"]:
            case "odometer":
                navigation = self._navigation = Navigation(1.0)
                navigation.odometer = Odometer.recalled(row)
                self._cameras.clear()
            case "camera":
                mode = CameraMode(*(row[name] for name in ("camera", "width", "height", "encoding", "period_ns")))
                self._cameras[mode.camera] = _Camera(Labelling(mode, navigation, lambda *_: None, bool(row["alone"])))
            case "edge":
                navigation.heard(_edge(row))
            case "cut":
                navigation.heard(LampsCut(int(row["from_ns"]), int(row["to_ns"]), str(row["why"])))
            case "event" if row["name"] == Fault.__name__:
                fault = Fault(int(row["tick"]), FaultCode(row["fault"]), int(row["detail"]))
                navigation.heard(
                    EventReceived(fault, int(row["sequence"]), int(row["boot"]), 0, bool(row["recovered"]))
                )
            case "roll":
                navigation.roll.add(int(row["host_ns"]), float(row["roll_deg"]))
            case "zero":
                navigation.zero()
            case "frame":
                frame, camera = _frame(row), self._cameras[row["camera"]]
                camera.labelling.saw(frame)
                camera.seen.append(frame)
                if self._patience_ns:  # a frame that waits longer may make a search longer, or needless
                    camera.now_ns = frame.arrived_ns
                    camera.labelling.look_for_offset(frame.arrived_ns / 1e9)
                    yield from self._patient(camera)
            case "look" if not self._patience_ns:
                self._cameras[row["camera"]].labelling.look_for_offset(float(row["now_s"]))
            case "restarted":
                camera = self._cameras[row["camera"]]
                yield from self._patient(camera, final=True)
                camera.labelling.restarted()
            case "label":
                yield from self._label(row)

    def _label(self, row: Row) -> Iterator[Said]:
        camera = self._cameras.get(row["camera"])
        arrived_ns = int(row["arrived_ns"])
        while camera is not None and camera.seen and camera.seen[0].arrived_ns < arrived_ns:
            camera.seen.popleft()  # its label is lost
        if camera is None or not camera.seen or camera.seen[0].arrived_ns != arrived_ns:
            yield row, None
            return
        camera.due.append((row, camera.seen.popleft()))
        yield from self._patient(camera)

    def _patient(self, camera: _Camera, final: bool = False) -> Iterator[Said]:
        while camera.due:
            row, frame = camera.due[0]
            late = camera.now_ns - frame.arrived_ns >= self._patience_ns
            if not (final or late or not self._patience_ns or camera.labelling.settled(frame, camera.now_ns)):
                return
            camera.due.popleft()
            yield row, camera.labelling.header(frame)


def _edge(row: Mapping[str, Any]) -> EdgeSeen:
    flash = Flash(
        EdgeIndex(int(row["edge"])), Tick(int(row["tick"])), Slot(int(row["slot"])), Lamp(row["lamp"]),
        int(row["delay_ticks"]), int(row["width_ticks"]), int(row["odometer"]), int(row["generation"]),
        int(row["boot"]), EdgeFlag(row["flags"]),
    )  # fmt: skip
    nonce = None if row["nonce"] is None else int(row["nonce"])
    return EdgeSeen(flash, int(row["host_ns"]), int(row["error_ns"]), int(row["epoch"]), nonce)


def _frame(row: Mapping[str, Any]) -> FrameSeen:
    picture, sequence = row["picture"], row["sequence"]
    bands, fingerprint = tuple(Light(band) for band in picture["bands"]), picture["fingerprint"]
    return FrameSeen(
        None if sequence is None else CameraSequence(int(sequence)), int(row["timestamp_ns"]), int(row["arrived_ns"]),
        Photometry(
            float(picture["peak"]), float(picture["lit"]), float(picture["spread"]), bands,
            None if fingerprint is None else int(fingerprint, 16), picture.get("top"), picture.get("bottom"),
            float(picture.get("contrast", 0.0)),
        ),
        dict(row["metadata"]),
    )  # fmt: skip
