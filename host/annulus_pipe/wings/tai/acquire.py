"""A sweep: burst and record at every angle of a turn of the turntable, shot by shot onto the disk.

The file is a whole sweep of the angles shot so far from the first shot on, replaced after each one: whatever ends the
run, what was shot is there, `annulus tai image` shows it, and `resume` goes on with the angles that are missing.
"""

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.link.client import Client
from annulus_pipe.link.codes import pattern, text, train_from_us
from annulus_pipe.link.operate import move_turntable, require_no_fault, send_train, status_of, train_messages
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, load_acoustic, save_acoustic
from annulus_pipe.wings.tai.decode import detected_code
from annulus_pipe.wings.tai.digitizer import Acquisition, Digitizer, DigitizerLostError, Trace, TriggerLostError
from annulus_pipe.wings.tai.measure.imaging import TAIL

# Guards: tests/wings/tai/test_acquire.py, by the tests named.
RETRIES = 2  # of one shot, after a lost trigger, a digitizer that went away, or a record with holes
SAMPLES_A_CHIP = 4  # test_the_command_wants_one_bench_and_sane_settings
STALLED = 1.5  # times the noise's power: neighbours that differ by less may have been heard from one place
RUN = 3  # neighbours in a row; a pair may stand to both sides of an axis of symmetry. test_a_stage_that_moves ..
AUDIBLE = 100.0  # times the noise's power is sound that can tell. test_without_one_the_sound_tells
ENCODER_S = 0.005  # until the last edge has been counted. test_an_encoder_tells_of_a_stage_that_did_not_move


@dataclass(frozen=True, slots=True)
class SweepPlan:
    """What is to be shot. Kept in the file; `resume` insists on it."""

    code: str = "mpsl25-stuffed"
    chip_us: float = 0.5
    positions: int = 50
    averages: int = 16
    period_us: float = 1000.0
    trigger_offset_us: float = 0.0
    radius_mm: float = 25.0
    sound_speed_m_s: float = 1480.0
    rate_mhz: float = 10.0  # at least
    duration_us: float | None = None  # from chip 0; None: until sound has crossed the circle
    range_v: float = 0.08
    steps_per_turn: int = 400
    step_us: float = 1000.0
    encoder_per_turn: int = 0  # counts of an encoder on the turntable, at the controller's odometer; 0: there is none

    def __post_init__(self) -> None:
        if not 1 <= self.positions <= self.steps_per_turn:
            raise AnnulusError(f"{self.positions} angles: expected 1..{self.steps_per_turn}, the steps of a turn")
        if self.rate_mhz * self.chip_us < SAMPLES_A_CHIP:
            raise AnnulusError(
                f"a sampling rate of {self.rate_mhz:g} MHz: expected {SAMPLES_A_CHIP / self.chip_us:g} or more, "
                f"{SAMPLES_A_CHIP} samples a chip"
            )

    @property
    def steps(self) -> NDArray[np.int64]:
        """(positions,) where the turntable stands."""
        return np.round(np.arange(self.positions) * (self.steps_per_turn / self.positions)).astype(np.int64)

    @property
    def angles_deg(self) -> NDArray[np.float64]:
        return np.asarray(self.steps * (360.0 / self.steps_per_turn), np.float64)

    @property
    def acquisition(self) -> Acquisition:
        sent_us = len(pattern(self.code)) * self.chip_us
        across_us = 2e3 * self.radius_mm / self.sound_speed_m_s
        lasting = TAIL * across_us + sent_us if self.duration_us is None else self.duration_us
        return Acquisition(
            1e6 * self.rate_mhz, 1e-6 * lasting, self.range_v, self.averages, -1e-6 * self.trigger_offset_us
        )

    def settings(self) -> dict[str, str | float]:
        return {key: value for key, value in asdict(self).items() if value is not None}


@dataclass(frozen=True, slots=True)
class Acquired:
    """What happened, for a person or a program."""

    positions: int
    shot: int  # in this run
    retries: int
    clipped: tuple[int, ...]
    findings: tuple[str, ...]
    sampling_rate_hz: float
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def acquire(
    port: str,
    digitizer: Digitizer,
    plan: SweepPlan,
    out: Path,
    *,
    resume: bool = False,
    homed: bool = False,
    say: Callable[[str], None] = lambda line: None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Acquired:
    """Shoots the angles that `out` does not have yet. Every shot is armed by itself, and disarmed whatever happens.

    resume : go on with `out` where it exists. homed : the turntable was put back to its first angle by hand since;
    needed if the controller restarted in between, for it counts its steps from there.

    Raises AnnulusError for whatever ends the sweep early: a fault or an open interlock, a refused setting, a digitizer
    or triggers that stay lost after RETRIES. What was shot until then is in `out`.
    """
    begun = time.monotonic()
    train = train_from_us(
        plan.code,
        chip_us=plan.chip_us,
        repeat=plan.averages,
        period_us=plan.period_us,
        trigger_offset_us=plan.trigger_offset_us,
    )
    train.check()
    own, burst = train_messages(plan.code, train)
    if out.suffix not in (".h5", ".hdf5", ".npz"):
        raise AnnulusError(f"{out}: expected a name ending in .hdf5, .h5 (IPASC) or .npz")
    if out.exists() and not resume:
        raise AnnulusError(f"{out}: is there already, expected a new name, or to be told to resume it")
    with Client(port) as client:
        require_no_fault(client, port)
        sweep = _Sweep(plan, out, client.identity.boot)
        if out.exists():
            sweep.go_on(homed)
        if own is not None:
            client.request(own)
        digitizer.configure(plan.acquisition)
        missing = [i for i in range(plan.positions) if i not in sweep.traces]
        retries = 0
        for done, position in enumerate(missing):
            if progress:
                progress("shots", plan.positions - len(missing) + done, plan.positions)
            step = int(plan.steps[position])
            _turn(client, port, plan, step)
            for attempt in range(RETRIES + 1):
                try:
                    digitizer.arm()
                    send_train(client, port, burst)
                    trace = digitizer.read()
                    if np.isfinite(trace.volts).all() or attempt == RETRIES:
                        break
                    say(f"angle {position}: the record has holes, shot again")
                except (TriggerLostError, DigitizerLostError) as error:
                    if attempt == RETRIES:
                        raise AnnulusError(
                            f"{error} ({RETRIES + 1} times at angle {position}; {len(sweep.traces)} of "
                            f"{plan.positions} angles are in {out}, which can be resumed)"
                        ) from None
                    say(f"angle {position}: {error}; shot again")
                    _keep_trying(digitizer)
                retries += 1
            sweep.add(position, trace)
            if trace.clipped:
                say(f"angle {position}: {trace.clipped} samples clipped, a larger range of the digitizer takes them in")
        move_turntable(client, port, 0, plan.step_us, hold=False)
    if progress:
        progress("shots", plan.positions, plan.positions)
    record = sweep.record()
    return Acquired(
        plan.positions,
        len(missing),
        retries,
        sweep.clipped,
        tuple(sweep.findings()),
        record.sampling_rate_hz,
        time.monotonic() - begun,
    )


def _turn(client: Client, port: str, plan: SweepPlan, step: int) -> None:
    """The turntable to a step, believed only as far as an encoder confirms it. AnnulusError where one does not."""
    before = status_of(client)
    move_turntable(client, port, step, plan.step_us, hold=True)
    if not plan.encoder_per_turn or before.turntable == step:
        return
    time.sleep(ENCODER_S)
    counted = status_of(client).odometer - before.odometer
    expected = (step - before.turntable) * plan.encoder_per_turn / plan.steps_per_turn
    if abs(counted - expected) > max(2.0, 0.1 * abs(expected)):
        raise AnnulusError(
            f"{port}: the turntable did not move as told: its encoder counted {counted}, expected {expected:.0f} for "
            f"{step - before.turntable} steps"
        )


class _Sweep:
    """The traces so far, and their file."""

    def __init__(self, plan: SweepPlan, out: Path, boot: int) -> None:
        self.plan, self.out, self.boot = plan, out, boot
        self.traces: dict[int, NDArray[np.float32]] = {}
        self._clipped: dict[int, int] = {}  # how many samples, by position
        self._rate_hz = self._t0_s = math.nan

    @property
    def clipped(self) -> tuple[int, ...]:
        return tuple(sorted(self._clipped))

    def go_on(self, homed: bool) -> None:
        """Take over what the file has. AnnulusError where it was shot otherwise."""
        record = load_acoustic(self.out)
        extra = record.extra
        if "plan_positions" not in extra:
            raise AnnulusError(f"{self.out}: is no sweep of `annulus tai acquire`, expected one to go on with")
        for key, want in self.plan.settings().items():
            have = extra.get(f"plan_{key}")
            same = (
                have == want
                if isinstance(want, str) or isinstance(have, str) or have is None
                else (math.isclose(have, want, rel_tol=1e-9))
            )
            if not same:
                raise AnnulusError(
                    f"{self.out}: was shot with {key} = {have}, now {want}: resume with the same settings"
                )
        if int(extra["boot"]) != self.boot and not homed:
            raise AnnulusError(
                f"{self.out}: the controller restarted since and counts its steps anew: turn the turntable back "
                "to its first angle and say that it is homed"
            )
        index = {round(float(angle), 6): i for i, angle in enumerate(self.plan.angles_deg)}
        for angle, signal in zip(record.angles_deg, record.signals, strict=True):
            i = index.get(round(float(angle), 6))
            if i is None:
                raise AnnulusError(f"{self.out}: has an angle of {angle:g} deg that is not of this sweep")
            self.traces[i] = signal
        rows = [int(row) for row in str(extra.get("clipped", "")).split(",") if row.isdigit()]
        self._clipped = {i: 1 for row, i in enumerate(sorted(self.traces)) if row in rows}
        self._rate_hz, self._t0_s = record.sampling_rate_hz, record.t0_s

    def add(self, position: int, trace: Trace) -> None:
        """Keep a trace, on disk when this returns."""
        t0_s = trace.t0_s + 1e-6 * self.plan.trigger_offset_us
        if self.traces:
            samples = len(next(iter(self.traces.values())))
            if (
                len(trace.volts) != samples
                or not math.isclose(trace.rate_hz, self._rate_hz, rel_tol=1e-6)
                or abs(t0_s - self._t0_s) > 0.01 / self._rate_hz
            ):
                raise AnnulusError(
                    f"{self.out}: angle {position} has {len(trace.volts)} samples at {trace.rate_hz / 1e6:g} MHz, "
                    f"expected {samples} at {self._rate_hz / 1e6:g} MHz as the others: was the digitizer touched?"
                )
        elif trace.rate_hz * self.plan.chip_us * 1e-6 < 0.99 * SAMPLES_A_CHIP:
            raise AnnulusError(
                f"the digitizer samples at {trace.rate_hz / 1e6:.3g} MHz, expected {SAMPLES_A_CHIP} samples a chip: "
                "a shorter record, or a single burst an angle, takes off the scope's limit of 1000 points"
            )
        else:
            self._rate_hz, self._t0_s = trace.rate_hz, t0_s
        self.traces[position] = trace.volts
        if trace.clipped:
            self._clipped[position] = trace.clipped
        save_acoustic(self.out, self.record())

    def record(self) -> AcousticRecord:
        plan, order = self.plan, sorted(self.traces)
        extra: dict[str, str | float] = {f"plan_{key}": value for key, value in plan.settings().items()}
        extra |= {"source": "annulus tai acquire", "unit": "V", "boot": float(self.boot)}
        if self._clipped:
            extra["clipped"] = ",".join(str(row) for row, i in enumerate(order) if i in self._clipped)
        return AcousticRecord(
            np.stack([self.traces[i] for i in order]),
            plan.angles_deg[order],
            plan.radius_mm,
            self._rate_hz,
            self._t0_s,
            plan.sound_speed_m_s,
            text(pattern(plan.code)),
            1e-6 * plan.chip_us,
            plan.averages,
            extra,
        )

    def findings(self) -> list[str]:
        """What is wrong with the sweep as a whole, one line each."""
        record = self.record()
        found = []
        bad = np.asarray(~np.isfinite(record.signals).all(axis=1), np.bool_)
        if bad.any():
            found.append(f"{np.count_nonzero(bad)} traces have holes: {_named(self.traces, bad)}")
        if self._clipped:
            found.append(f"{len(self._clipped)} traces are clipped: {', '.join(map(str, self.clipped[:8]))}")
        other = detected_code(record)
        if other is not None:
            found.append(f"{self.plan.code} was asked for, but it sounds like {other}")
        return found + stalled(record)


def stalled(record: AcousticRecord) -> list[str]:
    """Neighbours that differ by no more than noise: the turntable did not turn, or nothing of the sample turns with it.

    The noise is what a trace holds in the upper two fifths of its band, where a transducer leaves nothing of sound.
    """
    kept = np.flatnonzero(np.isfinite(record.signals).all(axis=1))
    if len(kept) < 2:
        return []
    signals = record.signals[kept].astype(float)
    signals = signals - signals.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(signals, axis=1)) ** 2
    low = slice(1, max(2, int(0.3 * power.shape[1])))
    noise = float(np.median(power[:, int(0.6 * power.shape[1]) :])) / math.log(2)  # its median is ln 2 of its mean
    differ = np.abs(np.fft.rfft(np.diff(signals, axis=0), axis=1)) ** 2
    if np.median(power[:, low].mean(axis=1)) < AUDIBLE * noise:
        return []
    same = differ[:, low].mean(axis=1) <= STALLED * 2 * noise
    if same.all():
        return [
            "every angle sounds the same: the turntable does not turn, or the sample is round and stands in its middle"
        ]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    runs = [(a, b) for a, b in edges.reshape(-1, 2) if b - a >= RUN]
    return [
        f"angles {kept[a]} to {kept[b]} sound the same to the noise: the turntable may not have moved" for a, b in runs
    ]


def _keep_trying(digitizer: Digitizer) -> None:
    """Bring it back if that is possible now; if not, the next attempt says so."""
    try:
        digitizer.recover()
    except DigitizerLostError:
        time.sleep(0.2)


def _named(traces: dict[int, NDArray[np.float32]], bad: NDArray[np.bool_]) -> str:
    return ", ".join(str(i) for i, is_bad in zip(sorted(traces), bad, strict=True) if is_bad)
