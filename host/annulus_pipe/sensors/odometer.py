"""How far along the pipe: the controller's odometer counts to millimetres, across restarts and across being zeroed.

Counts begin at zero with every boot of the controller; the pipe does not. Within a boot z is counted, however many
edges are lost: an edge brings the whole count. Across a boot nobody counted. The head is then taken to have moved on at
the speed it had, a new segment of z begins, and its places are marked as assumed, with a bound that holds as long as
nothing pulls faster than `max_speed_mm_s`. Only `zero` ends the assumption.

While the controller measures its own pins it counts nothing, and its edges say so (`ODOMETER_FROZEN`). Their frames
have no place; the first edge without the flag ends a gap, as the first one of another boot does.

Who reads a recording may lack some of what the head heard (`cut`). Then the counts of a boot go on, but from which zero
nobody knows: places are assumed, with no bound but ANYWHERE_MM, until a `zero`, or until one who counted through says
where an edge was (`counted_on`).
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from annulus_pipe.controller import TICK_NS
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.vocabulary import EdgeFlag, Flash

SPEED_SPAN_NS = 200_000_000  # over which the head's speed is taken; two edges at least
EXPECT_NS = 5_000_000_000  # for so long at most a head nobody heard of is taken to have moved on
SAMPLE_NS = 200_000_000  # between two samples
SEGMENTS_KEPT = 16
MAX_SPEED_MM_S = 500.0  # of the winch, where nobody says
REST_COUNTS = 1.5  # in SPEED_SPAN_NS: a head at rest trembles between two counts
BOOT_SLACK_NS = 20_000_000  # clock maps differ: by so much a boot may seem to be before the last edge of the one before
ANYWHERE_MM = 1e8  # a bound that says nothing: no pipe is longer, and what is written for readers stays a number
CUT_SEGMENT = 1 << 30  # numbers of segments behind the first cut begin here: the head's own never get so far
CUT_SEGMENTS, CUTS_MAX = 1 << 10, 1 << 20  # numbers behind one cut: restarts and zeros until it is mended; cuts
RESTARTED, MEASURED = "the controller restarted", "the controller measured its own pins"  # why nobody counted
LOST_EDGES = 16  # a loss of counts is told 0.1 s late at most: so many edges may have been before


@dataclass(frozen=True, slots=True)
class FlashPosition:
    """Where a flash was."""

    z_mm: float
    segment: int  # within one, differences of z are counted
    bound_mm: float  # how far z may be off; 0 where it is counted

    @property
    def assumed(self) -> bool:
        return self.bound_mm > 0.0


@dataclass(frozen=True, slots=True)
class CountingGap:
    """A stretch in which nobody counted, ended by the first edge that was counted again."""

    host_ns: int  # of that edge
    seconds: float  # without odometer
    from_mm: float
    place: FlashPosition  # assumed, at that edge
    why: str = RESTARTED

    def __str__(self) -> str:
        return (
            f"{self.why}; {self.seconds:.1f} s without odometer; z is assumed to go on at "
            f"{self.place.z_mm:.1f} mm (+- {self.place.bound_mm:.0f} mm, from {self.from_mm:.1f}); zero it or mark the "
            "place"
        )


@dataclass(frozen=True, slots=True)
class _Segment:
    """From one edge of one boot on: z = start_mm + counts * mm_per_count."""

    epoch: int
    first_edge: int
    start_mm: float
    number: int = 0
    bound_mm: float = 0.0
    nonce: int | None = None  # of the boot, where the controller told it


def _segment(data: Mapping[str, Any]) -> _Segment:
    nonce = data["nonce"]
    return _Segment(
        int(data["epoch"]),
        int(data["first_edge"]),
        float(data["start_mm"]),
        int(data["number"]),
        float(data["bound_mm"]),
        None if nonce is None else int(nonce),
    )


class Odometer:
    """Also a Sensor: counts and z_mm. `gaps` counts how often z was assumed to have gone on."""

    name = "odometer"

    def __init__(self, mm_per_count: float, max_speed_mm_s: float = MAX_SPEED_MM_S) -> None:
        self.gaps = 0
        self.zeroed_mm: float | None = None  # where the head was when the last `zero` took effect
        self.gap: CountingGap | None = None  # the last one, until somebody has told it
        self._mm_per_count = mm_per_count
        self._max_speed = max_speed_mm_s  # mm/s
        self._segments: deque[_Segment] = deque(maxlen=SEGMENTS_KEPT)
        self._recent: deque[tuple[int, float]] = deque()  # host ns, z mm: of SPEED_SPAN_NS
        self._last_edge = 0
        self._lost = 0  # counts, in this boot, as the controller says
        self._zero_next = False
        self._stood = False  # at the last edge: the controller measured its own pins
        self._cut = False  # and no edge was heard since
        self._heard_from: tuple[int, int] | None = None  # epoch and number of the first edge behind the last cut
        self._samples: list[Sample] = []
        self._next_sample_ns = 0

    @property
    def here_mm(self) -> float | None:
        """Where the head was at the last edge; None before the first."""
        return self._recent[-1][1] if self._recent else None

    @property
    def here(self) -> FlashPosition | None:
        """The same, with how well it is known."""
        if not self._recent:
            return None
        segment = self._segments[-1]
        return FlashPosition(self._recent[-1][1], segment.number, segment.bound_mm)

    def zero(self) -> None:
        """The next edge that is heard is at z = 0, and so it goes on from there. Frames lit before keep their z."""
        self._zero_next = True

    def edge(self, flash: Flash, host_ns: int, nonce: int | None = None) -> None:
        """Every edge, as it is heard. One that had to be read again, and so comes late, places its frame only."""
        if EdgeFlag.ODOMETER_FROZEN in flash.flags:
            self._stood |= not self._recent or host_ns > self._recent[-1][0]
            return
        if not self._knows(flash):
            self._another_boot(flash, host_ns, nonce)
        elif self._stood and self._recent and host_ns > self._recent[-1][0]:
            self._counts_again(flash, host_ns)
        elif self._recent and host_ns <= self._recent[-1][0]:
            return
        self._stood = False
        if self._cut:
            self._cut, self._heard_from = False, (flash.epoch, flash.edge)
        place = self._place(flash)
        if self._zero_next:
            self._zero_next, self.zeroed_mm = False, place.z_mm
            before = self._segments[-1]
            self._begin(
                replace(
                    before, first_edge=flash.edge, start_mm=-self._moved(flash), number=before.number + 1, bound_mm=0.0
                )
            )
            place = self._place(flash)
        self._last_edge = flash.edge
        self._recent.append((host_ns, place.z_mm))
        while len(self._recent) > 2 and self._recent[-1][0] - self._recent[0][0] > SPEED_SPAN_NS:
            self._recent.popleft()
        if host_ns >= self._next_sample_ns:
            self._next_sample_ns = host_ns + SAMPLE_NS
            values = {"counts": float(flash.odometer), "z_mm": place.z_mm}
            self._samples.append(Sample(self.name, host_ns, values, {"counts": "counts", "z_mm": "mm"}))
            del self._samples[:-SEGMENTS_KEPT]

    def lost(self, counts: int) -> None:
        """The controller says that so many counts of this boot are lost; the last few edges may be from after that."""
        more = (counts - self._lost) * abs(self._mm_per_count)
        self._lost = counts
        if self._segments and more > 0:
            now = self._segments[-1]
            first = max(now.first_edge, self._last_edge - LOST_EDGES)
            self._segments.append(replace(now, first_edge=first, bound_mm=min(now.bound_mm + more, ANYWHERE_MM)))

    def cut(self, which: int) -> None:
        """What comes next is missing: edges, a restart, a loss of counts, a `zero`. `which`: of cuts, from 0."""
        self._cut, self._heard_from, self._zero_next = True, None, False
        last = self._segments[-1] if self._segments else _Segment(0, 0, 0.0)
        self._segments.clear()
        number = CUT_SEGMENT + min(which, CUTS_MAX - 1) * CUT_SEGMENTS
        self._segments.append(replace(last, number=number, bound_mm=ANYWHERE_MM))

    def counted_on(self, edge: int, counts: int, place: FlashPosition) -> FlashPosition | None:
        """Behind a cut: where an edge of this boot was, by one who counted through it. Its place, where it tells ours.

        It does where that edge was heard behind the cut, and nothing but edges since: then no `zero` is between.
        """
        if len(self._segments) != 1 or self._heard_from is None or edge < self._heard_from[1]:
            return None
        here = self._segments[0]
        if here.bound_mm < ANYWHERE_MM:
            return None
        start_mm = place.z_mm - counts * self._mm_per_count
        self._recent = deque((host_ns, z_mm + start_mm - here.start_mm) for host_ns, z_mm in self._recent)
        self._segments[0] = replace(here, start_mm=start_mm, number=place.segment, bound_mm=place.bound_mm)
        return place

    def place(self, flash: Flash) -> FlashPosition | None:
        """Of a frame, from its flash; None when that boot's edges were never heard, too long ago, or before a cut."""
        before_cut = self._heard_from is not None and self._heard_from > (flash.epoch, flash.edge)
        stood = EdgeFlag.ODOMETER_FROZEN in flash.flags
        return None if stood or self._cut or before_cut or not self._knows(flash) else self._place(flash)

    def remembered(self) -> dict[str, Any]:
        """All that later places follow from, as plain types; `recalled` is the inverse."""
        return {
            "mm_per_count": self._mm_per_count,
            "max_speed_mm_s": self._max_speed,
            "segments": [asdict(segment) for segment in self._segments],
            "recent": [list(one) for one in self._recent],
            "last_edge": self._last_edge,
            "lost": self._lost,
            "zero_next": self._zero_next,
            "stood": self._stood,
        }

    @classmethod
    def recalled(cls, data: Mapping[str, Any]) -> "Odometer":
        """Raises KeyError, TypeError or ValueError on anything but what `remembered` gave."""
        odometer = cls(float(data["mm_per_count"]), float(data["max_speed_mm_s"]))
        odometer._segments.extend(_segment(segment) for segment in data["segments"])
        odometer._recent.extend((int(host_ns), float(z_mm)) for host_ns, z_mm in data["recent"])
        if bool(odometer._segments) != bool(odometer._recent):
            raise ValueError("an odometer that heard edges, and none")
        odometer._last_edge, odometer._lost = int(data["last_edge"]), int(data["lost"])
        odometer._zero_next, odometer._stood = bool(data["zero_next"]), bool(data.get("stood", False))
        return odometer

    def poll(self) -> list[Sample]:
        samples, self._samples = self._samples, []
        return samples

    def close(self) -> None:
        pass

    def _moved(self, flash: Flash) -> float:
        """Since the boot, mm."""
        return flash.odometer * self._mm_per_count

    def _begin(self, segment: _Segment) -> None:
        self._segments.append(segment)
        self._recent.clear()

    def _knows(self, flash: Flash) -> bool:
        """Whether edges of that boot were heard."""
        return any(segment.epoch == flash.epoch for segment in reversed(self._segments))

    def _place(self, flash: Flash) -> FlashPosition:
        segment = self._segments[-1]
        if segment.epoch != flash.epoch or segment.first_edge > flash.edge:
            of_boot = [segment for segment in self._segments if segment.epoch == flash.epoch]
            begun = [segment for segment in of_boot if segment.first_edge <= flash.edge]
            segment = begun[-1] if begun else of_boot[0]
        return FlashPosition(segment.start_mm + self._moved(flash), segment.number, segment.bound_mm)

    def _another_boot(self, flash: Flash, host_ns: int, nonce: int | None) -> None:
        """The first edge of a boot that is new to us."""
        if not self._segments:
            self._begin(_Segment(flash.epoch, flash.edge, 0.0, nonce=nonce))
            return
        before = self._segments[-1]
        if (
            nonce is not None and nonce == before.nonce and not self._stood
        ):  # it was taken for another boot, and is none
            self._begin(replace(before, epoch=flash.epoch, first_edge=flash.edge))
            return
        self._lost = 0
        last_ns = self._recent[-1][0] if self._recent else host_ns
        gap_ns, counted_mm = self._uncounted(flash, host_ns, last_ns)
        if before.bound_mm >= ANYWHERE_MM:  # what was before says nothing of this boot: it may yet be told by itself
            self._segments.clear()
            self._cut = True
        self._after_gap(before, flash, host_ns, gap_ns, counted_mm, nonce, RESTARTED)

    def _counts_again(self, flash: Flash, host_ns: int) -> None:
        """The first edge after a measurement, in which nothing was counted."""
        before = self._segments[-1]
        gap_ns = host_ns - self._recent[-1][0]
        self._after_gap(before, flash, host_ns, gap_ns, 0.0, before.nonce, MEASURED)

    def _after_gap(
        self, before: _Segment, flash: Flash, host_ns: int, gap_ns: int, counted_mm: float, nonce: int | None, why: str
    ) -> None:
        """z goes on at the speed it had. `counted_mm`: since the gap."""
        last_mm = self._recent[-1][1] if self._recent else 0.0
        travel_mm = self.speed_mm_s * min(gap_ns, EXPECT_NS) / 1e9
        bound_mm = min(before.bound_mm + abs(travel_mm) + self._max_speed * gap_ns / 1e9, ANYWHERE_MM)
        place = FlashPosition(last_mm + travel_mm + counted_mm, before.number + 1, bound_mm)
        self.gaps += 1
        self.gap = CountingGap(host_ns, gap_ns / 1e9, last_mm, place, why)
        start_mm = place.z_mm - self._moved(flash)
        self._begin(_Segment(flash.epoch, flash.edge, start_mm, place.segment, bound_mm, nonce))

    def _uncounted(self, flash: Flash, host_ns: int, last_ns: int) -> tuple[int, float]:
        """For how long nobody counted, ns, and what was counted since, mm: a boot counts from its tick 0 on.

        The tick begins again every 43 s, so that the boot may be longer ago than it says: then this is too long, and
        the bound too wide.
        """
        whole_ns = max(0, host_ns - last_ns)
        if self._stood:  # not all of this boot was counted
            return whole_ns, 0.0
        gap_ns = whole_ns - flash.tick * TICK_NS
        if not -BOOT_SLACK_NS <= gap_ns <= whole_ns:  # this boot is older than our last edge: its counts say nothing
            return whole_ns, 0.0
        return max(BOOT_SLACK_NS, gap_ns), self._moved(flash)

    @property
    def speed_mm_s(self) -> float:
        """Of late; 0 at rest, and never faster than the winch."""
        if not self._recent:
            return 0.0
        (first_ns, first), (last_ns, last) = self._recent[0], self._recent[-1]
        if last_ns <= first_ns or abs(last - first) <= REST_COUNTS * abs(self._mm_per_count):
            return 0.0
        speed = (last - first) / (last_ns - first_ns) * 1e9
        return min(max(speed, -self._max_speed), self._max_speed)
