"""What really lit each frame and where, against what its header says.

A label is wrong when any row of the picture was lit by anything but that lamp, or not by all of its flash. A slot is
wrong when another slide lit the picture than the one that it names, or more than one. A place is
wrong when the edge that was given is not the one whose flash lit the picture, or when z is off by more than PLACE_MM
and a count: where the header says that z is assumed, by more than the bound it tells besides.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.twin.cable import Cable
from annulus_pipe.twin.driver import Delivered, PicturePart
from annulus_pipe.vocabulary import Flash, Label, Lamp

EVEN = 0.97  # a row with less light than this share of the brightest: the flash was not all rows'
PLACE_MM = 0.1
NEAR = 0.25  # of a period: between an edge as the camera made it, and as the controller stamped it
EDGES_KEPT = 4096
WRAP = 1 << 32  # of the controller's ticks: 43 s

LAMPS = {Label.PROJECTOR: Lamp.PROJECTOR, Label.LED: Lamp.LED}


class LabelVerdict(StrEnum):
    UNKNOWN = "unknown"
    RIGHT = "right"
    WRONG_LAMP = "wrong lamp"
    WRONG_SLOT = "wrong slot"
    WRONG_PLACE = "wrong place"


@dataclass(frozen=True, slots=True)
class _Life:
    """Of the controller, between two restarts."""

    began: int  # world tick
    boot: int


class Truth:
    """Fed by the world: restarts as they happen, edges as the host hears of them. Asked for each header's verdict."""

    def __init__(
        self, period: float, mm_per_count: float, cable: Cable, place_mm: float = PLACE_MM, slides: int = 1
    ) -> None:
        """place_mm: by how much z may be off: it is counted at the edge, and the head goes on until the flash.
        slides: that are lit in turn.
        """
        self.assumed = 0  # labelled frames whose z was said to be assumed ..
        self.assumed_error_mm = 0.0  # .. by how much it was off, at most ..
        self.beyond_bound = 0  # .. and how many were further off than the bound that was told
        self.error_mm = 0.0  # the same of those whose z was said to be known
        self._period, self._cable, self._slides = period, cable, slides
        self._z_error_max_mm = place_mm + mm_per_count
        self._lives: list[_Life] = []
        self._edges: dict[tuple[int, int], int] = {}  # life, index -> world tick
        self._zeros: list[tuple[float, float]] = [(-1.0, 0.0)]  # from this tick on z counts from that place

    def life(self, began: int, boot: int) -> None:
        """The controller's present life, as often as one likes."""
        if not self._lives or self._lives[-1].began != began:
            self._lives.append(_Life(began, boot))

    def heard(self, flash: Flash, now: int) -> int | None:
        """World tick of an edge that the host was told of: in the life in which it falls on an edge of the camera."""
        for i in range(len(self._lives) - 1, -1, -1):
            life = self._lives[i]
            tick = life.began + flash.tick
            ends = self._lives[i + 1].began if i + 1 < len(self._lives) else now
            tick += max(0, ends - tick) // WRAP * WRAP  # the host counts wraps from when it first heard of that boot
            if life.boot == flash.boot and tick <= ends:
                self._edges[(i, flash.edge)] = tick
                while len(self._edges) > EDGES_KEPT:
                    del self._edges[next(iter(self._edges))]
                return tick
        return None

    def zeroed(self, tick: int) -> None:
        """From this edge on z is counted from where the head was."""
        self._zeros.append((tick, self._cable.z_mm(tick)))

    def verdict(self, header: FrameHeader, frame: Delivered) -> LabelVerdict:
        if header.label is Label.UNKNOWN:
            return LabelVerdict.UNKNOWN
        parts, lamp = frame.parts, LAMPS[header.label]
        if not all([part.bottom > part.top and _lit_evenly(part, lamp) for part in parts]):
            return LabelVerdict.WRONG_LAMP
        if lamp is Lamp.PROJECTOR and header.slot is not None:
            named = (int(header.slot) % self._slides,)
            if any([part.exposure.slides != named for part in parts]):
                return LabelVerdict.WRONG_SLOT
        if not any([self._is_of(header, part) for part in parts]):
            return LabelVerdict.WRONG_PLACE
        if header.z_mm is None:
            return LabelVerdict.WRONG_PLACE
        off_mm = max([abs(header.z_mm - self.z_mm(part)) for part in parts])
        if header.z_assumed:
            self.assumed += 1
            beyond = off_mm > header.z_bound_mm + self._z_error_max_mm
            self.beyond_bound += beyond
            self.assumed_error_mm = max(self.assumed_error_mm, off_mm)
            return LabelVerdict.WRONG_PLACE if beyond else LabelVerdict.RIGHT
        self.error_mm = max(self.error_mm, off_mm)
        return LabelVerdict.RIGHT if off_mm <= self._z_error_max_mm else LabelVerdict.WRONG_PLACE

    def _is_of(self, header: FrameHeader, part: PicturePart) -> bool:
        opening = part.exposure.edge_tick - self._period
        life = bisect_right(self._lives, opening + 0.01 * self._period, key=lambda life: life.began) - 1
        fired = self._edges.get((life, -1 if header.edge is None else header.edge))
        return fired is not None and abs(fired - opening) < NEAR * self._period

    def z_mm(self, part: PicturePart) -> float:
        """Where the head was when that exposure was lit, counted from where it was last said to be at 0."""
        at = part.exposure.edge_tick - (1 - NEAR) * self._period
        zero = bisect_left(self._zeros, at, key=lambda zero: zero[0]) - 1
        return part.exposure.z_mm - self._zeros[zero][1]


def _lit_evenly(part: PicturePart, lamp: Lamp) -> bool:
    """Whether that lamp lit these rows, all of them alike, and no other did."""
    exposure = part.exposure
    if len(exposure.lamps) != 1 or lamp not in exposure.lamps:
        return False
    least, most = exposure.extremes[lamp]
    if least >= EVEN * most:
        return True
    rows = exposure.projector if lamp is Lamp.PROJECTOR else exposure.led
    seen = rows[round(part.top * len(rows)) : round(part.bottom * len(rows))]
    return not len(seen) or float(np.min(seen)) >= EVEN * most


@dataclass(frozen=True, slots=True)
class Relock:
    """What came after a disturbance."""

    kind: str
    first: int  # frame that it no longer touches
    whole: int  # frames from that one to the next right label, both included
    frames: int  # the same, from the end of the last disturbance that fell in between


def relocks(disturbed: list[tuple[str, int]], right: list[int], frames: int, unlit: Sequence[int] = ()) -> list[Relock]:
    """For each disturbance: frames from its end to the next right label, that frame included; frames that no lamp lit
    (`unlit`, rising), which have no label to be right, not.

    Where others fall in between, which of them cost what cannot be told. Then `frames` counts from the end of the last
    one, for that is when everybody could have known better; `whole` counts all. Alone, both are the same.

    right : numbers of rightly labelled frames, rising. A disturbance with no right label after it counts as all the
    frames that were left, unless fewer were left than a relock is allowed to take.
    """
    found = []
    ends = sorted(first for _, first in disturbed)
    for kind, first in disturbed:
        at = bisect_right(right, first - 1)
        back = right[at] if at < len(right) else frames - 1
        if at < len(right) or frames - first > 8:
            last = ends[bisect_right(ends, back) - 1]
            whole, alone = (
                back - start + 1 - (bisect_left(unlit, back) - bisect_left(unlit, start)) for start in (first, last)
            )
            found.append(Relock(kind, first, whole, alone))
    return found
