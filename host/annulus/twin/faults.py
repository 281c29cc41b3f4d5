"""What goes wrong between the head and the host, all from one seed."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from annulus.vocabulary import AnnulusError


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong, as rates a frame or an event, all from one seed."""

    frames_dropped: float = 0.0  # by the camera's driver: a hole in its sequence
    events_lost: float = 0.0  # whole events lost between controller and host
    bytes_flipped: float = 0.0  # of all bytes from the controller
    timestamp_jitter_us: float = 0.0  # standard deviation, normal
    sync_missing: float = 0.0  # edges that never come
    sync_glitches: float = 0.0  # edges doubled by a 20 us spike in the middle of a frame
    resets: tuple[int, ...] = ()  # the controller restarts in the middle of these frames
    sensors_silent: tuple[tuple[str, float, float], ...] = ()  # name, seconds from the start, for how many

    def __post_init__(self) -> None:
        for name in ("frames_dropped", "events_lost", "bytes_flipped", "sync_missing", "sync_glitches"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
                raise AnnulusError(f"faults: {name} is {value!r}, expected a share from 0 to 1")
        jitter = self.timestamp_jitter_us
        if isinstance(jitter, bool) or not isinstance(jitter, int | float) or not 0.0 <= jitter <= 1e6:
            raise AnnulusError(f"faults: timestamp_jitter_us is {jitter!r}, expected 0 to 1000000")
        if not all(isinstance(frame, int) and not isinstance(frame, bool) and frame >= 0 for frame in self.resets):
            raise AnnulusError(f"faults: resets is {self.resets!r}, expected frame numbers")
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


def _is_silence(value: object) -> bool:
    if not (isinstance(value, tuple) and len(value) == 3 and isinstance(value[0], str)):
        return False
    return all(isinstance(v, int | float) and not isinstance(v, bool) and 0.0 <= v <= 1e6 for v in value[1:])


NO_FAULTS = Faults()
NAMED_FAULTS = {
    "none": NO_FAULTS,
    # the acceptance soak; its two resets are placed by whoever knows the length of the run
    "standard": Faults(frames_dropped=0.01, events_lost=0.01, timestamp_jitter_us=2000.0),
    "rough": Faults(
        frames_dropped=0.03, events_lost=0.02, bytes_flipped=1e-4, timestamp_jitter_us=3000.0, sync_missing=0.003,
        sync_glitches=0.003,
    ),
}  # fmt: skip


def load_faults(source: str | Path | None) -> Faults:
    """Faults by name (`none`, `standard`, `rough`) or from a TOML file whose keys are the fields of `Faults`."""
    if source is None:
        return NO_FAULTS
    if str(source) in NAMED_FAULTS:
        return NAMED_FAULTS[str(source)]
    path = Path(source)
    try:
        data: dict[str, Any] = tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise AnnulusError(f"{source}: no such fault file, and not one of {', '.join(NAMED_FAULTS)}") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise AnnulusError(f"{path}: cannot be read as TOML: {error}") from None
    try:
        return Faults.from_dict(data)
    except AnnulusError as error:
        raise AnnulusError(f"{path}: {error}") from None


class LossyLine:
    """The serial line from controller to host: loses whole events, flips bytes. Bytes may come in any pieces."""

    def __init__(self, faults: Faults, seed: int = 0) -> None:
        self._faults = faults
        self._rng = np.random.default_rng([seed, 3])
        self._frame = bytearray()
        self.events_lost = 0
        self.bytes_flipped = 0

    def carry(self, data: bytes) -> bytes:
        """What arrives of `data`. With event loss an unfinished frame waits here for its delimiter."""
        if self._faults.events_lost > 0:
            data = self._lose_events(data)
        if self._faults.bytes_flipped > 0 and data:
            hit = np.flatnonzero(self._rng.random(len(data)) < self._faults.bytes_flipped)
            flipped = bytearray(data)
            for i in hit:
                flipped[i] ^= 1 << int(self._rng.integers(8))
            self.bytes_flipped += len(hit)
            data = bytes(flipped)
        return data

    def _lose_events(self, data: bytes) -> bytes:
        out = bytearray()
        for byte in data:
            self._frame.append(byte)
            if byte == 0:
                # an event's id is 0x80 or above, never zero, so it stands behind the first COBS code byte
                is_event = len(self._frame) > 2 and 0x80 <= self._frame[1] < 0xF0
                if is_event and self._rng.random() < self._faults.events_lost:
                    self.events_lost += 1
                else:
                    out += self._frame
                self._frame.clear()
        return bytes(out)
