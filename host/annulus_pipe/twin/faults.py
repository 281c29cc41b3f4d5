"""What goes wrong between the head and the host, all from one seed. `profiles` has them by name, `driver` and the line
here do what is said.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from annulus_pipe.vocabulary import AnnulusError

_DRAWN_AT_ONCE = 4096

Placed = tuple[tuple[int, float], ...]
"""(frame, how much): from that frame on, or for so long."""

_SHARES = (
    "frames_dropped",
    "frames_repeated",
    "frames_torn",
    "frames_late",
    "stamps_late",
    "stamps_odd",
    "events_lost",
    "bytes_flipped",
    "sync_missing",
    "sync_glitches",
    "flashes_failed",
)
_WHETHER = ("uncounted", "stamped_when_handed_over")
_AMOUNTS = {
    "timestamp_jitter_us": (0.0, 1e6),
    "stamp_offset_frames": (-100.0, 100.0),
    "stamp_drift_ppm": (-1e4, 1e4),
    "stamp_drift_turn_s": (0.0, 1e6),
    "delivery_frames": (0.0, 100.0),
    "sync_late_us": (0.0, 1e4),
}
_FRAMES = ("resets", "power_losses", "count_resets")
_PLACED = {  # what the second number may be
    "stamp_steps": (-1000.0, 1000.0),
    "queue_steps": (-100.0, 100.0),
    "pictures_behind": (-16.0, 16.0),
    "hiccups": (1.0, 16.0),
    "count_jumps": (-1e6, 1e6),
    "frozen": (1.0, 1e6),
    "unplugged": (1.0, 1e6),
    "disconnects": (1.0, 1e6),
    "stalls": (0.0, 1000.0),
}
_WHOLE = ("count_jumps", "frozen", "unplugged", "pictures_behind", "hiccups")


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong: shares of all frames, events or bytes; amounts; and what happens in the middle of a frame that
    is named. A key of a fault file is a field's name.
    """

    frames_dropped: float = 0.0  # by the camera's driver: a hole in its sequence
    events_lost: float = 0.0  # whole events lost between controller and host
    bytes_flipped: float = 0.0  # of all bytes from the controller
    timestamp_jitter_us: float = 0.0  # standard deviation, normal
    sync_missing: float = 0.0  # edges that never come
    sync_late_us: float = (
        0.0  # the mean, exponential: never early; edges that a receiver's driver sets in its interrupt
    )
    sync_glitches: float = 0.0  # edges doubled by a 20 us spike in the middle of a frame
    resets: tuple[int, ...] = ()  # the controller restarts in the middle of these frames
    sensors_silent: tuple[tuple[str, float, float], ...] = ()  # name, seconds from the start, for how many
    frames_repeated: float = 0.0  # the picture before once more, under the new frame's stamp and count
    frames_torn: float = 0.0  # the lower 5 to 95 % of the rows are still the picture before
    frames_late: float = 0.0  # handed over up to half a second late; those behind wait, the order is kept
    stamps_late: float = 0.0  # single stamps, by one to three frames or by parts of one
    stamp_offset_frames: float = 0.0  # all stamps, later by so many frames
    stamp_steps: Placed = ()  # frame, by how many frames stamps are later from there on
    stamp_drift_ppm: float = 0.0  # above 0: the stamps' clock runs fast
    stamp_drift_turn_s: float = 0.0  # the drift changes sign as often as this; 0: never
    delivery_frames: float = 0.0  # every frame is handed over so many frames after its readout
    frozen: Placed = ()  # frame, for how many frames the picture stays what it was
    unplugged: Placed = ()  # frame, for how many frames there is no camera; its driver then counts from 0
    count_jumps: Placed = ()  # frame, by how much the driver's count is higher from there on
    count_resets: tuple[int, ...] = ()  # the driver counts from 0 at these frames
    power_losses: tuple[int, ...] = ()  # the controller starts anew, and draws the very boot byte it had
    disconnects: Placed = ()  # frame, ms without a line to the controller
    stalls: Placed = ()  # frame, seconds in which the host does nothing; the driver keeps its oldest frames
    flashes_failed: float = 0.0  # the gate opens, and the lamp stays dark: a loose contact
    uncounted: bool = False  # the driver does not number its frames
    stamped_when_handed_over: bool = False  # a frame that is late has a late stamp, too
    stamps_odd: float = 0.0  # single stamps, by exactly one frame, earlier or later; nothing else is off
    pictures_behind: Placed = ()  # frame, by how many more its pictures are older from there on, and nothing else is
    hiccups: Placed = ()  # .. and those before show the last again, nothing, or are lost uncounted, by chance
    queue_steps: Placed = ()  # frame, by how many more its driver keeps frames back from there on; stamps with them

    def __post_init__(self) -> None:
        for name in _SHARES:
            if not _within(getattr(self, name), 0.0, 1.0):
                raise AnnulusError(f"faults: {name} is {getattr(self, name)!r}, expected a share from 0 to 1")
        for name, (low, high) in _AMOUNTS.items():
            if not _within(getattr(self, name), low, high):
                raise AnnulusError(f"faults: {name} is {getattr(self, name)!r}, expected {low:.0f} to {high:.0f}")
        for name in _FRAMES:
            frames = getattr(self, name)
            if not (isinstance(frames, tuple) and all(map(_is_frame, frames))):
                raise AnnulusError(f"faults: {name} is {frames!r}, expected frame numbers")
        for name, (low, high) in _PLACED.items():
            pairs = getattr(self, name)
            if not (isinstance(pairs, tuple) and all(_is_placed(pair, low, high, name in _WHOLE) for pair in pairs)):
                raise AnnulusError(f"faults: {name} is {pairs!r}, expected (frame, {low:.0f} to {high:.0f}) each")
        for name in _WHETHER:
            if not isinstance(getattr(self, name), bool):
                raise AnnulusError(f"faults: {name} is {getattr(self, name)!r}, expected true or false")
        if not all(_is_silence(silence) for silence in self.sensors_silent):
            raise AnnulusError(f"faults: sensors_silent is {self.sensors_silent!r}, expected (name, after_s, for_s)")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Faults":
        """Of plain data, lists for tuples. AnnulusError for what no fault is called or is no fault."""
        if unknown := set(data) - {f.name for f in fields(cls)}:
            raise AnnulusError(f"faults: does not know {sorted(unknown)}, expected {[f.name for f in fields(cls)]}")
        lists = {name: value for name, value in data.items() if isinstance(value, list)}
        tuples = {name: tuple(tuple(v) if isinstance(v, list) else v for v in value) for name, value in lists.items()}
        try:
            return cls(**{**data, **tuples})
        except TypeError as error:
            raise AnnulusError(f"faults: {error}") from None


def _within(value: object, low: float, high: float) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) and low <= value <= high


def _is_frame(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_placed(pair: object, low: float, high: float, whole: bool) -> bool:
    if not (isinstance(pair, tuple) and len(pair) == 2 and _is_frame(pair[0]) and _within(pair[1], low, high)):
        return False
    return not whole or pair[1] == int(pair[1])


def _is_silence(value: object) -> bool:
    if not (isinstance(value, tuple) and len(value) == 3 and isinstance(value[0], str)):
        return False
    return all(_within(v, 0.0, 1e6) for v in value[1:])


NO_FAULTS = Faults()


class LossyLine:
    """The serial line from controller to host: loses whole events, flips bytes. Bytes may come in any pieces."""

    def __init__(self, faults: Faults, seed: int = 0) -> None:
        self._faults = faults
        self._draws = _Uniform(seed)
        self._frame = bytearray()
        self.events_lost = 0
        self.bytes_flipped = 0

    def carry(self, data: bytes) -> bytes:
        """What arrives of `data`. With event loss an unfinished frame waits here for its delimiter."""
        if not data:
            return data
        if self._faults.events_lost > 0:
            data = self._lose_events(data)
        if self._faults.bytes_flipped > 0 and data:
            draws = self._draws.take(len(data))
            if min(draws) < self._faults.bytes_flipped:
                hit = [i for i, draw in enumerate(draws) if draw < self._faults.bytes_flipped]
                flipped = bytearray(data)
                rng = self._draws.generator()
                for i in hit:
                    flipped[i] ^= 1 << int(rng.integers(8))
                self.bytes_flipped += len(hit)
                data = bytes(flipped)
        return data

    def unplug(self) -> None:
        """What was under way is gone."""
        self._frame.clear()

    def _lose_events(self, data: bytes) -> bytes:
        """Byte by byte in effect, delimiter by delimiter in haste."""
        *whole, rest = data.split(b"\0")
        out = bytearray()
        for part in whole:
            self._frame += part
            self._frame.append(0)
            # an event's id is 0x80 or above, never zero, so it stands behind the first COBS code byte
            is_event = len(self._frame) > 2 and 0x80 <= self._frame[1] < 0xF0
            if is_event and self._draws.take(1)[0] < self._faults.events_lost:
                self.events_lost += 1
            else:
                out += self._frame
            self._frame.clear()
        self._frame += rest
        return bytes(out)


class _Uniform:
    """Numbers of one generator, drawn many at once and handed out a few at a time."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 3])
        self._drawn: list[float] = []
        self._at = 0  # so many of these were handed out
        self._before: Any = None  # state of the generator before it drew them

    def take(self, count: int) -> list[float]:
        """The next ones, from 0 to 1."""
        if self._at + count > len(self._drawn):
            rng = self.generator()
            self._before = rng.bit_generator.state
            self._drawn = rng.random(max(count, _DRAWN_AT_ONCE)).tolist()
        taken = self._drawn[self._at : self._at + count]
        self._at += count
        return taken

    def generator(self) -> np.random.Generator:
        """For draws of another kind: as if nothing had been drawn but what was handed out."""
        if self._drawn:
            self._rng.bit_generator.state = self._before
            self._rng.random(self._at)
            self._drawn, self._at = [], 0
        return self._rng
