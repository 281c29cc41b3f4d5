"""A digitizer that speaks SCPI: the remote half of an InfiniiVision oscilloscope, sans-I/O."""

import re
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.vocabulary import AnnulusError

VOLTS_TRIGGER = 3.3
POINTS_AVERAGED = 1000
FAULTS = ("deaf", "hang", "drop", "short", "huge", "hole", "clip", "nonsense")


@dataclass
class SimulatedScope:
    """Bytes in, bytes out; triggers and volts from the rig.

    `faults` : which `:DIGitize`, counted from 0, goes wrong and how: deaf (sees no trigger), hang (says nothing more),
    drop (hangs up instead of its data), short (hangs up in the middle of them), huge (says it sends a gigabyte), hole
    (a stretch without data), clip (a range too small), nonsense (a preamble that is none).
    """

    faults: Mapping[int, str] = field(default_factory=dict)
    name: str = "KEYSIGHT TECHNOLOGIES,DSO-X 4052A,MY00000001,07.30"
    seed: int = 1

    def __post_init__(self) -> None:
        if unknown := set(self.faults.values()) - set(FAULTS):
            raise AnnulusError(f"fault {unknown.pop()!r}: expected one of {', '.join(FAULTS)}")
        self.digitizes = 0
        self.triggers_seen = 0
        self.hang_up = False  # the line is to be closed when what was answered has been sent
        self._heard = bytearray()
        self._commands: deque[str] = deque()
        self._errors: deque[str] = deque()
        self._set: dict[str, str] = {
            ":TIMEBASE:RANGE": "1E-3",
            ":TIMEBASE:POSITION": "0",
            ":CHANNEL1:RANGE": "4",
            ":CHANNEL1:OFFSET": "0",
            ":TRIGGER:EDGE:SOURCE": "CHANNEL1",
            ":TRIGGER:EDGE:SLOPE": "POSITIVE",
            ":TRIGGER:EDGE:LEVEL": "0",
            ":ACQUIRE:TYPE": "NORMAL",
            ":ACQUIRE:COUNT": "8",
            ":WAVEFORM:POINTS": "1000",
            ":WAVEFORM:FORMAT": "BYTE",
            ":WAVEFORM:BYTEORDER": "MSBFIRST",
            ":WAVEFORM:UNSIGNED": "1",
        }
        self._rng = np.random.default_rng([self.seed, 17])
        self._wanted = 0  # triggers a :DIGitize still waits for
        self._count = 0
        self._sum: NDArray[np.float64] = np.zeros(0)
        self._silent = False
        self._fault = ""

    # ---- the rig's side ----

    @property
    def waits(self) -> bool:
        return self._wanted > 0 and self._fault != "deaf" and not self._silent

    def triggered_by(self, level: int) -> bool:
        """Would this edge on the external input trigger it?"""
        source, slope = self._set[":TRIGGER:EDGE:SOURCE"], self._set[":TRIGGER:EDGE:SLOPE"]
        return (
            self.waits
            and source.startswith("EXT")
            and slope.startswith("POS") == bool(level)
            and 0 < self._number(":TRIGGER:EDGE:LEVEL") < VOLTS_TRIGGER
        )

    def window(self) -> tuple[float, float, int]:
        """(first sample after the trigger in s, samples a second, samples)."""
        span, points = self._number(":TIMEBASE:RANGE"), int(self._number(":WAVEFORM:POINTS"))
        if self._averages() > 1:
            points = min(points, POINTS_AVERAGED)
        return self._number(":TIMEBASE:POSITION") - span / 2, points / span, points

    def record(self, volts: NDArray[np.float64]) -> None:
        """One triggered acquisition: eight bits each, averaged in sixteen."""
        if self._wanted <= 0:
            return
        full = self._number(":CHANNEL1:RANGE") * (0.02 if self._fault == "clip" else 1.0)
        codes = np.clip(np.round((volts - self._number(":CHANNEL1:OFFSET")) / full * 256) + 128, 1, 255)
        self._sum = codes if self._count == 0 else self._sum + codes
        self._count += 1
        self._wanted -= 1
        self.triggers_seen += 1

    # ---- the line's side ----

    def connect(self) -> None:
        self._commands.clear()
        self._heard.clear()
        self._wanted, self._silent, self.hang_up = 0, False, False

    def receive(self, data: bytes) -> bytes:
        """What it answers now; call it again when time has passed, with or without bytes."""
        self._heard += data
        if len(self._heard) > 1 << 16:
            self._heard.clear()
        *lines, rest = bytes(self._heard).split(b"\n")
        self._heard[:] = rest
        for line in lines:
            self._commands += [part.strip() for part in line.decode("ascii", "replace").split(";") if part.strip()]
        answers = bytearray()
        while self._commands and not self._wanted and not self._silent and not self.hang_up:
            answers += self._obey(self._commands.popleft())
        return bytes(answers)

    def _obey(self, command: str) -> bytes:
        head, _, argument = command.partition(" ")
        query, name = head.endswith("?"), _long(head.rstrip("?"))
        if query:
            return self._answer(name)
        match name:
            case "*CLS":
                self._errors.clear()
            case "*RST" | ":STOP":
                pass
            case ":DIGITIZE":
                self._fault = self.faults.get(self.digitizes, "")
                self.digitizes += 1
                self._silent = self._fault == "hang"
                self._wanted, self._count = self._averages(), 0
            case _ if name in self._set or name in _ACCEPTED:
                self._accept(name, argument)
            case _:
                self._errors.append('-113,"Undefined header"')
        return b""

    def _accept(self, name: str, argument: str) -> None:
        if name in self._set and re.fullmatch(r"[-+.\dE]+", self._set[name], re.I) and name != ":WAVEFORM:UNSIGNED":
            try:
                value = float(argument)
            except ValueError:
                self._errors.append('-104,"Data type error"')
                return
            low, high = _LIMITS.get(name, (-1e9, 1e9))
            if not low <= value <= high:
                self._errors.append('-222,"Data out of range"')
                return
        self._set[name] = argument.upper()

    def _answer(self, name: str) -> bytes:
        start, rate, points = self.window()
        full = self._number(":CHANNEL1:RANGE") * (0.02 if self._fault == "clip" else 1.0)
        match name:
            case "*IDN":
                return self.name.encode() + b"\n"
            case "*OPC":
                return b"1\n"
            case ":SYSTEM:ERROR":
                return (self._errors.popleft() if self._errors else '+0,"No error"').encode() + b"\n"
            case ":WAVEFORM:COUNT":
                return b"%d\n" % max(self._count, 1)
            case ":WAVEFORM:PREAMBLE" if self._fault == "nonsense":
                return b"+1,+2,many,0,nan,1E400,+0,,,\n"
            case ":WAVEFORM:PREAMBLE":
                kind = 2 if self._averages() > 1 else 0
                offset = self._number(":CHANNEL1:OFFSET")
                return (
                    f"+1,+{kind},+{points},+{max(self._count, 1)},{1 / rate:+.9E},{start:+.9E},+0,"
                    f"{full / 65536:+.7E},{offset:+.7E},+32768\n"
                ).encode()
            case ":WAVEFORM:DATA":
                return self._data(points)
            case _ if name in self._set:
                return self._set[name].encode() + b"\n"
        self._errors.append('-113,"Undefined header"')
        return b""

    def _data(self, points: int) -> bytes:
        if not self._count:
            self._errors.append('-230,"Data corrupt or stale"')
            return b"#10\n"
        words = np.round(self._sum / self._count * 256).astype(np.uint16)
        if self._fault == "hole":
            words[points // 2 : points // 2 + 20] = 0
        order = "<u2" if self._set[":WAVEFORM:BYTEORDER"].startswith("LSB") else ">u2"
        body = words.astype(order).tobytes()
        block = b"#8%08d" % len(body) + body + b"\n"
        self.hang_up = self._fault in ("drop", "short")
        if self._fault == "huge":
            return b"#9999999999" + body
        return {"drop": b"", "short": block[: len(block) // 2]}.get(self._fault, block)

    def noise(self, rms: float, samples: int) -> NDArray[np.float64]:
        return rms * self._rng.standard_normal(samples)

    def _averages(self) -> int:
        return int(self._number(":ACQUIRE:COUNT")) if self._set[":ACQUIRE:TYPE"].startswith("AVER") else 1

    def _number(self, name: str) -> float:
        return float(self._set[name])


_LONG = (
    "TIMEBASE",
    "MODE",
    "REFERENCE",
    "RANGE",
    "POSITION",
    "CHANNEL1",
    "DISPLAY",
    "OFFSET",
    "TRIGGER",
    "EDGE",
    "SOURCE",
    "SLOPE",
    "LEVEL",
    "SWEEP",
    "ACQUIRE",
    "TYPE",
    "COUNT",
    "COMPLETE",
    "WAVEFORM",
    "FORMAT",
    "BYTEORDER",
    "UNSIGNED",
    "POINTS",
    "DIGITIZE",
    "STOP",
    "SYSTEM",
    "ERROR",
    "PREAMBLE",
    "DATA",
)
_SHORT = {
    "TIM": "TIMEBASE",
    "REF": "REFERENCE",
    "RANG": "RANGE",
    "POS": "POSITION",
    "CHAN1": "CHANNEL1",
    "DISP": "DISPLAY",
    "OFFS": "OFFSET",
    "TRIG": "TRIGGER",
    "SOUR": "SOURCE",
    "SLOP": "SLOPE",
    "LEV": "LEVEL",
    "SWE": "SWEEP",
    "ACQ": "ACQUIRE",
    "COUN": "COUNT",
    "COMP": "COMPLETE",
    "WAV": "WAVEFORM",
    "FORM": "FORMAT",
    "BYT": "BYTEORDER",
    "UNS": "UNSIGNED",
    "POIN": "POINTS",
    "DIG": "DIGITIZE",
    "SYST": "SYSTEM",
    "ERR": "ERROR",
    "PRE": "PREAMBLE",
}
_ACCEPTED = (
    ":TIMEBASE:MODE",
    ":TIMEBASE:REFERENCE",
    ":CHANNEL1:DISPLAY",
    ":TRIGGER:MODE",
    ":TRIGGER:SWEEP",
    ":ACQUIRE:COMPLETE",
    ":WAVEFORM:SOURCE",
    ":WAVEFORM:POINTS:MODE",
)
_LIMITS = {
    ":TIMEBASE:RANGE": (2e-8, 500.0),
    ":CHANNEL1:RANGE": (8e-3, 40.0),
    ":ACQUIRE:COUNT": (2, 65536),
    ":WAVEFORM:POINTS": (100, 4e6),
}


def _long(header: str) -> str:
    """Every mnemonic in its long form, capitals; unknown ones as they are."""
    if header.startswith("*"):
        return header.upper()
    parts = [part.upper() for part in header.lstrip(":").split(":")]
    return ":" + ":".join(_SHORT.get(part, part) for part in parts)
