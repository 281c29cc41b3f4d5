"""Says which flash lit a frame, or that nobody knows. A wrong answer is the one sin; unknown is legal and counted.

Frame n is the frame whose readout ends at edge n, and it was lit by the flash fired after edge n-1. So: take the
frame's timestamp, subtract the camera's offset, find the one edge near that moment (the closing edge), take the edge
before it in the same controller life (the opening edge), and believe the flash it announced only if everything agrees:
both edges regular, armed, one period apart, no reset, fault or arming in between, and every witness: the frame was not
in hand before its edge, each edge has one frame and they rise, the driver counted as many frames as there were edges,
and the picture shows that lamp, in all its bands, and was not shown before. Nothing is counted by arrival.

A witness that contradicts costs the frame its label and withdraws the proof (proof.py): labels stay unknown until a
run of frames gives it back (doubt.py), or a search from nothing does (offset.py). Where frames may have been kept, lost
or shown anew by a whole lamp cycle (a silence that no count spans, a camera that began anew, pictures that come again)
no run does: pictures of a preamble have to tell.

    pairing = Pairing(period_ns, history=history)             # history is fed with edges as they come, in any order
    pairing.believe(calibrate_offset(frames, history, period_ns))
    if pairing.settled(frame, now):                           # its edges are here, or will not come any more
        labelled = pairing.label(frame)                       # frames in the order of capture
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from annulus_pipe.capture.continuity import Continuity
from annulus_pipe.capture.doubt import Agreed, Doubt, Glimpse
from annulus_pipe.capture.history import EdgeHistory, PlacedEdge
from annulus_pipe.capture.offset import CLEAR, WINDOW, Offset, OffsetTrack, ProvedOffset
from annulus_pipe.capture.photometry import Light
from annulus_pipe.capture.proof import CONTRADICTIONS, SUSPICIONS, News, ProofState, Reason, Witness, next_state
from annulus_pipe.capture.seen import FrameSeen, Labelled
from annulus_pipe.capture.slides import ALL_SLIDES, SlidesSeen
from annulus_pipe.capture.witnesses import Arrivals, Count, Delivery, RecentPictures
from annulus_pipe.vocabulary import CameraSequence, EdgeFlag, Label, Lamp

INTERVAL_TOLERANCE = 0.1  # of a period: between opening and closing edge
CROWDED = 0.8  # of a period: two frames of one edge that come so soon one after the other are one too many
SPOILT_RUN = 3  # torn pictures or no lamp's, one after the other: of buffers. Fewer are of a flash that lies in two
SOUND_AGAIN = 3  # pictures of a lamp that failed: one that flickers is no hiccup each time
HURRIED = 0.5  # of a period: frames that come so soon one after the other were in a queue
SETTLE_PERIODS = 3.0  # how long a frame waits for an edge that has to be read again
DOUBT_FRAMES_MAX = 32  # without agreement, before all is searched anew ..
SUSPECTED_FRAMES_MAX = 8  # before a mere suspicion calls for a preamble
DOUBT_PICTURES_MAX = 3  # .. and pictures that contradict

_LABELS = {Lamp.PROJECTOR: Label.PROJECTOR, Lamp.LED: Label.LED}
_IRREGULAR, _LATE_LOAD, _DISARMED = (  # as plain numbers: asked for every frame
    int(flag) for flag in (EdgeFlag.IRREGULAR, EdgeFlag.LATE_LOAD, EdgeFlag.DISARMED)
)
_MISPLACED = frozenset({Reason.EARLY, Reason.ORDER, Reason.SEQUENCE})  # the edge may be another frame's
_UNLIT = frozenset(  # no flash, or one that may not have been fired
    {Reason.DARK, Reason.DISARMED, Reason.CUT, Reason.IRREGULAR, Reason.LATE}
)
_TIMED = frozenset({Reason.AGREED, Reason.DARK})  # nothing but the picture can speak against it


class _Judged(NamedTuple):
    """What edges and time say."""

    reason: Reason
    closing: PlacedEdge | None = None
    opening: PlacedEdge | None = None


class Pairing:
    """Labels one camera's frames. Holds bounded history, no thread, no clock."""

    def __init__(
        self,
        period_ns: int,
        *,
        history: EdgeHistory | None = None,
        without: frozenset[Witness] = frozenset(),
        tell: Callable[[str], None] | None = None,
        slides: SlidesSeen = ALL_SLIDES,
    ) -> None:
        """`history` is fed by whoever made it; without one, feed `edge` and `invalidate` here. `without`: who is not
        asked, to show what they are good for. `tell` hears of every change of state, in a line.
        """
        self.counters: Counter[str] = Counter()  # frames by reason
        self.contradictions: Counter[str] = Counter()  # by kind
        self.history = history or EdgeHistory()
        self.edge, self.invalidate = self.history.edge, self.history.invalidate
        self._period_ns, self._without, self._tell, self._slides = period_ns, without, tell, slides
        self._state = ProofState.SEARCHING
        self._track = OffsetTrack(0, period_ns)
        self._arrivals, self._count, self._pictures = Arrivals(period_ns), Count(), RecentPictures()
        self._delivery = Delivery()
        self.before: ProvedOffset | None = None  # what was proved before the camera began anew
        self.adrift = False  # frames may have been kept or lost by whole lamp cycles since
        self._continuity = Continuity(self.history, self._delivery)
        self._failing: dict[Lamp, int] = {}  # lamps that lit no picture; by how many they are sound again
        self._doubt = Doubt(self.history, period_ns, self._failing, slides)
        self._last: int | None = None  # ordinal of the last frame's closing edge ..
        self._since = 0  # frames since that one
        self._searched_to: int | None = None  # .. and of the last that the search looked at
        self._latest_ns = 0  # timestamp ..
        self._arrived_ns: int | None = None  # .. and arrival, of the last frame
        self._dark = 0  # pictures whose flash is not known yet, one after the other
        self._lit: PlacedEdge | None = None  # the last edge whose flash is known
        self._spoilt = 0  # torn pictures or no lamp's, one after the other
        self._odd = False  # the last picture was blank, or shown before

    @property
    def state(self) -> ProofState:
        return self._state

    @property
    def offset_ns(self) -> int:
        return round(self._track.at(self._latest_ns))

    @property
    def rate(self) -> float:
        """Of the offset, ns per ns: how fast the driver's clock runs away from the controller's."""
        return self._track.rate

    @property
    def lag_ns(self) -> int | None:
        """How long after its edge a frame usually is in hand. None: not known."""
        return self._arrivals.usual_ns

    @property
    def offset_error_ns(self) -> int:
        """How far the frames have lately been from where the offset puts them; near 0 when all is well."""
        return round(self._track.residual_ns)

    @property
    def doubtful(self) -> bool:
        """Every label is unknown meanwhile."""
        return self._state is not ProofState.PROVED

    @property
    def passing(self) -> bool:
        """In doubt, but the next pictures of the lamp cycle will do: a preamble is not worth its dark frames."""
        return self._state is ProofState.DOUBTED and self._doubt.suspected and self._doubt.frames < SUSPECTED_FRAMES_MAX

    @property
    def _window_ns(self) -> int:
        return round(WINDOW * self._period_ns)

    def believe(self, offset: Offset) -> None:
        """What a search has just found."""
        self._begin(offset.offset_ns)
        self._arrivals.believe(offset.lags_ns)
        self._delivery.believe(offset.off_ns, offset.lags_ns)
        self._count.believe(offset.count)
        self._searched_to = offset.last
        self._move(News.FOUND, f"{offset.offset_ns / 1e6:+.2f} ms fits {offset.frames} frames")
        if offset.holed and self.history.preambled and Witness.ORDER not in self._without:
            self._move(News.SKIPPED)

    def recalibrate(self, period_ns: int, offset_ns: int, *, proved: bool = True) -> None:
        """Another frame rate or offset. False: the offset is from another day, pictures have to prove it."""
        self._period_ns = period_ns
        self._begin(offset_ns)
        self._move(News.FOUND if proved or Witness.LAMP in self._without else News.GIVEN, "told so")

    def restarted(self) -> None:
        """The camera began anew. It may keep more frames than before, or stamp them otherwise."""
        self._adrift("the camera began anew")

    def settled(self, frame: FrameSeen, now_ns: int) -> bool:
        """Whether waiting longer can still help. True once both edges are held, or after SETTLE_PERIODS."""
        moment = frame.timestamp_ns - self._track.at(frame.timestamp_ns)
        ended = moment if Witness.ARRIVAL in self._without else min(moment, frame.arrived_ns)  # it may be of the future
        if now_ns - ended > SETTLE_PERIODS * self._period_ns:
            return True
        near = self.history.near(moment, self._window_ns)
        return len(near) == 1 and self.history.opening(near[0]) is not None

    def label(self, frame: FrameSeen) -> Labelled:
        """The verdict on a frame. Frames in the order of capture."""
        if self._state is ProofState.SEARCHING:
            return self.passed(frame)
        self._latest_ns = frame.timestamp_ns
        met = self._pictures.met(frame.picture)
        repeated = met is Witness.REPEATED and Witness.REPEATED not in self._without
        torn = met is Witness.TORN and Witness.TORN not in self._without
        light = None if repeated or torn or Witness.LAMP in self._without else frame.picture.light
        judged = self._judge(frame)
        reason = self._look(judged, light)
        blind = judged.opening is not None and self._slides.blind(judged.opening.flash)
        garbage = light in (Light.BOTH, Light.UNCLEAR) and not blind
        blanks = self._blank(frame, judged, light)
        self._odd = repeated or blanks + self._dark > 0 or (self._odd and light is Light.DARK)
        self._spoilt = self._spoilt + 1 if torn or garbage else self._spoilt if self._odd else 0
        spoilt = SPOILT_RUN if self._spoilt == SPOILT_RUN else int(self._spoilt > SPOILT_RUN and (torn or garbage))
        self._since += 1
        suspicion = self._suspicion(judged, reason, repeated, blanks + spoilt > 0)
        for news in (self._contradiction(reason, light), suspicion):
            if news is not None:
                self.contradictions[news.value] += 1
                self._doubt.pictures += news is News.PICTURE
                self._move(news)
        one_more = judged.reason is Reason.ORDER and self._hurried(frame, CROWDED)
        if one_more:  # of an edge that had its frame: one of the two may be a picture too soon
            self._doubt.suspect()
        adrift = self._may_have_lost_a_cycle(frame, judged, repeated + blanks + one_more + spoilt)
        if adrift:
            self._adrift(adrift)
            return self._nothing()
        if self.doubtful and self._given_back(frame, judged, None if blanks else light):
            judged = self._judge(frame)
            reason = self._look(judged, light)
        if judged.closing is not None and self._contradiction(reason, None) is None and not self.doubtful:
            self._learn(frame, judged.closing)
        blind = judged.opening is not None and self._slides.blind(judged.opening.flash)
        before = repeated or (blind and self._pictures.again)  # of dark ones nothing but noise tells
        if reason in _TIMED and (before or torn):
            reason = Reason.REPEATED if before else Reason.TORN
        if reason is Reason.AGREED and self.doubtful:
            reason = Reason.OFFSET
        shows = judged.opening.flash.lamp if judged.opening and light is not None and not blind else None
        self._continuity.agreed(shows if reason is Reason.AGREED else None)
        self.counters[reason] += 1
        self._arrived_ns = frame.arrived_ns
        return self._labelled(frame, judged, reason)

    def passed(self, frame: FrameSeen) -> Labelled:
        """The verdict on a frame of which the offset that is known says nothing."""
        self._pictures.met(frame.picture)
        return self._nothing()

    def _nothing(self) -> Labelled:
        self.counters[Reason.OFFSET] += 1
        return Labelled(Label.UNKNOWN, None, Reason.OFFSET, None)

    # ---- the verdict ----

    def _judge(self, frame: FrameSeen) -> _Judged:
        """What timing says."""
        moment = frame.timestamp_ns - self._track.at(frame.timestamp_ns)
        near = self.history.near(moment, self._window_ns)
        if len(near) != 1:
            return _Judged(Reason.TWO_EDGES if near else self._astray(frame, moment))
        closing = near[0]
        opening = self.history.opening(closing)
        reason = self._contradicted(frame, closing) or self._edges_say(opening, closing)
        if reason is Reason.AGREED and self._counted(frame.sequence) is None:
            reason = self._uncounted(frame, closing)
        return _Judged(reason, closing, opening)

    def _astray(self, frame: FrameSeen, moment: float) -> Reason:
        """There is no edge where the timestamp says. Because it was lost, or because the timestamp is wrong?"""
        if Witness.ARRIVAL not in self._without and moment > frame.arrived_ns + self._window_ns:
            return Reason.EARLY
        if self.history.surrounded(moment, 1.5 * self._period_ns):
            return Reason.BETWEEN
        last = None if self._last is None else self.history.numbered(self._last)
        if last is not None and moment < last.host_ns and Witness.ORDER not in self._without:
            return Reason.ORDER
        counted = self._counted(frame.sequence)
        return Reason.NO_EDGE if counted is None or self.history.numbered(counted) is None else Reason.SEQUENCE

    def _contradicted(self, frame: FrameSeen, closing: PlacedEdge) -> Reason | None:
        """What witnesses of time say against this edge."""
        lag = self._lag(frame, closing)
        if lag is not None and self._arrivals.early(lag):
            return Reason.EARLY
        if Witness.ORDER not in self._without and self._last is not None and closing.ordinal <= self._last:
            return Reason.ORDER
        if self._counted(frame.sequence) not in (None, closing.ordinal):
            return Reason.SEQUENCE
        return None

    def _edges_say(self, opening: PlacedEdge | None, closing: PlacedEdge) -> Reason:
        if opening is None:
            return Reason.OPENING_LOST
        flash, flags = opening.flash, int(opening.flash.flags) | int(closing.flash.flags)
        off = closing.host_ns - opening.host_ns - self._period_ns
        if flags & _IRREGULAR or abs(off) > INTERVAL_TOLERANCE * self._period_ns:
            return Reason.IRREGULAR
        if int(flash.flags) & _LATE_LOAD:
            return Reason.LATE
        if flags & _DISARMED:
            return Reason.DISARMED
        if flash.lamp not in _LABELS or flash.width_ticks == 0:
            return Reason.DARK
        return Reason.CUT if self.history.cut(opening, closing) else Reason.AGREED

    def _uncounted(self, frame: FrameSeen, closing: PlacedEdge) -> Reason:
        """Where no count stands by the timestamp, arrival and order have to, both."""
        lag = self._lag(frame, closing)
        if lag is not None and (self._hurried(frame) or self._arrivals.waited(lag)):
            return Reason.LATER if self._arrivals.for_good else Reason.WAITED
        if self._last is None and self._searched_to is not None and closing.ordinal > self._searched_to:
            self._last = self._searched_to
        if self._last is None:  # the first of those that a search looked at: it may be the late one
            skipped = self._delivery.pairs > 0 and self._delivery.one_witness
        else:
            skipped = closing.ordinal != self._last + 1
        return Reason.SKIPPED if skipped and Witness.ORDER not in self._without else Reason.AGREED

    def _look(self, judged: _Judged, light: Light | None) -> Reason:
        """Timing has said what lamp it was. What does the picture say?"""
        if judged.reason not in _TIMED or judged.opening is None or light is None:
            return judged.reason
        flash = judged.opening.flash
        if self._slides.agrees(light, flash) or (
            Witness.PREAMBLE in self._without and EdgeFlag.PREAMBLE in flash.flags
        ):
            return judged.reason
        if light is Light.DARK:
            return Reason.BLANK
        return Reason.UNCLEAR if light is Light.UNCLEAR else Reason.PICTURE

    def _contradiction(self, reason: Reason, light: Light | None) -> News | None:
        """Darkness would speak of a dead lamp, and both at once of something else; neither of a wrong offset."""
        if reason is Reason.PICTURE and light not in (Light.PROJECTOR, Light.LED):
            return None
        return News(reason.value) if reason.value in CONTRADICTIONS else None

    def _blank(self, frame: FrameSeen, judged: _Judged, light: Light | None) -> int:
        """Pictures, this one included, that are dark though a flash was fired, and no lamp known to fail: of buffers
        that nothing was written into. Where no edge tells of a flash, the next that does says whether lamps were on.
        """
        opening = judged.opening if judged.reason not in _MISPLACED else None
        if opening is None:
            counted = self._counted(frame.sequence)
            ordinal = self._arrival_says(frame) if counted is None else counted
            closing = None if ordinal is None else self.history.numbered(ordinal)
            opening = None if closing is None else self.history.opening(closing)
        if opening is None:
            self._dark += light is Light.DARK and not self._slides.seen  # else it may have looked away
            return 0
        flash, was = opening.flash, self._lit
        alight = was is not None and was.boot_epoch == opening.boot_epoch and not self.history.cut(was, opening)
        dark, self._dark, self._lit = self._dark if alight else 0, 0, opening
        if self._slides.blind(flash):
            return dark
        fired = judged.reason not in _UNLIT and flash.width_ticks and not flash.flags & _DISARMED
        if fired and light is Light.DARK:
            new = self._odd or flash.lamp not in self._failing
            self._failing[flash.lamp] = SOUND_AGAIN
            return dark + new
        if self._slides.agrees(light, flash) and (left := self._failing.pop(flash.lamp, 1) - 1):
            self._failing[flash.lamp] = left
        return dark

    def _suspicion(self, judged: _Judged, reason: Reason, repeated: bool, blank: bool) -> News | None:
        """What contradicts nobody, but may be the first of frames that are not what they seem."""
        if repeated:
            return News.REPEATED
        if blank:
            return News.BLANK
        if reason is not Reason.SKIPPED or self._last is None or judged.closing is None:
            return None
        none_missing = self._state is ProofState.DOUBTED and judged.closing.ordinal - self._last <= self._since
        return None if none_missing else News.SKIPPED

    def _may_have_lost_a_cycle(self, frame: FrameSeen, judged: _Judged, moved: int) -> str:
        """Why nothing but a preamble can tell now which frame this is; empty where something else does."""
        if not self._asks_preambles:
            return ""
        periods = None if self._arrived_ns is None else (frame.arrived_ns - self._arrived_ns) / self._period_ns
        count = self._counted(frame.sequence)
        named = judged.closing is not None and judged.reason is not Reason.ORDER
        counted = None if count is None else named and judged.closing is not None and count == judged.closing.ordinal
        return self._continuity.broken(periods, counted, moved, count is not None and judged.reason is Reason.NO_EDGE)

    @property
    def _asks_preambles(self) -> bool:
        return Witness.PREAMBLE not in self._without and Witness.ARRIVAL not in self._without

    def _labelled(self, frame: FrameSeen, judged: _Judged, reason: Reason) -> Labelled:
        if judged.closing is None:
            return Labelled(Label.UNKNOWN, None, reason, None)
        residual = round(frame.timestamp_ns - self._track.at(frame.timestamp_ns)) - judged.closing.host_ns
        if judged.opening is None:
            return Labelled(Label.UNKNOWN, None, reason, residual)
        flash = judged.opening.flash
        label = _LABELS[flash.lamp] if reason is Reason.AGREED else Label.UNKNOWN
        return Labelled(label, flash, reason, residual, judged.opening.host_ns)

    # ---- the proof ----

    def _given_back(self, frame: FrameSeen, judged: _Judged, light: Light | None) -> bool:
        """A frame in doubt: does it, with those before, end the doubt?"""
        if judged.reason in (Reason.NO_EDGE, Reason.TWO_EDGES):
            return False
        closing = judged.closing
        lag = self._lag(frame, closing) if closing is not None else None
        self._doubt.add(
            Glimpse(
                frame.timestamp_ns,
                self._sequence(frame),
                light if light in CLEAR else None,
                closing.ordinal if closing is not None else None,
                self._arrival_says(frame),
                self._counted(frame.sequence),
                lag,
                lag is not None and self._arrivals.waited(lag),
            )
        )
        agreed = self._doubt.agreed()
        overruled = agreed is not None and agreed.ahead not in (None, self._count.ahead)
        if agreed is not None and self._last is not None and (overruled or self._counted(frame.sequence) is None):
            self._continuity.missed(agreed.ordinals[-1] - self._last - self._doubt.frames)
            if self._continuity.lost:
                return False  # the next frame finds them adrift
        if agreed is not None and not self._continuity.unspanned:
            self._restore(frame, agreed)
            return True
        if self._doubt.frames > DOUBT_FRAMES_MAX or self._doubt.pictures >= DOUBT_PICTURES_MAX:
            self._give_up()
        return False

    def _give_up(self) -> None:
        """What nothing explained for so long may be frames that are kept by cycles, a few at a time."""
        if self._asks_preambles and self.history.preambled:
            self._adrift("given up")
        else:
            self._move(News.GIVEN_UP, "given up")

    def _restore(self, frame: FrameSeen, agreed: Agreed) -> None:
        self._last, self._since = agreed.ordinals[-2], 1
        if agreed.offset_ns is not None:
            self._track.moved(frame.timestamp_ns, agreed.offset_ns)
        if agreed.ahead is not None:
            self._count.believe(agreed.ahead)
        if agreed.lags_ns is not None:
            self._arrivals.believe(agreed.lags_ns)
        self._move(News.AGREED, agreed.why)

    def _learn(self, frame: FrameSeen, closing: PlacedEdge) -> None:
        """From a frame that nobody contradicts."""
        if self._last is not None and self._counted(frame.sequence) is None:
            self._continuity.missed(closing.ordinal - self._last - 1)
        self._last, self._since = closing.ordinal, 0
        opening = self.history.opening(closing)
        if opening is not None and EdgeFlag.PREAMBLE in opening.flash.flags:
            self._continuity.vouched()
        if int(closing.flash.flags) & _IRREGULAR:
            return
        stamp = frame.timestamp_ns
        off_ns = stamp - self._track.at(stamp) - closing.host_ns
        self._track.follow(stamp, off_ns)
        lag, sequence = self._lag(frame, closing), self._sequence(frame)
        if lag is not None:
            self._delivery.learn(round(off_ns), lag)
            self._arrivals.learn(lag, self._counted(frame.sequence) is not None)
        if sequence is not None:
            self._count.learn(sequence, closing.ordinal)

    def _begin(self, offset_ns: int) -> None:
        self._track = OffsetTrack(offset_ns, self._period_ns)
        self._arrivals, self._count = Arrivals(self._period_ns), Count()
        self._doubt = Doubt(self.history, self._period_ns, self._failing, self._slides)
        self._delivery = Delivery()
        self._last = self._searched_to = self._arrived_ns = self.before = None
        self._continuity = Continuity(self.history, self._delivery)
        self._dark = 0
        self.adrift = False

    def _adrift(self, why: str) -> None:
        if self._state in (ProofState.PROVED, ProofState.DOUBTED):
            self.before = ProvedOffset(self._track.at(self._latest_ns), self._arrivals.usual_ns)
        self.adrift = True
        self._move(News.ADRIFT, why)

    def _move(self, news: News, why: str = "") -> None:
        before, self._state = self._state, next_state(self._state, news)
        if self._state is before:
            again = news is News.SKIPPED and self._doubt.suspected  # a hole is met again with every frame behind it
            if self._state is ProofState.DOUBTED and news in SUSPICIONS and not again:
                self._doubt.suspect()
            return
        if self._state in (ProofState.DOUBTED, ProofState.TENTATIVE):
            taken = None if Witness.ORDER in self._without else self._last
            self._doubt.begin(news, taken, Witness.ARRIVAL not in self._without and self._delivery.one_witness)
        if self._tell is not None:
            self._tell(f"labels were {before}, now {self._state}: {why or news}")

    # ---- who says what ----

    def _sequence(self, frame: FrameSeen) -> CameraSequence | None:
        return None if Witness.COUNT in self._without else frame.sequence

    def _counted(self, sequence: CameraSequence | None) -> int | None:
        """The ordinal of the edge that the driver's count names."""
        if sequence is None or self._count.ahead is None or Witness.COUNT in self._without:
            return None
        return sequence - self._count.ahead

    def _lag(self, frame: FrameSeen, closing: PlacedEdge) -> int | None:
        return None if Witness.ARRIVAL in self._without else frame.arrived_ns - closing.host_ns

    def _hurried(self, frame: FrameSeen, periods: float = HURRIED) -> bool:
        """Whether it came on the heels of the one before: both had waited, and its time says less than it seems to."""
        before = self._arrived_ns
        return before is not None and frame.arrived_ns - before < periods * self._period_ns

    def _arrival_says(self, frame: FrameSeen) -> int | None:
        """The ordinal of the edge that the frame's arrival names, where it did not have to wait."""
        usual = self._arrivals.usual_ns
        if usual is None or Witness.ARRIVAL in self._without or self._hurried(frame):
            return None
        moment = frame.arrived_ns - usual
        near: Sequence[PlacedEdge] = self.history.near(moment - self._period_ns / 8, 0.375 * self._period_ns)
        return near[0].ordinal if len(near) == 1 else None
