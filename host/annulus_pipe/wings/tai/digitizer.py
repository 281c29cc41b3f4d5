"""Records sound after a trigger: what a digitizer must do, and a Keysight InfiniiVision oscilloscope that does it.

    with ScopeDigitizer("TCPIP::192.168.1.20::5025::SOCKET") as scope:
        scope.configure(Acquisition(rate_hz=10e6, duration_s=64e-6, range_v=0.08, averages=64))
        scope.arm()
        ...                                  # 64 triggers
        trace = scope.read()

Commands: Keysight InfiniiVision 4000 X-Series Programmer's Guide. An average is complete only behind `:DIGitize`, which
blocks the scope until it has seen every trigger: one lost trigger, and it never answers. That is how it is noticed.
"""

import contextlib
import math
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.extras import need
from annulus_pipe.vocabulary import AnnulusError

ANSWER_S = 3.0
AVERAGES_MAX = 65536
POINTS_AVERAGED = 1000  # what InfiniiVision returns of an average at most
POINTS = (100, 250, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000, 1_000_000)
BLOCK_MAX = 2 * POINTS[-1]
LINE_MAX = 1024
HOLE, RAIL_LOW, RAIL_HIGH = 0, 0x0100, 0xFF00  # of 16-bit words: no data; the converter's first and last step
TRIGGER_LEVEL_V = 1.5  # half of the controller's 3.3 V


class TriggerLostError(AnnulusError):
    """Fewer triggers were seen than were sent."""


class DigitizerLostError(AnnulusError):
    """It answers no more, or not what it should. `recover` may bring it back."""


@dataclass(frozen=True, slots=True)
class Acquisition:
    """What is wanted. `delay_s`: from the trigger's edge to the first sample. `range_v`: full scale, about 0 V."""

    rate_hz: float  # at least, if the digitizer can
    duration_s: float
    range_v: float
    averages: int = 1
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("rate_hz", self.rate_hz, 1e3, 5e9),
            ("duration_s", self.duration_s, 1e-7, 1.0),
            ("range_v", self.range_v, 8e-3, 40.0),
            ("averages", self.averages, 1, AVERAGES_MAX),
            ("delay_s", self.delay_s, -0.1, 0.5),
        ):
            if not (math.isfinite(value) and low <= value <= high):
                raise AnnulusError(f"acquisition: {name} is {value:g}, expected {low:g}..{high:g}")


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One averaged record. Sample k was taken t0_s + k / rate_hz after the trigger's edge; NaN where none was."""

    volts: NDArray[np.float32]
    rate_hz: float
    t0_s: float
    clipped: int  # samples at the converter's rail


class Digitizer(Protocol):
    """One receiver behind one trigger."""

    name: str

    def configure(self, acquisition: Acquisition) -> None: ...

    def arm(self) -> None:
        """Wait for `averages` triggers from now on. Returns when it does."""

    def read(self) -> Trace:
        """The average, once every trigger has come. TriggerLostError, DigitizerLostError."""

    def recover(self) -> None:
        """Begin anew after an error: connected, configured, not armed."""

    def close(self) -> None: ...


class ScopeDigitizer:
    """A Keysight InfiniiVision scope (DSOX4052A and its kin) through PyVISA's own Python back end.

    Signal on `channel`, the controller's trigger on the external input. Raises AnnulusError when it is not there or not
    one of these; every later failure is a TriggerLostError or a DigitizerLostError. Nothing it sends is believed:
    blocks and preambles are bounded and checked.
    """

    def __init__(
        self,
        resource: str,
        *,
        channel: int = 1,
        trigger: str = "EXTernal",
        settle_s: float = 0.05,
        answer_s: float = ANSWER_S,
    ) -> None:
        """resource : VISA name, TCPIP::host::5025::SOCKET, TCPIP::host::INSTR or TCPIP::host::hislip0::INSTR; only the
        last two can clear a scope that waits for a trigger. settle_s : from `:DIGitize` until it surely waits.
        """
        self.resource, self.channel, self.trigger = resource, channel, trigger
        self.name = ""
        self._settle_s, self._answer_s = settle_s, answer_s
        self._acquisition: Acquisition | None = None
        self._session: Any = None
        self._waiting = False  # for triggers: it answers nothing else
        self._open()

    def configure(self, acquisition: Acquisition) -> None:
        """Raises AnnulusError where the scope refuses a setting, in its own words."""
        self._acquisition = acquisition
        averaged = acquisition.averages > 1
        allowed = [n for n in POINTS if not averaged or n <= POINTS_AVERAGED]
        enough = [n for n in allowed if n >= acquisition.rate_hz * acquisition.duration_s * (1 - 1e-9)]
        source = f"CHANnel{self.channel}"
        for command in (
            "*CLS",
            ":STOP",
            ":TIMebase:MODE MAIN",
            ":TIMebase:REFerence CENTer",
            f":TIMebase:RANGe {acquisition.duration_s:.9E}",
            f":TIMebase:POSition {acquisition.delay_s + acquisition.duration_s / 2:.9E}",
            f":{source}:DISPlay ON",
            f":{source}:OFFSet 0",
            f":{source}:RANGe {acquisition.range_v:.6E}",
            ":TRIGger:MODE EDGE",
            f":TRIGger:EDGE:SOURce {self.trigger}",
            ":TRIGger:EDGE:SLOPe POSitive",
            f":TRIGger:EDGE:LEVel {TRIGGER_LEVEL_V}",
            ":TRIGger:SWEep NORMal",
            f":ACQuire:TYPE {'AVERage' if averaged else 'NORMal'}",
            *([f":ACQuire:COUNt {acquisition.averages}", ":ACQuire:COMPlete 100"] if averaged else []),
            f":WAVeform:SOURce {source}",
            ":WAVeform:FORMat WORD",
            ":WAVeform:BYTeorder LSBFirst",
            ":WAVeform:UNSigned ON",
            f":WAVeform:POINts:MODE {'NORMal' if averaged else 'MAXimum'}",
            f":WAVeform:POINts {enough[0] if enough else allowed[-1]}",
        ):
            self._write(command)
        complaint = self._ask(":SYSTem:ERRor?")
        if not complaint.lstrip("+").startswith("0"):
            raise AnnulusError(f"{self.resource}: refuses the acquisition: {complaint[:200]}")

    def arm(self) -> None:
        assert self._acquisition is not None, "configure first"
        self._waiting = True
        self._write(f":DIGitize CHANnel{self.channel}")
        self._write("*OPC?")  # answered when it has all triggers
        time.sleep(self._settle_s)

    def read(self) -> Trace:
        acquisition = self._acquisition
        assert acquisition is not None, "configure first"
        try:
            self._line()
        except DigitizerLostError:
            raise TriggerLostError(
                f"{self.resource}: waits for a trigger {self._answer_s:g} s after the last of {acquisition.averages} "
                "was sent: trigger cable, or bursts too close for it to rearm?"
            ) from None
        self._waiting = False
        preamble = self._preamble(self._ask(":WAVeform:PREamble?"))
        self._write(":WAVeform:DATA?")
        words = np.frombuffer(self._block(2 * preamble.points), "<u2")
        volts = ((words.astype(np.float64) - preamble.y_reference) * preamble.y_step + preamble.y_origin).astype("f4")
        volts[words == HOLE] = np.nan
        clipped = np.count_nonzero((words >= RAIL_HIGH) | ((words <= RAIL_LOW) & (words != HOLE)))
        return Trace(volts, 1 / preamble.x_step, preamble.x_origin, int(clipped))

    def recover(self) -> None:
        self.close()
        self._open()
        if self._acquisition is not None:
            self.configure(self._acquisition)

    def close(self) -> None:
        if self._session is None:
            return
        with contextlib.suppress(Exception):  # a line that is gone closes with whatever error it likes
            # A socket cannot be cleared, and pyvisa-py's attempt on a dead one never ends.
            if self._waiting and not self.resource.upper().endswith("SOCKET"):
                self._session.clear()
            self._session.close()
        self._session, self._waiting = None, False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # ---- the line ----

    def _open(self) -> None:
        pyvisa = need("pyvisa")
        need("pyvisa_py")
        try:
            session = pyvisa.ResourceManager("@py").open_resource(self.resource, open_timeout=2000)
        except Exception as error:  # pyvisa-py raises plain Exceptions too
            raise DigitizerLostError(
                f"{self.resource}: cannot be opened ({_reason(error)}), expected a VISA name such as "
                "TCPIP::192.168.1.20::5025::SOCKET"
            ) from None
        self._session = session
        self._session.timeout = int(1000 * self._answer_s)
        self._session.read_termination = self._session.write_termination = None
        try:
            self.name = self._ask("*IDN?")
        except DigitizerLostError as error:
            self.close()
            raise DigitizerLostError(f"{error}; one that still waits for a trigger needs its Stop key") from None
        maker = self.name.upper()
        if not (("KEYSIGHT" in maker or "AGILENT" in maker) and ("SO-X" in maker or "SOX" in maker)):
            self.close()
            raise AnnulusError(f"{self.resource}: is {self.name[:80]!r}, expected a Keysight InfiniiVision scope")

    def _write(self, command: str) -> None:
        self._guarded(lambda: self._session.write_raw(command.encode("ascii") + b"\n"))

    def _ask(self, question: str) -> str:
        self._write(question)
        return self._line()

    def _line(self) -> str:
        line = bytes(self._guarded(self._read_line))
        if not line.endswith(b"\n"):
            raise DigitizerLostError(f"{self.resource}: a line of {len(line)} bytes and no end, expected an answer")
        return line.decode("ascii", "replace").strip()

    def _read_line(self) -> bytes:
        StatusCode = need("pyvisa.constants").StatusCode
        session = self._session
        with session.read_termination_context("\n"), session.ignore_warning(StatusCode.success_max_count_read):
            line: bytes = session.visalib.read(session.session, LINE_MAX)[0]
            return line

    def _bytes(self, count: int) -> bytes:
        return bytes(self._guarded(lambda: self._session.read_bytes(count, chunk_size=20_480, break_on_termchar=False)))

    def _block(self, size: int) -> bytes:
        """IEEE 488.2: #, how many digits, so many digits, so many bytes."""
        head = self._bytes(2)
        if head[:1] != b"#" or not head[1:].isdigit() or head[1:] == b"0":
            raise DigitizerLostError(f"{self.resource}: data begin with {head!r}, expected a block of known length")
        digits = self._bytes(int(head[1:]))
        if not digits.isdigit() or int(digits) != size:
            raise DigitizerLostError(
                f"{self.resource}: a block of {digits.decode('ascii', 'replace')} bytes, expected {size}"
            )
        data = self._bytes(size)
        self._line()
        return data

    def _preamble(self, text: str) -> "_Preamble":
        assert self._acquisition is not None
        try:
            numbers = [float(field) for field in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != 10 or not all(map(math.isfinite, numbers)):
            raise DigitizerLostError(f"{self.resource}: preamble {text[:120]!r}, expected ten numbers")
        kind, _, points, _, x_step, x_origin, _, y_step, y_origin, y_reference = numbers
        if (
            kind != 1
            or points != int(points)
            or not 16 <= points <= BLOCK_MAX // 2
            or not 1e-10 <= x_step <= 1e-2
            or abs(x_origin) > 1.0
            or not 0 < abs(y_step) < 1.0
            or abs(y_origin) > 100
            or not 0 <= y_reference <= 65535
        ):
            raise DigitizerLostError(f"{self.resource}: preamble {text[:120]!r} makes no sense, expected 16-bit data")
        span = points * x_step
        if not 0.5 * self._acquisition.duration_s <= span <= 4 * self._acquisition.duration_s:
            raise DigitizerLostError(
                f"{self.resource}: {1e6 * span:g} us were recorded, expected {1e6 * self._acquisition.duration_s:g} us"
            )
        return _Preamble(int(points), x_step, x_origin, y_step, y_origin, y_reference)

    def _guarded(self, action: Any) -> Any:
        lost = need("pyvisa.errors").Error
        if self._session is None:
            raise DigitizerLostError(f"{self.resource}: gone, expected the digitizer")
        try:
            return action()
        except (lost, OSError, ValueError, AttributeError) as error:  # pyvisa-py's broken sockets raise all of these
            raise DigitizerLostError(f"{self.resource}: no answer ({_reason(error)}), expected the digitizer") from None


@dataclass(frozen=True, slots=True)
class _Preamble:
    points: int
    x_step: float
    x_origin: float
    y_step: float
    y_origin: float
    y_reference: float


def _reason(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:160]
