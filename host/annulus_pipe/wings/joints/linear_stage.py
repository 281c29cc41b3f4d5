"""A linear stage behind a GRBL controller (1.1): the serial line of most bench stages one can buy.

    with LinearStage("/dev/ttyUSB0", axis="Z") as stage:
        stage.move(12.5)                     # mm, machine coordinates; returns when it stands there

Nothing it says is believed: lines are bounded, a place that it does not reach, an alarm and silence are AnnulusErrors.
After a reset it counts from where it stands; `home` drives it to its switch.
"""

import contextlib
import math
import re
import time
from types import TracebackType
from typing import Any, Self

import serial

from annulus_pipe.vocabulary import AnnulusError

BAUD = 115_200
ANSWER_S, GREETING_S, HOMING_S = 2.0, 2.5, 120.0
SLACK_S = 5.0  # beyond what a move should take
AT_MM = 0.02  # so near to what was asked for it has arrived
LINE_MAX = 256
REPORT = re.compile(r"<([A-Za-z]+)(?::\d+)?\|MPos:([-+\d.,]+)")


class LinearStage:
    """One axis of a GRBL controller. AnnulusError when there is none on the port."""

    def __init__(self, port: str, *, axis: str = "X", feed_mm_min: float = 600.0) -> None:
        if axis not in ("X", "Y", "Z"):
            raise AnnulusError(f"axis {axis!r} of the stage: expected X, Y or Z")
        if not (math.isfinite(feed_mm_min) and 1.0 <= feed_mm_min <= 1e5):
            raise AnnulusError(f"feed of the stage {feed_mm_min:g} mm/min: expected 1..100000")
        self.port, self.axis, self.feed_mm_min = port, axis, feed_mm_min
        try:
            self._line: Any = serial.serial_for_url(port, BAUD, timeout=0.05, write_timeout=ANSWER_S)
        except (serial.SerialException, OSError, ValueError) as error:
            raise AnnulusError(f"{port}: cannot be opened ({error}), expected the stage's serial port") from None
        self._held = bytearray()
        try:
            self._greeted()
            self._command("G21 G90")  # mm, absolute
        except BaseException:
            self.close()
            raise

    def position(self) -> float:
        """Mm, machine coordinates."""
        return self._report()[1]

    def home(self) -> None:
        """Drive to the limit switch; positions count from there."""
        self._command("$H", HOMING_S)

    def move(self, to_mm: float) -> None:
        """Drive to a position, and wait until the stage stands there."""
        state, at = self._report()
        if state.startswith("Alarm"):
            raise AnnulusError(f"{self.port}: the stage is in alarm, expected one that is homed or unlocked ($X)")
        self._command(f"G53 G1 {self.axis}{to_mm:.4f} F{self.feed_mm_min:g}")
        end = time.monotonic() + 60.0 * abs(to_mm - at) / self.feed_mm_min + SLACK_S
        while time.monotonic() < end:
            state, at = self._report()
            if state.startswith("Alarm"):
                raise AnnulusError(f"{self.port}: the stage went into alarm at {at:g} mm, on the way to {to_mm:g} mm")
            if state == "Idle" and abs(at - to_mm) <= AT_MM:
                return
            time.sleep(0.005)
        raise AnnulusError(f"{self.port}: the stage stands at {at:g} mm, expected {to_mm:g} mm by now")

    def halt(self) -> None:
        """Feed hold: it brakes where it is."""
        with contextlib.suppress(serial.SerialException, OSError):
            self._line.write(b"!")

    def close(self) -> None:
        with contextlib.suppress(serial.SerialException, OSError):
            self._line.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.halt()
        self.close()

    def _greeted(self) -> None:
        """Reads past the greeting of a board that opening the port has reset; others answer without one."""
        end, seen = time.monotonic() + GREETING_S, ""
        self._write(b"?")
        while time.monotonic() < end:
            seen = self._next(end) or seen
            if REPORT.match(seen):
                return
            if seen.startswith("Grbl"):
                self._write(b"?")
        raise AnnulusError(f"{self.port}: said {seen[:60]!r}, expected a stage with GRBL 1.1")

    def _report(self) -> tuple[str, float]:
        self._write(b"?")
        end = time.monotonic() + ANSWER_S
        while (line := self._next(end)) is not None:
            found = REPORT.match(line)
            if found:
                try:
                    places = [float(one) for one in found[2].split(",")]
                except ValueError:
                    places = []
                index = "XYZ".index(self.axis)
                if len(places) <= index or not math.isfinite(places[index]):
                    raise AnnulusError(
                        f"{self.port}: stage reports {line[:80]!r}, expected a place of axis {self.axis}"
                    )
                return found[1], places[index]
            if line.startswith("ALARM"):
                raise AnnulusError(f"{self.port}: the stage says {line[:40]}; home it ($H) once the cause is gone")
        raise AnnulusError(f"{self.port}: no report within {ANSWER_S:g} s, expected the stage's place")

    def _command(self, text: str, patience_s: float = ANSWER_S) -> None:
        self._write(text.encode("ascii") + b"\n")
        end = time.monotonic() + patience_s
        while (line := self._next(end)) is not None:
            if line == "ok":
                return
            if line.startswith(("error", "ALARM")):
                raise AnnulusError(f"{self.port}: the stage answers {line[:40]!r} to {text!r}, expected ok")
        raise AnnulusError(f"{self.port}: no answer to {text!r} within {patience_s:g} s, expected the stage's ok")

    def _write(self, data: bytes) -> None:
        try:
            self._line.write(data)
        except (serial.SerialException, OSError) as error:
            raise AnnulusError(f"{self.port}: the stage is gone ({error})") from None

    def _next(self, end: float) -> str | None:
        """The next line that is not empty; None once it is `end`."""
        while time.monotonic() < end:
            whole, found, rest = bytes(self._held).partition(b"\n")
            if found:
                self._held[:] = rest
                if text := whole.decode("ascii", "replace").strip():
                    return text
                continue
            if len(self._held) > LINE_MAX:
                raise AnnulusError(f"{self.port}: {len(self._held)} bytes without a line's end, expected GRBL's lines")
            try:
                self._held += self._line.read(max(1, min(self._line.in_waiting, LINE_MAX)))
            except (serial.SerialException, OSError) as error:
                raise AnnulusError(f"{self.port}: the stage is gone ({error})") from None
        return None
