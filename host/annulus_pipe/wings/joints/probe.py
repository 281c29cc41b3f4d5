"""A near-field probe's reading at one place, one or two channels, mV: by VISA, or of another program's samples.

probe = VisaProbe("TCPIP::192.168.1.30::5025::SOCKET", {"amplitude_mv": "MEAS:VOLT:DC? (@101)"})
probe.read()                             # {"amplitude_mv": 312.4}
"""

import contextlib
import math
import time
from collections.abc import Mapping
from typing import Any, Protocol

from annulus_pipe.extras import need
from annulus_pipe.sensors.remote import RemoteSensors
from annulus_pipe.vocabulary import AnnulusError

ANSWER_S = 3.0
LINE_MAX = 128
VOLTS_MAX = 100.0
MV = {"mV": 1.0, "V": 1000.0}


class ProbeLostError(AnnulusError):
    """The probe did not answer, or not with a number. `recover` may bring it back."""


class Probe(Protocol):
    """A detector that says, when asked, what it sees."""

    channels: tuple[str, ...]

    def read(self) -> dict[str, float]:
        """Mv by channel, finite. ProbeLostError."""

    def recover(self) -> None: ...

    def close(self) -> None: ...


class VisaProbe:
    """A voltmeter, scope or data logger: a query a channel, each answered by a number of volts."""

    def __init__(self, resource: str, queries: Mapping[str, str]) -> None:
        self.resource, self.channels = resource, tuple(queries)
        self._queries = dict(queries)
        self._session: Any = None
        self.recover()

    def read(self) -> dict[str, float]:
        return {name: self._asked(query) for name, query in self._queries.items()}

    def recover(self) -> None:
        pyvisa = need("pyvisa")
        need("pyvisa_py")
        self.close()
        try:
            self._session = pyvisa.ResourceManager("@py").open_resource(self.resource, open_timeout=2000)
        except Exception as error:  # pyvisa-py raises plain Exceptions too
            raise ProbeLostError(
                f"{self.resource}: cannot be opened ({_reason(error)}), expected a VISA name such as "
                "TCPIP::192.168.1.30::5025::SOCKET"
            ) from None
        self._session.timeout = int(1000 * ANSWER_S)
        self._session.read_termination, self._session.write_termination = "\n", "\n"

    def close(self) -> None:
        if self._session is not None:
            with contextlib.suppress(Exception):  # of a socket that is gone
                self._session.close()
        self._session = None

    def _asked(self, query: str) -> float:
        lost = need("pyvisa.errors").Error
        if self._session is None:
            raise ProbeLostError(f"{self.resource}: gone, expected the probe's detector")
        try:
            text = str(self._session.query(query))[:LINE_MAX].strip()
        except (lost, OSError, ValueError, AttributeError) as error:
            raise ProbeLostError(f"{self.resource}: no answer to {query!r} ({_reason(error)})") from None
        try:
            volts = float(text.split(",")[0])
        except ValueError:
            volts = math.nan
        if not abs(volts) <= VOLTS_MAX:
            raise ProbeLostError(f"{self.resource}: {query!r} is answered by {text[:40]!r}, expected volts")
        return 1000.0 * volts


class SampleProbe:
    """What another program publishes as samples (`sensors.remote`); the values of one of its sensors, by name."""

    def __init__(self, address: str, sensor: str, values: Mapping[str, str]) -> None:
        """values : the sample's name of each channel."""
        self.channels = tuple(values)
        self._sensor, self._values, self._address = sensor, dict(values), address
        self._remote = RemoteSensors(address)

    def read(self) -> dict[str, float]:
        asked_ns, end = time.monotonic_ns(), time.monotonic() + ANSWER_S
        while time.monotonic() < end:
            for sample in self._remote.poll():
                if sample.sensor == self._sensor and sample.host_ns > asked_ns:
                    return {name: self._mv(sample.values, sample.units, key) for name, key in self._values.items()}
            time.sleep(0.002)
        raise ProbeLostError(f"{self._address}: no sample of {self._sensor!r} within {ANSWER_S:g} s")

    def recover(self) -> None:
        """Nothing to do: the connection to the samples restores itself."""

    def close(self) -> None:
        self._remote.close()

    def _mv(self, values: Mapping[str, float], units: Mapping[str, str], key: str) -> float:
        value, unit = values.get(key, math.nan), units.get(key, "")
        if unit not in MV or not math.isfinite(value):
            raise ProbeLostError(
                f"{self._address}: {self._sensor}'s {key} is {value:g} {unit!r}, expected a number of mV or V"
            )
        return value * MV[unit]


def _reason(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:160]
