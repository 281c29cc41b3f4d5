"""Labels said again from evidence (evidence.py), by the same Labelling that said them on the head.

replay = Replay()
for row in rows:                                  # in their order
    for was, now in replay.feed(row):             # a label row, and what follows from the rows before it
        compare(was, now)
for was, now in replay.finish():
    ..

Where rows are missing (`cut`) everything may have happened: a restart, a zero, a camera begun anew, lamps cut. So all
that is known is forgotten there. Frames that were open in the hole are unknown. Labels are unknown until a search from
nothing proves them again. z is anywhere (`Odometer.cut`) until one of three comes: the head's own odometer, a row of
every minute; a `zero`; or the label that the head gave to a flash behind the hole and that the rows prove again. The
head counted on where we could not: its place of that flash is better founded than ours, and ours go on from it. Nothing
else of a label is taken over.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from annulus_pipe import untrusted
from annulus_pipe.capture.photometry import Light, Photometry
from annulus_pipe.controller import SLIDES_MAX
from annulus_pipe.labelling.evidence import Row
from annulus_pipe.labelling.labelling import CameraMode, FrameSeen, Labelling
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.link.head import EdgeSeen, LampsCut
from annulus_pipe.link.messages import Fault, FaultCode
from annulus_pipe.link.session import EventReceived
from annulus_pipe.sensors.odometer import ANYWHERE_MM, CUT_SEGMENT, FlashPosition, Odometer
from annulus_pipe.stream.frames import SIDE_MAX, FrameHeader
from annulus_pipe.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Lamp, Slot, Tick

Said = tuple[Row, FrameHeader | None]  # None: there is no evidence of the frame
PATIENCE_NS = 3_000_000_000  # so long after its label was said a frame may wait for a better one


# Rows that no label follows from
ASIDE = frozenset({"unplaced", "ping", "answer", "unanswered", "rebooted", "events_lost", "phase", "drops"})
CUT_PERIODS = 3.0  # so long after it a cut of the lamps may be heard of, as an edge may (pairing.SETTLE_PERIODS)


class _ReplayedCamera:
    def __init__(self, mode: CameraMode, navigation: Navigation, alone: bool, looks: bool, preambles: bool) -> None:
        """`looks`: for an offset, with every frame; else when a row says that the head did. `preambles`: there are."""
        self.mode, self.alone, self.looks, self.preambles = mode, alone, looks, preambles
        self.labelling = Labelling(mode, navigation, lambda *_: None, alone)
        self.seen: deque[FrameSeen] = deque()  # and no label was said of it
        self.due: deque[tuple[Row, FrameSeen]] = deque()  # a label was said of it, and may be said better
        self.now_ns = 0

    def in_the_dark(self, navigation: Navigation) -> None:
        """It begins behind a hole, in which the driver may have kept frames by whole lamp cycles, or always had: where
        there are preambles, one has to tell.
        """
        navigation.edges.preambled |= self.preambles
        if navigation.edges.preambled:
            self.labelling.restarted()


class Replay:
    """`malformed` counts rows that could not be read. Each is a cut."""

    def __init__(self, patience_ns: int = 0) -> None:
        """`patience_ns`: on the head a frame may have been labelled early, for want of room. Off line it waits for its
        edges, or for the offset, for so long. 0: it is labelled at the moment at which the head labelled it.
        """
        self.malformed = 0
        self._patience_ns = patience_ns
        self._navigation = Navigation(1.0)
        self._cameras: dict[int, _ReplayedCamera] = {}
        self._begun = False  # something has come that was not known before
        self._placed = False  # the odometer is the head's
        self._cuts = 0
        self._wants_odometer = False  # rows are missing, and the head has not said since where z stood
        self._in_hole = False  # no frame came since

    def feed(self, row: Row) -> list[Said]:
        """The next row; the labels it brings."""
        labels: list[Said] = []
        try:
            labels.extend(self._fed(row))
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError):
            self.malformed += 1
            labels.extend(self.cut())
        return labels

    def cut(self) -> list[Said]:
        """Rows are missing here. The labels that were waiting for more."""
        labels = [one for camera in self._cameras.values() for one in self._patient(camera, final=True)]
        self._navigation.cut(self._cuts)
        self._cuts += 1
        self._begun = self._wants_odometer = self._in_hole = True
        for camera in self._cameras.values():
            began = _ReplayedCamera(camera.mode, self._navigation, camera.alone, True, camera.preambles)
            began.in_the_dark(self._navigation)
            self._cameras[camera.mode.camera] = began
        return labels

    def finish(self) -> list[Said]:
        """After the last row: what still waits."""
        labels = [one for camera in self._cameras.values() for one in self._patient(camera, final=True)]
        self._cameras.clear()
        return labels

    def _fed(self, row: Row) -> Iterator[Said]:
        known, what = bool(row.get("known")), row["what"]
        again = known and self._begun  # for whoever lacks what was before
        self._begun |= not known
        navigation = self._navigation
        match what:
            case "odometer":
                odometer = Odometer.recalled(row)
                if not again:
                    navigation = self._navigation = Navigation(1.0)
                    self._cameras.clear()
                if not again or self._wants_odometer:
                    navigation.odometer, self._placed, self._wants_odometer = odometer, True, False
            case "camera":
                mode = _mode(row)
                if self._placed and not (again and mode.camera in self._cameras):
                    looks = self._cuts > 0 or self._patience_ns > 0
                    preambles = bool(row.get("preambles", False))  # recordings before 2026-11-27 do not say
                    began = _ReplayedCamera(mode, navigation, bool(row["alone"]), looks, preambles)
                    self._cameras[mode.camera] = began
                    if self._cuts:
                        began.in_the_dark(navigation)
            case "edge" | "cut" if again:
                pass
            case "edge":
                navigation.heard(_edge(row))
            case "cut":
                navigation.heard(LampsCut(_whole(row, "from_ns"), _whole(row, "to_ns"), str(row["why"])))
            case "event" if row["name"] == Fault.__name__:
                fault = Fault(_whole(row, "tick"), FaultCode(row["fault"]), _whole(row, "detail"))
                navigation.heard(
                    EventReceived(fault, _whole(row, "sequence"), _whole(row, "boot"), 0, bool(row["recovered"]))
                )
            case "event":
                str(row["name"])
            case "roll":
                navigation.roll.add(_whole(row, "host_ns"), _number(row, "roll_deg"))
            case "zero":
                navigation.zero()
            case "frame":
                yield from self._frame(_frame(row), self._cameras.get(_whole(row, "camera")))
            case "look":
                camera, now_s = self._cameras.get(_whole(row, "camera")), _number(row, "now_s")
                if camera is not None and not camera.looks:
                    camera.labelling.look_for_offset(now_s)
            case "restarted":
                camera = self._cameras.get(_whole(row, "camera"))
                if camera is not None:
                    yield from self._patient(camera, final=True)
                    camera.labelling.restarted()
            case "label":
                yield from self._label(row)
            case _ if what not in ASIDE:
                raise ValueError("a row of a kind that is none")

    def _frame(self, frame: FrameSeen, camera: _ReplayedCamera | None) -> Iterator[Said]:
        if camera is None:
            return
        if self._in_hole and not camera.alone:  # the lamps may have been cut in the hole, too
            until_ns = frame.arrived_ns + round(CUT_PERIODS * camera.mode.period_ns)
            self._navigation.edges.invalidate(0, until_ns)
            self._in_hole = False
        camera.labelling.saw(frame)
        camera.seen.append(frame)
        if camera.looks:  # a frame that waits longer may make a search longer, or needless
            camera.now_ns = frame.arrived_ns
            camera.labelling.look_for_offset(frame.arrived_ns / 1e9)
            yield from self._patient(camera)

    def _label(self, row: Row) -> Iterator[Said]:
        camera = self._cameras.get(_whole(row, "camera"))
        arrived_ns = _whole(row, "arrived_ns")
        while camera is not None and camera.seen and camera.seen[0].arrived_ns < arrived_ns:
            camera.seen.popleft()  # its label is lost
        if camera is None or not camera.seen or camera.seen[0].arrived_ns != arrived_ns:
            yield row, None
            return
        camera.due.append((row, camera.seen.popleft()))
        yield from self._patient(camera)

    def _patient(self, camera: _ReplayedCamera, final: bool = False) -> Iterator[Said]:
        while camera.due:
            row, frame = camera.due[0]
            late = camera.now_ns - frame.arrived_ns >= self._patience_ns
            if not (final or late or not self._patience_ns or camera.labelling.settled(frame, camera.now_ns)):
                return
            camera.due.popleft()
            yield row, self._counted_on(row, camera.labelling.header(frame))

    def _counted_on(self, row: Row, now: FrameHeader) -> FrameHeader:
        """Behind a hole: the place that the head gave to that very flash, and that ours follow from now on."""
        if now.segment < CUT_SEGMENT or now.edge is None or now.odometer is None or now.z_mm is None:
            return now
        if (row.get("label"), row.get("edge"), row.get("odometer")) != (now.label.value, now.edge, now.odometer):
            return now
        try:
            segment = untrusted.whole(row["segment"], "segment", 0, CUT_SEGMENT - 1)
            bound_mm = untrusted.within(row["z_bound_mm"], "z_bound_mm", 0.0, ANYWHERE_MM)
            place = FlashPosition(_number(row, "z_mm"), segment, bound_mm)
        except (KeyError, ValueError):
            return now
        if self._navigation.odometer.counted_on(now.edge, now.odometer, place) is None:
            return now
        return replace(now, z_mm=place.z_mm, z_assumed=place.assumed, z_bound_mm=place.bound_mm, segment=place.segment)


def _whole(row: Mapping[str, Any], name: str) -> int:
    return untrusted.whole(row[name], name, -(1 << 63), 1 << 63)


def _number(row: Mapping[str, Any], name: str) -> float:
    return untrusted.number(row[name], name, 1e15)


def _mode(row: Mapping[str, Any]) -> CameraMode:
    camera, *side = (untrusted.whole(row[name], name, 0, SIDE_MAX) for name in ("camera", "width", "height"))
    period_ns = untrusted.whole(row["period_ns"], "period_ns", 1, 1 << 48)
    slides = untrusted.whole(row.get("slides", 1), "slides", 1, SLIDES_MAX)  # recordings of before do not say
    sees = tuple(untrusted.whole(one, "sees", 0, SLIDES_MAX - 1) for one in list(row.get("sees", ()))[:SLIDES_MAX])
    encoding = untrusted.text(row["encoding"], "encoding", 64)
    return CameraMode(camera, side[0], side[1], encoding, period_ns, slides, sees)


def _edge(row: Mapping[str, Any]) -> EdgeSeen:
    flash = Flash(
        EdgeIndex(_whole(row, "edge")),
        Tick(_whole(row, "tick")),
        Slot(_whole(row, "slot")),
        Lamp(row["lamp"]),
        _whole(row, "delay_ticks"),
        _whole(row, "width_ticks"),
        _whole(row, "odometer"),
        _whole(row, "generation"),
        _whole(row, "boot"),
        EdgeFlag(row["flags"]),
    )
    nonce = None if row["nonce"] is None else _whole(row, "nonce")
    return EdgeSeen(flash, _whole(row, "host_ns"), _whole(row, "error_ns"), _whole(row, "epoch"), nonce)


def _frame(row: Mapping[str, Any]) -> FrameSeen:
    picture, sequence = row["picture"], row["sequence"]
    bands, fingerprint = tuple(Light(band) for band in picture["bands"]), picture["fingerprint"]
    return FrameSeen(
        None if sequence is None else CameraSequence(_whole(row, "sequence")),
        _whole(row, "timestamp_ns"),
        _whole(row, "arrived_ns"),
        Photometry(
            _number(picture, "peak"),
            _number(picture, "lit"),
            _number(picture, "spread"),
            bands,
            None if fingerprint is None else int(fingerprint, 16),
            picture.get("top"),
            picture.get("bottom"),
            float(picture.get("contrast", 0.0)),
        ),
        dict(row["metadata"]),
    )
