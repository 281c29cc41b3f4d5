"""The receiver at the rim: the microwave's envelope and the turntable's angle in, volts out."""

import functools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.controller import TICK_S
from annulus_pipe.numeric.late import fft
from annulus_pipe.wings.tai.simulated.phantom import Responses, RigSetup

PULSE_S = 0.5e-6  # the pulse that `pulse_v` speaks of
TAIL_S = 20e-6  # of the receiver and its amplifier, generously
RECOVERY_S = 0.4e-6  # of the amplifier after the coupled radio frequency


class Receiver:
    """One point at the rim of what `Responses` knows; what it has worked out it keeps."""

    def __init__(self, setup: RigSetup, progress: Callable[[str, int, int], None] | None = None) -> None:
        self.setup = setup
        self.responses = Responses(setup, progress)
        self._heard = functools.lru_cache(maxsize=16)(self._record)
        self._spectrum = functools.lru_cache(maxsize=4)(self._kernel)
        self._at = functools.lru_cache(maxsize=64)(self._turned)

    def hear(
        self, pulses_ticks: tuple[tuple[int, int], ...], steps: int, t0_s: float, rate_hz: float, samples: int
    ) -> NDArray[np.float64]:
        """(samples,) volts without noise, from t0_s after tick 0 on. pulses_ticks : on and off, from the same tick."""
        heard_from = t0_s - self.responses.length_s - TAIL_S
        near = tuple(p for p in pulses_ticks if heard_from < p[1] * TICK_S and p[0] * TICK_S < t0_s + samples / rate_hz)
        return self._heard(near, steps % self.setup.steps_per_turn, t0_s, rate_hz, samples)

    def _record(
        self, pulses: tuple[tuple[int, int], ...], steps: int, t0_s: float, rate_hz: float, samples: int
    ) -> NDArray[np.float64]:
        if not pulses:
            return np.zeros(samples)
        first_s = min(t0_s, pulses[0][0] * TICK_S)
        lasting_s = t0_s + samples / rate_hz - first_s + self.responses.length_s + TAIL_S  # until all has faded
        whole = fft.next_fast_len(math.ceil(lasting_s * rate_hz), real=True)
        frequency = fft.rfftfreq(whole, 1 / rate_hz)
        frequency = frequency[frequency < self.responses.highest_hz]
        turning = 2j * math.pi * frequency
        edges = np.array(pulses, float) * TICK_S
        burst = np.exp(-np.outer(turning, edges[:, 0])).sum(axis=1) - np.exp(-np.outer(turning, edges[:, 1])).sum(
            axis=1
        )
        burst[1:] /= turning[1:]
        burst[0] = np.diff(edges, axis=1).sum()
        sound = self._spectrum(len(frequency), rate_hz / whole) @ self._at(steps)
        setup = self.setup
        volts = setup.pulse_v / PULSE_S * sound + setup.spike_v / PULSE_S / (1 + turning * RECOVERY_S)
        if setup.transducer is not None:
            volts = volts * _band(frequency, *setup.transducer)
        heard = np.zeros(whole // 2 + 1, complex)
        heard[: len(frequency)] = volts * burst * np.exp(turning * t0_s)
        return np.asarray(fft.irfft(heard, whole)[:samples] * rate_hz)

    def _kernel(self, count: int, spacing_hz: float) -> NDArray[np.complex64]:
        """(frequencies, steps): Fourier's integral over the response, at the record's own frequencies."""
        frequency = np.arange(count) * spacing_hz
        times = np.arange(round(self.responses.length_s / self.responses.dt_s)) * self.responses.dt_s
        weight = np.full(len(times), self.responses.dt_s)
        weight[0] /= 2
        return np.asarray(np.exp(-2j * math.pi * np.outer(frequency, times)) * weight, np.complex64)

    def _turned(self, steps: int) -> NDArray[np.float64]:
        return self.responses.at(self.setup.angle_deg(steps))


def _band(frequency: NDArray[np.float64], centre_hz: float, bandwidth: float) -> NDArray[np.float64]:
    """Of a Gaussian pulse: -6 dB at +-bandwidth/2 of the centre."""
    edge = bandwidth * centre_hz / 2
    away = np.stack([frequency - centre_hz, frequency + centre_hz]) / edge
    return np.asarray(np.exp(math.log(10 ** (-6 / 20)) * away**2).sum(axis=0))
