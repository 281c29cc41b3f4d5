"""On/off patterns of the microwave source, chip by chip, and the train they are sent in.

    train = train_from_us("mpsl25-stuffed", chip_us=0.5, repeat=10, period_us=1000.0, trigger_offset_us=0.0)
    [finding.name for finding in train.findings() if not finding.ok]     # why a controller would refuse it

The built-in codes and the limits are the controller's own (protocol/messages.toml). Codes: coded excitation in the
source's chapter 8. Its complementary pair is sent by Manchester, 0 as 01 and 1 as 10, which makes an on/off code of a
bipolar one.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from annulus_pipe.controller import (
    BURST_PERIOD_MAX_TICKS,
    BURST_PERIOD_MIN_TICKS,
    BURST_REPEAT_MAX,
    CHIP_MAX_TICKS,
    CHIP_MIN_TICKS,
    CHIPS_MAX,
    CODES,
    MICROWAVE_DUTY_MAX_PERMILLE,
    MICROWAVE_PULSE_MAX_TICKS,
    MICROWAVE_PULSE_MIN_TICKS,
    TICK_S,
    TICKS_PER_US,
    TRIGGER_TICKS,
)
from annulus_pipe.numeric.arrays import Chips, IntArray
from annulus_pipe.vocabulary import AnnulusError


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
class LimitCheck:
    """One limit against this train."""

    name: str
    value: float
    allowed: tuple[float, float]
    unit: str

    @property
    def ok(self) -> bool:
        return self.allowed[0] <= self.value <= self.allowed[1]

    @property
    def expected(self) -> str:
        low, high = self.allowed
        return f"{high:.10g} {self.unit} at most" if low == 0 else f"{low:.10g}..{high:.10g} {self.unit}"


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
    def pulses_ticks(self) -> IntArray:
        """(pulses, 2): when each run of on-chips begins and how long it lasts, from chip 0."""
        steps = np.diff(np.concatenate(([0], self.chips.astype(np.int8), [0])))
        rises, falls = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
        return np.stack((rises, falls - rises), axis=1) * self.chip_ticks

    def findings(self) -> list[LimitCheck]:
        """Every limit and how this train stands against it, in the order in which the controller looks."""

        def us(name: str, ticks: int, low: int, high: int) -> LimitCheck:
            return LimitCheck(name, ticks / TICKS_PER_US, (low / TICKS_PER_US, high / TICKS_PER_US), "us")

        lengths = self.pulses_ticks[:, 1]
        found = [
            LimitCheck("repeat", self.repeat, (1, BURST_REPEAT_MAX), "bursts"),
            us("chip", self.chip_ticks, CHIP_MIN_TICKS, CHIP_MAX_TICKS),
            us(
                "period",
                self.period_ticks,
                max(self.burst_ticks + self.chip_ticks, BURST_PERIOD_MIN_TICKS),
                BURST_PERIOD_MAX_TICKS,
            ),
            us(
                "trigger offset",
                self.trigger_offset_ticks,
                self.burst_ticks - self.period_ticks,
                self.period_ticks - TRIGGER_TICKS,
            ),
        ]
        if len(lengths):
            for name, ticks in (("shortest pulse", lengths.min()), ("longest pulse", lengths.max())):
                found.append(us(name, int(ticks), MICROWAVE_PULSE_MIN_TICKS, MICROWAVE_PULSE_MAX_TICKS))
        return [*found, LimitCheck("duty", 1000 * self.duty, (0, MICROWAVE_DUTY_MAX_PERMILLE), "permille")]

    def check(self) -> None:
        """AnnulusError with every limit a controller would refuse this train for."""
        refused = [finding for finding in self.findings() if not finding.ok]
        refused = [f for f in refused if f.allowed[0] <= f.allowed[1]] or refused  # no range is another limit's doing
        if refused:
            raise AnnulusError(
                "the controller would refuse this: "
                + "; ".join(f"{f.name} {f.value:.10g} {f.unit}, expected {f.expected}" for f in refused)
            )

    def edges_ticks(self) -> list[tuple[int, int]]:
        """(tick from chip 0, level) of one burst on the microwave gate."""
        return [(int(at), level) for start, size in self.pulses_ticks for at, level in ((start, 1), (start + size, 0))]


def train_from_us(code: str, *, chip_us: float, repeat: int, period_us: float, trigger_offset_us: float) -> Train:
    """A train from microseconds, not yet checked against the limits. AnnulusError for no code, or no number."""
    for name, us in (("chip", chip_us), ("period", period_us), ("trigger offset", trigger_offset_us)):
        if not math.isfinite(us):
            raise AnnulusError(f"{name} {us:g} us: expected a number")
    chip, period, offset = (round(us * TICKS_PER_US) for us in (chip_us, period_us, trigger_offset_us))
    if chip <= 0 or period <= 0:
        raise AnnulusError(f"chip {chip_us:g} us, period {period_us:g} us: expected both to last")
    return Train(pattern(code), chip, repeat, period, offset)
