"""Decoding filters (templates) for on/off codes, as convex problems, and the decoding itself.

A template is a mismatched filter: with the code it makes one peak of height 1 and sidelobes as low as they can be.
Noise comes through as the filter's own length, so every design says what it gains over one pulse of the same power.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.extras import need
from annulus_pipe.numeric.arrays import Chips
from annulus_pipe.numeric.late import fft, linalg, optimize, signal
from annulus_pipe.vocabulary import AnnulusError

FloatArray = NDArray[np.float64]
Method = Literal["matched", "least-squares", "minimax"]

TAPS_MAX = 2048  # Guard: test_bad_input_is_one_line
SLACK = 1e-4  # a sidelobe this much higher is worth the lowest noise. Guard: topic templates (59.1 at 7.84 dB)
PEAKS = 12  # chips to each side of the middle where the peak may come to stand. Guard: topic templates


@dataclass(frozen=True, slots=True, eq=False)
class Transducer:
    """Impulse response of the receiver, any scale; sample 0 is the instant of the impulse."""

    response: FloatArray
    sampling_rate_hz: float

    @classmethod
    def band(cls, centre_hz: float, bandwidth: float, sampling_rate_hz: float) -> "Transducer":
        """A Gaussian band: centre, and width at -6 dB as part of the centre (2.25 MHz, 0.7)."""
        if not (0 < centre_hz < sampling_rate_hz / 2 and 0 < bandwidth < 2):
            raise AnnulusError(
                f"a transducer of {centre_hz / 1e6:g} MHz and {100 * bandwidth:g} % at {sampling_rate_hz / 1e6:g} MHz "
                "sampling, expected a centre below half of that and a width below 200 %"
            )
        half = math.ceil(3.0 / (bandwidth * centre_hz) * sampling_rate_hz)
        times = np.arange(-half, half + 1) / sampling_rate_hz
        return cls(np.asarray(signal.gausspulse(times, fc=centre_hz, bw=bandwidth)), sampling_rate_hz)


@dataclass(frozen=True, slots=True, eq=False)
class Template:
    """Taps `spacing` chips apart. The output, code * pulse * taps in full, peaks with 1 at index `peak`.

    `psr` : peak over the highest sidelobe outside +-guard_chips. `gain_db` : amplitude over noise, against one pulse of
    the same power in the same white noise, filtered with what is best for it (its matched filter). `ceiling_db` : what
    no linear filter can exceed. `delay` : chips from chip 0's start to where the pulse's middle stands in the output.
    """

    code: str
    taps: FloatArray
    spacing: float
    peak: int
    output: FloatArray
    psr: float
    gain_db: float
    ceiling_db: float
    guard_chips: float
    method: Method
    delay: float

    def averages_db(self, shots: int) -> float:
        """What averaging that many single pulses would give instead."""
        return 10 * math.log10(shots)


def design(
    chips: Chips,
    taps_chips: int = 150,
    method: Method = "minimax",
    *,
    transducer: Transducer | None = None,
    samples_per_chip: int = 1,
    chip_s: float = 0.5e-6,
    guard_chips: float = 0.0,
    gain_floor_db: float | None = None,
) -> Template:
    """The template of one code.

    Parameters
    ----------
    taps_chips : length in chips (the source uses three times the code).
    method : "matched" correlates with the code as it is; "least-squares" has the least energy beside the peak;
        "minimax" has the lowest highest sidelobe, and of all such the least noise.
    transducer, samples_per_chip : with a transducer the taps lie samples_per_chip to a chip and the pulse it really
        hears is what is compressed; without one they lie a chip apart and the pulse keeps its shape.
    guard_chips : so much to both sides of the peak is no sidelobe; a heard pulse needs 2.
    gain_floor_db : the gain may not fall below. Behind a transducer the problem needs it: sidelobes could always be
        bought with noise, and a filter that gains -30 dB is of no use.

    Raises
    ------
    AnnulusError where the floor is above what the code can reach, or the sizes make no sense.
    """
    code = chips.astype(float)
    if not 1 <= taps_chips * samples_per_chip <= TAPS_MAX:
        raise AnnulusError(f"{taps_chips * samples_per_chip} taps, expected 1..{TAPS_MAX}")
    if transducer is None and samples_per_chip != 1:
        raise AnnulusError("taps closer than a chip need a transducer: without one there is nothing between the chips")
    heard = np.ones(1)
    if transducer is not None:
        rate = samples_per_chip / chip_s
        heard = np.convolve(np.ones(samples_per_chip), _resampled(transducer, rate))
        if float(np.abs(heard).max()) == 0.0:
            raise AnnulusError("the transducer's response is zero")
    spread = np.zeros(len(code) * samples_per_chip)
    spread[::samples_per_chip] = code
    received = np.convolve(spread, heard)
    single = float(np.linalg.norm(heard))  # of a pulse behind its own matched filter
    ceiling = 20 * math.log10(float(np.linalg.norm(received)) / single)
    if gain_floor_db is not None and gain_floor_db >= ceiling:
        raise AnnulusError(
            f"a gain of {gain_floor_db:g} dB, but no filter gains more than {ceiling:.2f} dB with this code"
        )
    count = taps_chips * samples_per_chip
    system = _convolution(received, count)
    guard = guard_chips * samples_per_chip
    if method == "matched":
        system = _convolution(received, len(received))
        peak, best = len(received) - 1, received[::-1]
    else:
        places = _places(len(system), samples_per_chip)
        solved = [(place, _solve(system, place, guard, method, gain_floor_db, single)) for place in places]
        peak, best = max(solved, key=lambda item: _psr(system @ item[1], item[0], guard))
        if method == "minimax" and gain_floor_db is None:
            best = _quietest(system, peak, guard, (1 + SLACK) / _psr(system @ best, peak, guard))
    output = system @ best
    scale = output[peak]
    best, output = best / scale, output / scale
    return Template(
        "".join(map(str, chips)),
        best,
        1 / samples_per_chip,
        int(peak),
        output,
        _psr(output, peak, guard),
        -20 * math.log10(float(np.linalg.norm(best)) * single),
        ceiling,
        guard_chips,
        method,
        peak + 0.5 if transducer is None else peak / samples_per_chip,  # a pulse's middle: half a chip after its start
    )


def decode(signals: NDArray[np.floating], sampling_rate_hz: float, template: Template, chip_s: float) -> FloatArray:
    """Compresses a coded shot into what one pulse would have been heard as.

    signals : (.., samples), sample 0 at the start of chip 0. In the answer it is at the middle of the pulse. The filter
    runs in the frequency domain: taps need not lie on samples, and nothing wraps round.
    """
    signals = np.asarray(signals, float)
    if not np.isfinite(signals).all():
        raise AnnulusError("signals hold values that are no numbers: leave those traces out first")
    spacing = template.spacing * chip_s
    if spacing * sampling_rate_hz < 1.0 - 1e-9 and template.spacing == 1.0:
        raise AnnulusError(
            f"sampled at {sampling_rate_hz / 1e6:g} MHz, chips of {1e6 * chip_s:g} us cannot be told apart: "
            f"expected at least {1e-6 / chip_s:g} MHz"
        )
    samples = signals.shape[-1]
    length = fft.next_fast_len(samples + math.ceil(len(template.taps) * spacing * sampling_rate_hz) + 1, real=True)
    frequency = fft.rfftfreq(length, 1 / sampling_rate_hz)
    shift = template.delay * chip_s
    response = np.zeros(len(frequency), complex)
    for n, tap in enumerate(template.taps):
        if tap != 0.0:
            response += tap * np.exp(-2j * math.pi * frequency * (n * spacing - shift))
    if template.spacing < 1.0:  # taps at a rate of their own: their images are no signal
        response *= frequency < 0.5 / spacing
    # What the shift pulls before sample 0 wraps to the end, beyond `samples`: cut off.
    spectrum = fft.rfft(signals, length, axis=-1)
    return np.asarray(fft.irfft(spectrum * response, length, axis=-1)[..., :samples])


def decode_pair(
    shots: Sequence[NDArray[np.floating]], sampling_rate_hz: float, codes: Sequence[Chips], chip_s: float
) -> FloatArray:
    """Complementary Manchester pair: each shot with its own bipolar version 2 S - 1, summed (Eq. 8.19 mended, 8.20)."""
    total = np.zeros(np.shape(shots[0]))
    for signals, chips in zip(shots, codes, strict=True):
        taps = (2.0 * chips.astype(float) - 1.0)[::-1] / (len(codes) * int(chips.sum()))  # Eq. 8.19, mended
        peak = len(chips) - 1
        template = Template(
            "".join(map(str, chips)),
            taps,
            1.0,
            peak,
            np.convolve(chips, taps),
            math.nan,
            math.nan,
            math.nan,
            0.0,
            "matched",
            peak + 0.5,
        )
        total += decode(signals, sampling_rate_hz, template, chip_s)  # Eq. 8.20
    return total


def pair_correlation(codes: Sequence[Chips]) -> NDArray[np.int64]:
    """Sum of the correlations of each on/off code with its bipolar version (Eq. 8.20); peak in the middle."""
    return np.asarray(
        sum(np.correlate(c.astype(np.int64), 2 * c.astype(np.int64) - 1, mode="full") for c in codes), np.int64
    )


def _convolution(received: FloatArray, taps: int) -> FloatArray:
    """(len + taps - 1, taps): matrix @ taps is the full convolution."""
    return np.asarray(
        linalg.toeplitz(
            np.concatenate([received, np.zeros(taps - 1)]), np.concatenate([received[:1], np.zeros(taps - 1)])
        )
    )


def _solve(
    system: FloatArray, peak: int, guard: float, method: Method, floor_db: float | None, single: float
) -> FloatArray:
    beside = system[np.abs(np.arange(len(system)) - peak) > guard]
    count = system.shape[1]
    if floor_db is None and method == "least-squares":
        # minimise |beside h|^2 with peak h = 1, in closed form; the ridge only keeps it solvable
        gram = beside.T @ beside
        gram += 1e-10 * np.trace(gram) / count * np.eye(count)
        taps = np.linalg.solve(gram, system[peak])
        return np.asarray(taps / (system[peak] @ taps))
    if floor_db is None:
        column = np.full((len(beside), 1), -1.0)
        answer = optimize.linprog(
            np.append(np.zeros(count), 1.0),
            A_ub=np.block([[beside, column], [-beside, column]]),
            b_ub=np.zeros(2 * len(beside)),
            A_eq=np.append(system[peak], 0.0)[None],
            b_eq=[1.0],
            bounds=[(None, None)] * count + [(0.0, None)],
            method="highs",
        )
        if answer.x is None:
            raise AnnulusError(f"no such template exists (the solver says {answer.message}): take more taps")
        return np.asarray(answer.x[:count])
    cvxpy = need("cvxpy")  # seconds to import, and only these designs need it
    variable, bound = cvxpy.Variable(count), cvxpy.Variable()
    held = [system[peak] @ variable == 1, cvxpy.norm(variable) <= 10 ** (-floor_db / 20) / single]
    if method == "least-squares":
        return _optimum(cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(beside @ variable)), held), variable)
    return _optimum(cvxpy.Problem(cvxpy.Minimize(bound), [*held, cvxpy.abs(beside @ variable) <= bound]), variable)


def _quietest(system: FloatArray, peak: int, guard: float, limit: float) -> FloatArray:
    """Of all templates with sidelobes up to `limit`, the one that lets the least noise through."""
    cvxpy = need("cvxpy")
    beside = system[np.abs(np.arange(len(system)) - peak) > guard]
    variable = cvxpy.Variable(system.shape[1])
    held = [system[peak] @ variable == 1, cvxpy.abs(beside @ variable) <= limit]
    return _optimum(cvxpy.Problem(cvxpy.Minimize(cvxpy.norm(variable)), held), variable)


def _optimum(problem: Any, variable: Any) -> FloatArray:
    cvxpy = need("cvxpy")
    problem.solve(solver=cvxpy.CLARABEL)
    if problem.status not in ("optimal", "optimal_inaccurate"):
        raise AnnulusError(
            f"no such template exists (the solver says {problem.status}): take more taps or a lower gain"
        )
    return np.asarray(variable.value)


def _places(rows: int, per_chip: int) -> list[int]:
    """Where the peak may stand: near the middle. Behind a transducer each try takes seconds, and three are enough."""
    reach, step = (PEAKS, 1) if per_chip == 1 else (per_chip, per_chip)
    middle = (rows - 1) // 2
    return [p for p in range(middle - reach, middle + reach + 1, step) if 0 <= p < rows]


def _psr(output: FloatArray, peak: int, guard: float) -> float:
    beside = np.abs(output[np.abs(np.arange(len(output)) - peak) > guard])
    highest = float(beside.max()) if len(beside) else 0.0
    return float(abs(output[peak]) / highest) if highest > 0 else math.inf


def _resampled(transducer: Transducer, rate_hz: float) -> FloatArray:
    """At another rate, band-limited; slower rates lose what lies above them."""
    ratio = rate_hz / transducer.sampling_rate_hz
    if abs(ratio - 1) < 1e-9:
        return np.asarray(transducer.response, float)
    return np.asarray(signal.resample(transducer.response, max(round(len(transducer.response) * ratio), 3)))
