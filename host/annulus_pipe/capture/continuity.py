"""Whether a camera's frames may have been kept, lost or shown anew by a whole lamp cycle.

Then stamp, arrival, count and picture may have moved together, and only a preamble tells which frame is which.

What is looked for, each by half a cycle: a silence that no count spans; frames that come sooner one after the other;
and signs that pictures have moved, all counted together, for one hiccup of a driver shows several of them: holes
without a count, pictures that were shown before, blank ones, from buffers that nothing was written into, and two frames
of one edge.
What they may have moved by less than a cycle, the next whole cycle of agreeing pictures disproves.
"""

from annulus_pipe.capture.history import EdgeHistory
from annulus_pipe.capture.witnesses import Delivery
from annulus_pipe.vocabulary import Lamp

SILENCE = 0.75  # of a period, more than half a lamp cycle: frames that came so long after the last may be of another
SOON = 0.1  # of a period: what comes sooner by more is no jitter
SPANNED_WITHIN = 3  # frames after a silence, in which one stamp may be off by itself, or its edge be lost
VOUCHED_MIN = 10  # frames of a preamble: whatever was missing before, they are what they seem


class Continuity:
    """From one proof to the next."""

    def __init__(self, history: EdgeHistory, delivery: Delivery) -> None:
        self._history, self._delivery = history, delivery
        self.unspanned = 0  # frames within which a count has to agree, after a silence
        self._sooner = 0.0  # periods by which frames came sooner, one after the other
        self._moved = self._vouched = 0  # frames by which pictures may have moved; of a preamble that agreed since
        self._run, self._other = 0, False  # frames that agreed one after the other; the LED among them

    @property
    def _half(self) -> float:
        return self._history.cycle / 2

    @property
    def _is_asked(self) -> bool:
        """Without a preamble to tell, two witnesses that are not one have to do."""
        return self._history.preambled or self._delivery.one_witness

    @property
    def lost(self) -> bool:
        """Whether pictures may have moved by half a cycle."""
        return self._moved >= self._half and self._is_asked

    def missed(self, frames: int) -> None:
        """So many are missing before this one, and the driver does not count."""
        self._moved += max(0, frames)

    def vouched(self) -> None:
        """A frame of a preamble that nobody contradicts."""
        self._vouched += 1
        if self._vouched >= VOUCHED_MIN:
            self._moved = self._vouched = 0

    def agreed(self, lamp: Lamp | None) -> None:
        """A frame was labelled, and its picture shows that lamp; None: it was not, or does not. Pictures that moved
        by a part of a cycle show another lamp somewhere in it.
        """
        self._run, self._other = (0, False) if lamp is None else (self._run + 1, self._other or lamp is Lamp.LED)
        if self._other and self._run >= self._history.cycle:
            self._moved = 0

    def broken(self, periods: float | None, counted: bool | None, moved: int, edgeless: bool = False) -> str:
        """Why nothing but a preamble tells now which frame this is; empty where something else does.

        periods : since the last frame came; None, it is the first. counted : whether the driver's count names the edge
        that the stamp does; None, there is no count. moved : frames by which this one says that pictures may have
        moved. edgeless : whether neither stamp nor count names an edge that is known: the board kept fewer than came
        while nobody listened. Such a frame has no label, and says nothing for or against.
        """
        after = 1.0 if periods is None else periods
        silence = f"no frame came for {after - 1:.0f} periods" if after >= self._half + SILENCE else ""
        if silence and (self._delivery.one_witness or (counted is None and self._history.preambled)):
            return silence
        if silence and counted is not None:
            self.unspanned = SPANNED_WITHIN
        if self.unspanned and not counted and not edgeless:
            self.unspanned -= 1
            return "" if self.unspanned else "no count spans a silence"
        if counted:  # whoever came late and then sooner, none is missing
            self.unspanned, self._sooner = 0, 0.0
        sooner = 1.0 - after
        self._sooner = self._sooner + sooner if sooner > SOON else max(0.0, self._sooner - SOON)
        if self._sooner >= self._half and not counted and not edgeless and self._is_asked:
            return f"frames came sooner by {self._sooner:.0f} periods"
        self._moved += moved
        return f"pictures may have moved by {self._moved} frames: a cycle of lamps does not tell" if self.lost else ""
