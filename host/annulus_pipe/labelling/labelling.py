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

from annulus_pipe.capture.offset import Offset, calibrate_offset
from annulus_pipe.capture.pairing import Pairing
from annulus_pipe.capture.photometry import Light
from annulus_pipe.capture.proof import ProofState, Witness
from annulus_pipe.capture.seen import FrameSeen as FrameSeen
from annulus_pipe.capture.seen import Labelled
from annulus_pipe.capture.slides import SlidesSeen
from annulus_pipe.capture.witnesses import PICTURES_KEPT
from annulus_pipe.controller import TICK_NS
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import AnnulusError, EdgeFlag, Flash, Label, Lamp

OFFSET_FRAMES = 15  # seen before the camera's offset is tried ..
OFFSET_FRAMES_KEPT = 96  # .. and looked at: enough where one stamp in four is off by itself
UNLABELLED_S = 30.0  # without a label the operator is told, each time this has passed
TRY_PERIODS = 1.0  # between two attempts
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
    slides: int = 1  # of the head, that are lit in turn
    sees: tuple[int, ...] = ()  # those of them whose light it sees; none: all


class Labelling:
    """Sans-I/O: the caller says what time it is. `tell(kind, text)` is for the operator."""

    def __init__(
        self,
        mode: CameraMode,
        navigation: Navigation,
        tell: Callable[[str, str], None],
        alone: bool,
        *,
        preambles: bool = False,
        without: frozenset[Witness] = frozenset(),
    ) -> None:
        """`alone`: there is no controller; labels are those the frames bring, or unknown. `preambles`: the controller
        makes some, and one who reads the evidence from the middle has to know. `without`: witnesses that are not asked,
        to show what they are good for.
        """
        self._mode, self._navigation, self._alone = mode, navigation, alone
        navigation.journal.camera(alone, **asdict(mode), preambles=preambles)
        self._tell, self._without = tell, without
        self._slides = SlidesSeen(mode.slides, mode.sees)
        self._pairing = Pairing(
            mode.period_ns,
            history=navigation.edges,
            without=without,
            tell=lambda text: tell("labels", text),
            slides=self._slides,
        )
        self._seen: deque[FrameSeen] = deque(maxlen=OFFSET_FRAMES_KEPT)  # since labels were last believed
        self._shown: deque[int] = deque(maxlen=PICTURES_KEPT)  # fingerprints of the last pictures ..
        self._missing = 0  # periods without a frame since the search began, that no count spans
        self._again = 0  # .. and how many that were shown before came one after the other
        self._sound_from_ns = 0  # arrival of the first frame behind the last that may have moved pictures
        self._proved_from_ns = 0  # arrival of the first frame that the search looked at: it knows of none before
        self._labelled_s: float | None = None  # when a frame last had a label, or the operator was told that none has
        self._unproved = ""  # what the last search said
        self._next_look = 0.0

    @property
    def offset_known(self) -> bool:
        """Whether frames get their verdict as they come, and need not wait for the search."""
        return self._alone or self._pairing.state is not ProofState.SEARCHING

    @property
    def wants_preamble(self) -> bool:
        """Whether an optical preamble, lamps in an order that does not repeat, would end a doubt about the labels."""
        return not self._alone and self._pairing.doubtful and not self._pairing.passing

    @property
    def state(self) -> ProofState:
        return self._pairing.state

    def numbers(self) -> dict[str, Any]:
        """For the telemetry."""
        pairing = self._pairing
        return {
            "labels": pairing.state.value,
            "offset_ns": pairing.offset_ns,
            "offset_error_ns": pairing.offset_error_ns,
            "offset_rate_ppb": round(pairing.rate * 1e9),
            "lag_ns": pairing.lag_ns,
            "contradictions": dict(pairing.contradictions),
        }

    def saw(self, frame: FrameSeen) -> None:
        """A frame has come; it may help to find the offset long before it can be labelled."""
        self._navigation.journal.saw(
            self._mode.camera, frame.sequence, frame.timestamp_ns, frame.arrived_ns, frame.picture, frame.metadata
        )
        if frame.picture.light is not Light.DARK and frame.picture.fingerprint is not None:
            self._again = self._again + 1 if frame.picture.fingerprint in self._shown else 0
            self._shown.append(frame.picture.fingerprint)
        if not self.offset_known and self._seen:
            self._missing += self._missed(frame, self._seen[-1])
            if max(self._missing, self._again) >= self._navigation.edges.cycle / 2:
                self._seen.clear()  # what those before prove, those from here on need not obey
        self._missing = self._missing if self._seen else 0
        garbage = frame.picture.light in (Light.BOTH, Light.UNCLEAR) and not self._slides.seen  # or it looked away
        if self._again or (garbage and not frame.picture.torn):
            self._sound_from_ns = frame.arrived_ns + 1
        elif self._seen and frame.sequence is None and self._missed(frame, self._seen[-1]):
            self._sound_from_ns = frame.arrived_ns
        if not self._again:  # a picture of before says nothing of now
            self._seen.append(frame)

    def _missed(self, frame: FrameSeen, last: FrameSeen) -> int:
        """Periods without a frame between two, where the driver did not count as many."""
        periods = round((frame.arrived_ns - last.arrived_ns) / self._mode.period_ns)
        counted = None if frame.sequence is None or last.sequence is None else frame.sequence - last.sequence
        half = self._navigation.edges.cycle / 2  # a longer silence parts them whatever the count says
        return 0 if counted == periods and periods <= half else max(0, periods - 1)

    def restarted(self) -> None:
        """The camera began anew, and its stamps may be off by something else; what came before has its label."""
        self._navigation.journal.note("restarted", camera=self._mode.camera)
        self._pairing.restarted()
        self._seen.clear()

    def look_for_offset(self, now_s: float) -> None:
        """At the start, and again whenever doubt did not end. Until it is found, frames are unknown."""
        if self.offset_known or now_s < self._next_look or len(self._seen) < OFFSET_FRAMES:
            return
        if not self._navigation.journal.looks(self._mode.camera, now_s):
            return
        self._next_look = now_s + TRY_PERIODS * self._mode.period_ns / 1e9
        try:
            offset = calibrate_offset(
                self._seen,
                self._navigation.edges,
                self._mode.period_ns,
                arrivals=Witness.ARRIVAL not in self._without,
                preamble=Witness.PREAMBLE not in self._without,
                before=self._pairing.before,
                adrift=self._pairing.adrift,
                slides=self._slides,
            )
        except AnnulusError as error:
            self._unproved = str(error)
            return
        self._tell(
            "offset",
            f"camera timestamps are {offset.offset_ns / 1e6:+.2f} ms from the end of readout "
            f"(+-{offset.jitter_ns / 1e6:.2f} ms, {offset.frames} frames)",
        )
        self._proved_from_ns = max(self._seen[0].arrived_ns, self._sound_from_ns, self._unlit_until_ns(offset))
        self._pairing.believe(offset)

    def _unlit_until_ns(self, offset: Offset) -> int:
        """Of the frames that a search looked at: behind the last that is dark though its flash was fired."""
        edges, last = self._navigation.edges, 0
        for frame in self._seen:
            if frame.picture.light is Light.DARK:
                flash = edges.lit(edges.nearest(frame.timestamp_ns - offset.offset_ns).ordinal)
                lit = flash is not None and flash.lamp is not Lamp.DARK and not self._slides.blind(flash)
                last = frame.arrived_ns + 1 if lit else last
        return last

    def settled(self, frame: FrameSeen, now_ns: int) -> bool:
        """Whether this frame's label can get no better by waiting."""
        return self._alone or (self.offset_known and self._pairing.settled(frame, now_ns))

    def header(self, frame: FrameSeen) -> FrameHeader:
        """The verdict. Ask once for each frame, in the order of capture."""
        if self._alone:
            blank = self._blank(frame, "", frame.sequence)
            return self._journalled(_brought_along(blank, frame.metadata))
        if not self.offset_known or frame.arrived_ns < self._proved_from_ns:
            self._pairing.passed(frame)
            return self._journalled(self._blank(frame, NOT_KNOWN))
        verdict = self._verdict(frame)
        if verdict.label is Label.UNKNOWN or verdict.flash is None or verdict.opened_ns is None:
            return self._journalled(self._blank(frame, str(verdict.reason)))
        mode, flash = self._mode, verdict.flash
        place = self._navigation.odometer.place(flash)
        known = FrameHeader(
            self._index((flash.epoch, flash.edge)),
            frame.sequence,
            frame.timestamp_ns,
            verdict.label,
            "",
            flash.edge,
            None if EdgeFlag.PREAMBLE in flash.flags else flash.slot,
            None if EdgeFlag.ODOMETER_FROZEN in flash.flags else flash.odometer,
            place.z_mm if place is not None else None,
            mode.encoding,
            mode.width,
            mode.height,
            camera=mode.camera,
            arrived_ns=frame.arrived_ns,
            roll_deg=self._navigation.roll.at(_lit_ns(verdict.opened_ns, flash)),
            z_assumed=place.assumed if place is not None else False,
            z_bound_mm=place.bound_mm if place is not None else 0.0,
            segment=place.segment if place is not None else 0,
        )
        return self._journalled(known)

    def _blank(self, frame: FrameSeen, reason: str, flash: object = None) -> FrameHeader:
        """Of a frame without a label."""
        mode = self._mode
        return FrameHeader(
            self._index(flash),
            frame.sequence,
            frame.timestamp_ns,
            Label.UNKNOWN,
            reason,
            None,
            None,
            None,
            None,
            mode.encoding,
            mode.width,
            mode.height,
            camera=mode.camera,
            arrived_ns=frame.arrived_ns,
        )

    def _verdict(self, frame: FrameSeen) -> Labelled:
        before = self._pairing.state
        labelled = self._pairing.label(frame)
        if before is ProofState.PROVED and self._pairing.state is not ProofState.PROVED:
            self._seen.clear()  # a search, should it come to that, is not to be misled by what was before
        return labelled

    def _index(self, flash: object) -> int:
        """Frames that one flash lit share one, whichever camera they are of."""
        return self._navigation.index(self._mode.camera, flash)

    def _journalled(self, header: FrameHeader) -> FrameHeader:
        self._navigation.journal.label(header)
        now_s = (header.arrived_ns or 0) / 1e9
        if header.label is not Label.UNKNOWN or self._labelled_s is None or self._alone:
            self._labelled_s = now_s
        elif now_s - self._labelled_s > UNLABELLED_S:
            self._labelled_s = now_s
            why = self._unproved if not self.offset_known and self._unproved else header.reason
            self._tell(
                "unlabelled", f"no frame of camera {self._mode.camera} had a label for {UNLABELLED_S:.0f} s: {why}"
            )
        return header


def _lit_ns(opened_ns: int, flash: Flash) -> int:
    """The middle of the flash, host time."""
    return opened_ns + (2 * flash.delay_ticks + flash.width_ticks) * TICK_NS // 2


def _brought_along(blank: FrameHeader, metadata: Mapping[str, Any]) -> FrameHeader:
    """Without a controller: the label a scan folder gave its frame, or none."""
    light, z_mm, roll_deg = (metadata.get(key) for key in ("Light", "ZMm", "RollDeg"))
    if light not in (Label.PROJECTOR.value, Label.LED.value) or not isinstance(z_mm, int | float):
        return replace(blank, reason=NO_CONTROLLER)
    return replace(blank, label=Label(light), z_mm=float(z_mm), roll_deg=roll_deg)
