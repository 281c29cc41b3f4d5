"""From a frame as it came to a frame with its header: label, edge, station, roll. Owns one camera's timestamp offset.

navigation.heard(event)                           # from the controller, as it comes
labelling = Labelling(mode, navigation, tell)     # one a camera; navigation None: no controller
labelling.saw(frame)                              # every frame, as it comes
labelling.look_for_offset(now_s)                  # now and then
if labelling.settled(frame, now_ns):              # frames in the order of capture
    header = labelling.header(frame)
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from annulus.capture.pairing import Pairing, calibrate_offset
from annulus.capture.photometry import Light, Photometry
from annulus.controller import TICK_NS
from annulus.labelling.navigation import Navigation
from annulus.stream.frames import FrameHeader
from annulus.vocabulary import AnnulusError, CameraSequence, Flash, Label

OFFSET_FRAMES = 15  # seen before the camera's offset is tried ..
OFFSET_FRAMES_KEPT = 64  # .. and looked at
GIVE_UP_S = 20.0  # without an offset the operator is told, each time this has passed
LOOK_AGAIN_S = 2.0  # after an offset was found, it is not doubted for so long
TRY_PERIODS = 3.0  # between two attempts
NOT_KNOWN = "timestamp offset not known yet"
NO_CONTROLLER = "no controller"


@dataclass(frozen=True, slots=True)
class CameraMode:
    """What all frames of one camera have in common."""

    camera: int  # which of the head's
    width: int
    height: int
    encoding: str
    period_ns: int


@dataclass(frozen=True, slots=True)
class FrameSeen:
    """A frame without its picture, but with what the picture shows."""

    sequence: CameraSequence | None
    timestamp_ns: int  # the driver's, host monotonic
    arrived_ns: int  # when we had it, host monotonic
    picture: Photometry
    metadata: Mapping[str, Any]


class Labelling:
    """Sans-I/O: the caller says what time it is. `tell(kind, text)` is for the operator."""

    def __init__(self, mode: CameraMode, navigation: Navigation, tell: Callable[[str, str], None], alone: bool) -> None:
        """`alone`: there is no controller; labels are those the frames bring, or unknown."""
        self._mode, self._navigation, self._alone = mode, navigation, alone
        navigation.journal.camera(alone, **asdict(mode))
        self._tell = tell
        self._pairing = Pairing(mode.period_ns, history=navigation.edges)
        self._seen: deque[tuple[int, Light]] = deque(maxlen=OFFSET_FRAMES_KEPT)
        self._offset_known = self._alone
        self._looking_since: float | None = None
        self._next_look = 0.0

    @property
    def offset_known(self) -> bool:
        return self._offset_known

    @property
    def wants_preamble(self) -> bool:
        """Which frame is which is in doubt: an order of lamps that does not repeat would tell."""
        return not self._alone and (not self._offset_known or self._pairing.doubtful)

    def numbers(self) -> dict[str, int]:
        """For the telemetry."""
        return {
            "offset_ns": self._pairing.offset_ns,
            "offset_error_ns": self._pairing.offset_error_ns,
        }

    def saw(self, frame: FrameSeen) -> None:
        """A frame has come; it may help to find the offset long before it can be labelled."""
        self._navigation.journal.saw(
            self._mode.camera, frame.sequence, frame.timestamp_ns, frame.arrived_ns, frame.picture, frame.metadata
        )
        self._seen.append((frame.timestamp_ns, frame.picture.light))

    def look_for_offset(self, now_s: float) -> None:
        """At the start, and again whenever the offset has become doubtful. Until it is found, frames are unknown."""
        if not self._navigation.journal.looks(self._mode.camera, now_s) or self._alone or now_s < self._next_look:
            return
        if self._offset_known:
            if not self._pairing.doubtful:
                return
            self._offset_known = False
            self._seen.clear()
            self._tell("offset", "the camera's timestamp offset has become doubtful: looking for it again")
        if len(self._seen) < OFFSET_FRAMES:
            return
        if self._looking_since is None:
            self._looking_since = now_s
        self._next_look = now_s + TRY_PERIODS * self._mode.period_ns / 1e9
        try:
            offset = calibrate_offset(self._seen, self._pairing.edges, self._mode.period_ns)
        except AnnulusError as error:
            if now_s - self._looking_since > GIVE_UP_S:
                self._looking_since = now_s
                self._tell("offset", f"still no timestamp offset, frames stay unknown: {error}")
            return
        self._pairing.recalibrate(self._mode.period_ns, offset.offset_ns)
        self._offset_known = True
        self._looking_since = None
        self._next_look = now_s + LOOK_AGAIN_S
        self._tell(
            "offset",
            f"camera timestamps are {offset.offset_ns / 1e6:+.2f} ms from the end of readout "
            f"(+-{offset.jitter_ns / 1e6:.2f} ms, {offset.frames} frames)",
        )

    def settled(self, frame: FrameSeen, now_ns: int) -> bool:
        """Whether this frame's label can get no better by waiting."""
        return self._alone or (self._offset_known and self._pairing.settled(frame.timestamp_ns, now_ns))

    def header(self, frame: FrameSeen) -> FrameHeader:
        """The verdict. Ask once for each frame, in the order of capture."""
        mode = self._mode
        blank = FrameHeader(
            0, frame.sequence, frame.timestamp_ns, Label.UNKNOWN, "", None, None, None, None, mode.encoding,
            mode.width, mode.height, camera=mode.camera, arrived_ns=frame.arrived_ns,
        )  # fmt: skip
        if self._alone:
            return self._numbered(_brought_along(blank, frame.metadata), frame.sequence)
        if not self._offset_known:
            return self._numbered(replace(blank, reason=NOT_KNOWN))
        said = self._pairing.label(frame.timestamp_ns, frame.sequence, frame.picture.light)
        if said.label is Label.UNKNOWN or said.flash is None:
            return self._numbered(replace(blank, reason=str(said.reason)))
        flash = said.flash
        place = self._navigation.odometer.place(flash)
        known = replace(
            blank, label=said.label, edge=flash.edge, slot=flash.slot, odometer=flash.odometer,
            z_mm=place.z_mm if place is not None else None,
            z_assumed=place.assumed if place is not None else False,
            segment=place.segment if place is not None else 0,
            roll_deg=self._navigation.roll.at(self._lit_ns(frame.timestamp_ns, flash)),
        )  # fmt: skip
        return self._numbered(known, (flash.epoch, flash.edge))

    def _numbered(self, header: FrameHeader, flash: object = None) -> FrameHeader:
        """Frames that one flash lit share an index, whichever camera they are of."""
        header = replace(header, index=self._navigation.index(header.camera, flash))
        self._navigation.journal.said(header)
        return header

    def _lit_ns(self, timestamp_ns: int, flash: Flash) -> int:
        """The middle of the flash, host time: the flash came so long after the edge one period before readout ended."""
        opening_ns = timestamp_ns - self._pairing.offset_ns - self._mode.period_ns
        return opening_ns + (2 * flash.delay_ticks + flash.width_ticks) * TICK_NS // 2


def _brought_along(blank: FrameHeader, metadata: Mapping[str, Any]) -> FrameHeader:
    """Without a controller: the label a scan folder gave its frame, or none."""
    light, z_mm, roll_deg = (metadata.get(key) for key in ("Light", "ZMm", "RollDeg"))
    if light not in (Label.PROJECTOR.value, Label.LED.value) or not isinstance(z_mm, int | float):
        return replace(blank, reason=NO_CONTROLLER)
    return replace(blank, label=Label(light), z_mm=float(z_mm), roll_deg=roll_deg)
