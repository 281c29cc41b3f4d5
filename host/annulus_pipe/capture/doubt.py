"""What gives a withdrawn proof back.

Timestamp, arrival and driver's count each name the edge that ends a frame. While labels are in doubt the last frames
are kept. Their labels are believed again when a run of frames, edges rising, pictures agreeing, has either

- all three on the same edges: whatever it was has passed;
- two of them on the same edges, and the third off by the same in each: that one has moved, and is set anew.

An edge named by two who were right before, or by all, is the frame's whatever the lamp cycle is. Where a run is not
enough (nobody counts, the pictures were the contradiction) it must be longer, and where the flashes of those seconds
include one that is not the projector's, a picture must have shown it.
"""

from collections import deque
from collections.abc import Callable, Container
from dataclasses import dataclass
from statistics import median

from annulus_pipe.capture.history import EdgeHistory
from annulus_pipe.capture.offset import LAG_PERIODS_MAX, LAG_PERIODS_MIN, WINDOW
from annulus_pipe.capture.photometry import Light
from annulus_pipe.capture.proof import SUSPICIONS, News
from annulus_pipe.capture.slides import ALL_SLIDES, SlidesSeen
from annulus_pipe.vocabulary import CameraSequence, Lamp

GLIMPSES_KEPT = 40  # as long as a doubt lasts: pictures that were against a way count to its end
PASSED_RUN = 2  # frames on which all agree, after a doubt about time
MOVED_RUN = 4  # on which two agree
PICTURES_RUN = 5  # after a doubt about pictures, and where nobody but pictures can say
ALONE_RUN = 8  # where one is alone against one
AGAINST_RUN = 4  # more, for each picture that was against it before
LAMP_LOOKED_FOR = 8  # frames back
ELSEWHERE = 8  # frames before and after, where a run's pictures might fit as well


@dataclass(frozen=True, slots=True)
class Glimpse:
    """What the witnesses said of one frame in doubt. Edges by their ordinals."""

    timestamp_ns: int
    sequence: CameraSequence | None
    light: Light | None  # None: the picture says nothing
    by_stamp: int | None
    by_arrival: int | None
    by_count: int | None
    lag_ns: int | None  # in hand so long after the edge `by_stamp`
    waited: bool


@dataclass(frozen=True, slots=True)
class Agreed:
    """A run of frames that proves their edges, and what it says of each witness."""

    ordinals: tuple[int, ...]  # rising
    offset_ns: float | None  # None: as it was
    ahead: int | None  # driver's count minus ordinal
    lags_ns: tuple[int, ...] | None  # None: as they were
    why: str


class Doubt:
    """The frames since labels were last believed."""

    def __init__(
        self,
        history: EdgeHistory,
        period_ns: int,
        failing: Container[Lamp] = frozenset(),
        slides: SlidesSeen = ALL_SLIDES,
    ) -> None:
        """`failing`: lamps whose flashes lit nothing of late; it changes while the doubt lasts."""
        self._slides = slides
        self._history, self._period_ns, self._failing = history, period_ns, failing
        self._glimpses: deque[Glimpse] = deque(maxlen=GLIMPSES_KEPT)
        self._stamps_impossible = self._by_pictures = False
        self._taken: int | None = None
        self.suspected = False
        self.frames = 0
        self.pictures = 0  # that contradicted

    def begin(self, news: News, taken: int | None, by_pictures: bool) -> None:
        """`taken`: the last edge that had its frame; None where it is not known, or not asked. `by_pictures`: pictures
        have to speak as well, for the others are one witness or were not asked.
        """
        self._glimpses.clear()
        self._taken = taken
        self.suspected = news in SUSPICIONS
        self._by_pictures = by_pictures or self.suspected
        self._stamps_impossible = news in (News.EARLY, News.ORDER, News.BETWEEN)
        self.frames, self.pictures = 0, int(news is News.PICTURE)

    def suspect(self) -> None:
        """A suspicion came to it: from here on, pictures have to speak."""
        self._glimpses.clear()
        self.suspected = self._by_pictures = True

    def add(self, glimpse: Glimpse) -> None:
        self.frames += 1
        self._glimpses.append(glimpse)

    def agreed(self) -> Agreed | None:
        """Whether the last frames prove their edges, the latest included."""
        long = PICTURES_RUN if self.pictures else MOVED_RUN if self._by_pictures else 0
        passed = _on_time if self._stamps_impossible else _all
        for way, run, shown, why in (
            (passed, max(PASSED_RUN, long), bool(self.pictures), "all witnesses agree again"),
            (_stamp_alone, max(PICTURES_RUN, long), True, "pictures agree"),
            (_arrival_and_count, max(MOVED_RUN, long), True, "timestamps have moved"),
            (
                _arrival_alone if self._stamps_impossible and not self._history.preambled else _nobody,
                ALONE_RUN,
                True,
                "timestamps have moved",
            ),
            (
                _nobody if self._stamps_impossible else _stamp_and_arrival,
                max(MOVED_RUN, long),
                True,
                "the driver counts anew",
            ),
            (_stamp_and_count, ALONE_RUN, True, "frames come sooner than they did"),
        ):
            agreed = self._run(way, run, shown, why)
            if agreed is not None:
                return agreed
        return None

    def _run(self, way: Callable[[Glimpse], int | None], length: int, shown: bool, why: str) -> Agreed | None:
        """The run that ends with the latest frame, if it is long enough. `shown`: one of its pictures is of another
        lamp than the projector, if such a lamp lit any of the last LAMP_LOOKED_FOR frames.

        A picture of this doubt that is against this way makes the run longer: in a preamble any four may fit by chance.
        """
        run: list[tuple[Glimpse, int]] = []
        others, ended = 0, False
        for glimpse in reversed(self._glimpses):
            ordinal = way(glimpse)
            if ordinal is None or (self._taken is not None and ordinal <= self._taken):
                ended = True
                continue
            flash = self._history.lit(ordinal)
            fits = self._may_be_of(glimpse, ordinal)
            length += 0 if fits else AGAINST_RUN
            ended |= not fits or (
                bool(run) and (ordinal >= run[-1][1] or self._stepped(way, (glimpse, ordinal), run[0]))
            )
            if not ended:
                run.append((glimpse, ordinal))
                others += flash is not None and glimpse.light is not None and flash.lamp is not Lamp.PROJECTOR
        if len(run) < length:
            return None
        if way in _MOVED and self._may_be_right(run):
            return None
        if self._by_pictures:
            alone = self._fits_nowhere_else(run, self._history.cycle // 2)  # pairing: what moved by more is adrift
            return self._what_it_says(run[::-1], way, why) if alone else None
        if (
            shown
            and not others
            and self._other_lamp_before(run[0][1])
            and not (way in _TWO and self._fits_nowhere_else(run, ELSEWHERE))
            and not (way is _stamp_and_arrival and self._counts_no_edge(run))
        ):
            return None
        return self._what_it_says(run[::-1], way, why)

    def _fits_nowhere_else(self, run: list[tuple[Glimpse, int]], frames: int) -> bool:
        """Whether these pictures are of no other edges so near: a stretch of the projector alone may be as telling as
        the LED. Where they really belong they always fit, so a wrong place is never the only one.
        """
        latest = self._history.edges[-1].ordinal
        return not any(
            run[0][1] + off <= latest and all(self._may_be_of(glimpse, ordinal + off) for glimpse, ordinal in run)
            for off in range(-frames, frames + 1)
            if off
        )

    def _may_be_right(self, run: list[tuple[Glimpse, int]]) -> bool:
        """Whether a preamble had better say that stamps have moved: a driver that gave away a lamp cycle of frames at
        once is sooner by that, and its own count goes on.
        """
        if not self._history.preambled:
            return False
        shown = [glimpse for glimpse, _ in run if glimpse.light is not None]  # a blank one says nothing of its stamp
        return bool(shown) and all(
            g.by_stamp is not None and self._is_free(g, g.by_stamp) and self._may_be_of(g, g.by_stamp) for g in shown
        )

    def _is_free(self, glimpse: Glimpse, ordinal: int) -> bool:
        """Whether that edge may be the frame's for all that time says."""
        in_time = glimpse.lag_ns is not None and glimpse.lag_ns >= LAG_PERIODS_MIN * self._period_ns
        return in_time and (self._taken is None or ordinal > self._taken)

    def _counts_no_edge(self, run: list[tuple[Glimpse, int]]) -> bool:
        """Whether what the driver counts are no edges of these seconds."""
        return all(g.by_count is not None and self._history.numbered(g.by_count) is None for g, _ in run)

    def _may_be_of(self, glimpse: Glimpse, ordinal: int) -> bool:
        flash = self._history.lit(ordinal)
        if flash is None or glimpse.light is None or self._slides.agrees(glimpse.light, flash):
            return True
        return glimpse.light is Light.DARK and flash.lamp in self._failing

    def _stepped(self, way: Callable[..., int | None], one: tuple[Glimpse, int], last: tuple[Glimpse, int]) -> bool:
        """Whether timestamps that have moved had not moved there yet, or that one was off by itself."""
        edges = [self._history.numbered(ordinal) for _, ordinal in (one, last)]
        if way not in _MOVED or edges[0] is None or edges[1] is None:
            return False
        off_ns = (one[0].timestamp_ns - edges[0].host_ns) - (last[0].timestamp_ns - edges[1].host_ns)
        return abs(off_ns) > WINDOW * self._period_ns

    def _other_lamp_before(self, ordinal: int) -> bool:
        """Whether a flash but the projector's lit one of the last frames."""
        flashes = (self._history.lit(ordinal - back) for back in range(LAMP_LOOKED_FOR))
        return any(flash is not None and flash.lamp is not Lamp.PROJECTOR for flash in flashes)

    def _what_it_says(self, run: list[tuple[Glimpse, int]], way: Callable[..., int | None], why: str) -> Agreed | None:
        """None when what has moved has not settled yet."""
        moved_to: float | None = None
        if way in _MOVED:
            placed = [(glimpse.timestamp_ns, self._history.numbered(ordinal)) for glimpse, ordinal in run]
            offsets = [stamp - edge.host_ns for stamp, edge in placed if edge is not None]
            moved_to = median(offsets)
            if any(abs(offset - moved_to) > WINDOW * self._period_ns for offset in offsets):
                return None
        aheads = {glimpse.sequence - ordinal for glimpse, ordinal in run if glimpse.sequence is not None}
        if way is _stamp_and_arrival and len(aheads) != 1:
            return None
        lags: tuple[int, ...] | None = None
        if way in (_stamp_alone, _stamp_and_count):
            lags = tuple(glimpse.lag_ns for glimpse, _ in run if glimpse.lag_ns is not None)
            low, high = LAG_PERIODS_MIN * self._period_ns, LAG_PERIODS_MAX * self._period_ns
            if any(not low <= lag <= high for lag in lags):
                return None
        ordinals = tuple(ordinal for _, ordinal in run)
        return Agreed(ordinals, moved_to, aheads.pop() if len(aheads) == 1 else None, lags, why)


def _all(glimpse: Glimpse) -> int | None:
    """All who have a say, and at least one beside the timestamp. Who had to wait came late by his own fault."""
    edge = glimpse.by_stamp
    if glimpse.by_count not in (None, edge):
        return None
    if glimpse.by_arrival == edge:
        return edge
    return edge if glimpse.by_count is not None and (glimpse.waited or glimpse.lag_ns is None) else None


def _on_time(glimpse: Glimpse) -> int | None:
    """.. and nobody had to wait: a stamp that was impossible may take the count with it, and they seem a backlog."""
    return None if glimpse.waited else _all(glimpse)


def _stamp_alone(glimpse: Glimpse) -> int | None:
    """Where nobody else has anything to say yet."""
    alone = glimpse.by_arrival is None and glimpse.by_count is None and not glimpse.waited
    return glimpse.by_stamp if alone else None


def _arrival_and_count(glimpse: Glimpse) -> int | None:
    return glimpse.by_arrival if glimpse.by_arrival == glimpse.by_count else None


def _arrival_alone(glimpse: Glimpse) -> int | None:
    return glimpse.by_arrival if glimpse.by_count is None else None


def _nobody(glimpse: Glimpse) -> int | None:
    return None


def _stamp_and_arrival(glimpse: Glimpse) -> int | None:
    counted_anew = glimpse.by_count not in (None, glimpse.by_stamp)
    return glimpse.by_stamp if glimpse.by_stamp == glimpse.by_arrival and counted_anew else None


def _stamp_and_count(glimpse: Glimpse) -> int | None:
    sooner = glimpse.by_stamp is not None and not glimpse.waited and glimpse.by_arrival != glimpse.by_stamp
    return glimpse.by_stamp if sooner and glimpse.by_stamp == glimpse.by_count else None


_MOVED = (_arrival_and_count, _arrival_alone)  # ways in which timestamps are what is off
_TWO = (_arrival_and_count, _stamp_and_arrival)  # that agree against the third
