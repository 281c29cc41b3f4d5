"""When a flash may fire: the window in which every row of a rolling shutter is open at once."""

import math
from dataclasses import dataclass

from annulus_pipe.controller import CAMERA_TRIGGER_MIN_TICKS, TICKS_PER_US
from annulus_pipe.untrusted import shown
from annulus_pipe.vocabulary import AnnulusError

TRIGGER_EXTRA_US = {  # a camera exposes so much longer than its trigger lasts
    "none": 0.0,  # the camera runs by itself
    "xtrig": 14.26,  # Raspberry Pi's Global Shutter camera: its documentation, External Trigger on the GS Camera
    "pulse": 0.0,  # an industrial camera that exposes as long as its trigger input is active
    "xtrig_on_sync": 14.26,  # the same two, each trigger begun by an edge of the sync input, an outside clock
    "pulse_on_sync": 0.0,
}
OWN_CLOCK_PERMILLE = 5  # the controller makes the edges itself; the exposure lies before them, and so do flashes
ON_SYNC_PERMILLE = 10
"""Of the period, by which an outside clock may be off `fps` and unsteady. A trigger must end that much before the next
edge is due, and its frame come later than twice that much: 0.8 ms at 25 fps, of a readout of some ms."""
ON_SYNC_SPARE_US = 10.0  # from a trigger to the earliest edge; the controller wants 1.6
TRIGGER_MIN_US = CAMERA_TRIGGER_MIN_TICKS / TICKS_PER_US


@dataclass(frozen=True, slots=True)
class FrameTiming:
    """One camera mode. Times in microseconds; the window counts from the sync signal's falling edge."""

    fps: float
    exposure_us: float
    readout_us: float  # first line to last line

    def __post_init__(self) -> None:
        for name, value, unit, low, high in (
            ("frame rate", self.fps, "fps", 1.0, 500.0),
            ("exposure", self.exposure_us, "us", 1.0, 1e6),
            ("readout", self.readout_us, "us", 0.0, 1e6),
        ):
            if not (math.isfinite(value) and low <= value <= high):
                raise AnnulusError(f"{name} {value:g} {unit}: expected {low:g}..{high:g}")
        if self.exposure_us > self.period_us:
            raise AnnulusError(
                f"exposure {self.exposure_us:g} us does not fit a frame of {self.period_us:g} us ({self.fps:g} fps)"
            )
        if self.readout_us > self.period_us:
            raise AnnulusError(
                f"readout {self.readout_us:g} us does not fit a frame of {self.period_us:g} us ({self.fps:g} fps)"
            )

    @property
    def period_us(self) -> float:
        return 1e6 / self.fps

    @property
    def opens_us(self) -> float:
        """The last row opens: T = 1/fps - T_ex (Alzuhiri 2022, Eq. 4.1)."""
        return self.period_us - self.exposure_us

    @property
    def closes_us(self) -> float:
        """The first row closes: 1/fps - T_ro."""
        return self.period_us - self.readout_us

    def triggered(self, kind: str) -> "Triggers":
        """Of a global shutter that the controller opens for as long as its trigger lasts. kind : of TRIGGER_EXTRA_US.

        Raises AnnulusError when the trigger would have no length, or sensor and period no time to read the frame out.
        """
        extra_us, on_sync = TRIGGER_EXTRA_US[kind], is_on_sync(kind)
        width_us = self.exposure_us - extra_us
        if width_us < TRIGGER_MIN_US:
            raise AnnulusError(
                f"exposure {self.exposure_us:g} us: the camera adds {extra_us:g} us to its trigger, and that lasts"
                f" {TRIGGER_MIN_US:g} us or more"
            )
        shortest_us = self.period_us * (1 - ON_SYNC_PERMILLE / 1000 if on_sync else 1)
        if self.exposure_us + self.readout_us > shortest_us - (ON_SYNC_SPARE_US if on_sync else 0.0):
            clock = f", and an outside clock that may be {ON_SYNC_PERMILLE / 10:g} % early," if on_sync else ""
            raise AnnulusError(
                f"exposure {self.exposure_us:g} us and readout {self.readout_us:g} us one after the other{clock} do not"
                f" fit {self.period_us:g} us ({self.fps:g} fps), as a camera that is triggered needs them to"
            )
        if not on_sync:
            return Triggers(width_us, 0.0, FrameTiming(self.fps, width_us, 0.0), OWN_CLOCK_PERMILLE)
        delay_us = shortest_us - ON_SYNC_SPARE_US - width_us
        after_us = self.period_us - delay_us
        flashes_in = FrameTiming(self.fps, after_us, after_us - width_us)
        return Triggers(width_us, delay_us, flashes_in, ON_SYNC_PERMILLE)

    def __str__(self) -> str:
        return f"{self.fps:g} fps, exposure {self.exposure_us / 1e3:g} ms, readout {self.readout_us / 1e3:g} ms"

    def check_window(self) -> None:
        """Raises AnnulusError when no instant exists at which every row exposes."""
        if self.exposure_us <= self.readout_us:
            raise AnnulusError(
                f"no moment at which all rows expose ({self}): the exposure must be longer than the readout"
            )

    def check_flash(self, delay_us: float, width_us: float, lamp: str = "flash") -> None:
        """Raises AnnulusError when a flash leaves the window; part of the rows would see less of it."""
        self.check_window()
        if not (math.isfinite(delay_us) and math.isfinite(width_us)) or delay_us < 0 or width_us <= 0:
            raise AnnulusError(
                f"{lamp}: delay {delay_us:g} us, width {width_us:g} us: expected 0 or more, and more than 0"
            )
        slack = 0.005  # half a tick: ticks are what the controller fires
        if delay_us < self.opens_us - slack or delay_us + width_us > self.closes_us + slack:
            raise AnnulusError(
                f"{lamp} {delay_us:g}..{delay_us + width_us:g} us leaves the window "
                f"{self.opens_us:g}..{self.closes_us:g} us in which all rows expose ({self})"
            )

    def drawing(self, delay_us: float | None = None, width_us: float | None = None, columns: int = 72) -> str:
        """The frame between two falling edges as text: first and last row, the window, the flash."""
        span = self.period_us

        def bar(start: float, stop: float, mark: str) -> str:
            a, b = round(columns * start / span), round(columns * stop / span)
            return "".join(mark if a <= i < max(b, a + 1) else "·" for i in range(columns))

        rows = [
            ("first row", bar(max(self.closes_us - self.exposure_us, 0.0), self.closes_us, "█")),
            ("last row", bar(self.opens_us, span, "█")),
        ]
        if self.exposure_us > self.readout_us:
            rows.append(("all rows", bar(self.opens_us, self.closes_us, "▒")))
        if delay_us is not None and width_us is not None:
            rows.append(("flash", bar(delay_us, delay_us + width_us, "▲")))
        ruler = "0" + f"{span / 1e3:g} ms".rjust(columns - 1)
        return "\n".join(f"{name:>9} {line}" for name, line in rows) + f"\n{'':>9} {ruler}"


@dataclass(frozen=True, slots=True)
class Triggers:
    """What the controller gives cameras. `flashes_in`: the camera's mode as flashes must fit it. The end of a trigger
    is the edge, or lies as close before it as it safely can; what the shutter stays open afterwards nothing counts on.
    """

    width_us: float
    delay_us: float  # from an edge of the sync input to the trigger that it begins; 0: the controller is the clock
    flashes_in: FrameTiming
    tolerance_permille: int  # of the period, in which an edge is taken for one


def trigger_named(kind: object) -> str:
    """One of TRIGGER_EXTRA_US. Raises AnnulusError."""
    if not isinstance(kind, str) or kind not in TRIGGER_EXTRA_US:
        raise AnnulusError(f"trigger is {shown(kind)}, expected one of {', '.join(TRIGGER_EXTRA_US)}")
    return kind


def is_on_sync(kind: str) -> bool:
    """Whether a trigger of this kind is begun by the sync input."""
    return kind.endswith("_on_sync")
