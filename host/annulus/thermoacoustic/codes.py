"""On/off patterns of the microwave source, chip by chip, and the train they are sent in.

    train = Train(pattern("mpsl25-stuffed"), chip_ticks=50, repeat=10, period_ticks=100_000)
    [finding.name for finding in train.findings(limits) if not finding.ok]     # why a controller would refuse it

The controller has the built-in codes compiled in (firmware/core/bursts.c); these are the same, and tests read its pins
to keep them so. Codes: coded excitation in the source's chapter 8. Its complementary pair is sent by Manchester, 0 as
01 and 1 as 10, which makes an on/off code of a bipolar one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from annulus.vocabulary import TICK_S, TICKS_PER_US, AnnulusError

Chips = NDArray[np.uint8]  # 0 or 1, chip 0 first

CHIPS_MAX = 256  # a controller holds
TRIGGER_TICKS = 100  # length of the digitizer trigger

_MPSL25 = "1001001010100000011100111"
_SC1, _SC2 = "00011000101101010110010000", "00001001101000001011100111"


def stuffed(bits: str) -> str:
    """A 0 after every chip, so that all pulses have one width."""
    return "".join(bit + "0" for bit in bits)


def manchester(bits: str) -> str:
    """0 sent as 01, 1 as 10."""
    return "".join("10" if bit == "1" else "01" for bit in bits)


CODES: Mapping[str, str] = {
    "single": "1",
    "mpsl25": _MPSL25,
    "mpsl25-stuffed": stuffed(_MPSL25),
    "barker13": "1111100110101",
    "manchester1": manchester(_SC1),
    "manchester2": manchester(_SC2),
}


def pattern(code: str) -> Chips:
    """Chips of a built-in code, or of a text of 0 and 1. AnnulusError for anything else."""
    bits = CODES.get(code, code)
    if not bits or set(bits) - {"0", "1"}:
        raise AnnulusError(f"code {code!r}: expected one of {', '.join(CODES)}, or a text of 0 and 1")
    if len(bits) > CHIPS_MAX:
        raise AnnulusError(f"code of {len(bits)} chips, expected {CHIPS_MAX} at most")
    return np.frombuffer(bits.encode(), np.uint8) - np.uint8(ord("0"))


def text(chips: Chips) -> str:
    return "".join(map(str, chips))


@dataclass(frozen=True, slots=True)
class Limits:
    """What a controller lets through, in ticks; compiled into it."""

    chip_ticks: tuple[int, int]
    pulse_ticks: tuple[int, int]
    duty_permille: int
    period_ticks_max: int


@dataclass(frozen=True, slots=True)
class Finding:
    """One limit against this train."""

    name: str
    value: float
    allowed: tuple[float, float]
    unit: str

    @property
    def ok(self) -> bool:
        return self.allowed[0] <= self.value <= self.allowed[1]


@dataclass(frozen=True, eq=False)
class Train:
    """`repeat` bursts, chip 0 to chip 0 one period apart; the trigger rises `trigger_offset_ticks` after chip 0."""

    chips: Chips
    chip_ticks: int
    repeat: int = 1
    period_ticks: int = 100_000
    trigger_offset_ticks: int = 0

    @property
    def burst_ticks(self) -> int:
        """From chip 0 to the end of the last chip."""
        return len(self.chips) * self.chip_ticks

    @property
    def train_s(self) -> float:
        """From chip 0 of the first burst to the end of the last chip of the last."""
        return ((self.repeat - 1) * self.period_ticks + self.burst_ticks) * TICK_S

    @property
    def duty(self) -> float:
        """Time on over time, of the train."""
        return int(self.chips.sum()) * self.chip_ticks / self.period_ticks

    @cached_property
    def pulses_ticks(self) -> NDArray[np.int64]:
        """(pulses, 2): when each run of on-chips begins and how long it lasts, from chip 0."""
        steps = np.diff(np.concatenate(([0], self.chips.astype(np.int8), [0])))
        rises, falls = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
        return np.stack((rises, falls - rises), axis=1) * self.chip_ticks

    def findings(self, limits: Limits) -> list[Finding]:
        """Every limit and how this train stands against it, in the order in which the controller looks."""

        def us(name: str, ticks: int, low: int, high: int) -> Finding:
            return Finding(name, ticks / TICKS_PER_US, (low / TICKS_PER_US, high / TICKS_PER_US), "us")

        lengths = self.pulses_ticks[:, 1]
        found = [
            us("chip", self.chip_ticks, *limits.chip_ticks),
            us("period", self.period_ticks, self.burst_ticks + self.chip_ticks, limits.period_ticks_max),
            us(
                "trigger offset",
                self.trigger_offset_ticks,
                self.burst_ticks - self.period_ticks,
                self.period_ticks - TRIGGER_TICKS,
            ),
        ]
        if len(lengths):
            found.append(us("shortest pulse", int(lengths.min()), *limits.pulse_ticks))
            found.append(us("longest pulse", int(lengths.max()), *limits.pulse_ticks))
        return [*found, Finding("duty", 1000 * self.duty, (0, limits.duty_permille), "permille")]

    def edges_ticks(self) -> list[tuple[int, int]]:
        """(tick from chip 0, level) of one burst on the microwave gate."""
        return [(int(at), level) for start, size in self.pulses_ticks for at, level in ((start, 1), (start + size, 0))]
