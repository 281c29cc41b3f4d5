"""Promises of a sweep: shot by shot onto the disk, resumable, armed anew each time, whatever goes wrong."""

import functools
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.controller import CODES
from annulus_pipe.link import operate
from annulus_pipe.link.client import Client
from annulus_pipe.link.codes import Train
from annulus_pipe.link.messages import FaultCode
from annulus_pipe.twin.native import NativeBoard
from annulus_pipe.twin.real_time import serving
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, load_acoustic, save_acoustic
from annulus_pipe.wings.tai.acquire import Acquired, SweepPlan, acquire, stalled
from annulus_pipe.wings.tai.decode import sweep_of
from annulus_pipe.wings.tai.digitizer import ScopeDigitizer
from annulus_pipe.wings.tai.measure.phantoms import Disc
from annulus_pipe.wings.tai.measure.sweep import examine
from annulus_pipe.wings.tai.simulated.phantom import RigSetup
from annulus_pipe.wings.tai.simulated.receiver import Receiver
from annulus_pipe.wings.tai.simulated.rig import AcousticRig
from annulus_pipe.wings.tai.simulated.scope import SimulatedScope

SAMPLE = (Disc(0.0, 0.0, 5.0, 0.4), Disc(2.0, 1.0, 1.0, 1.0), Disc(-3.0, 2.0, 0.7, 0.8))
PLAN = SweepPlan(
    positions=5, averages=2, radius_mm=9.0, range_v=0.08, steps_per_turn=40, step_us=100.0, period_us=500.0
)


@functools.cache
def receiver() -> Receiver:
    return Receiver(RigSetup(SAMPLE, 9.0, transducer=(0.6e6, 1.2), pulse_v=0.05, noise_v=2e-4, steps_per_turn=40))


@pytest.fixture
def board() -> NativeBoard:
    try:
        return NativeBoard()
    except AnnulusError as error:
        pytest.skip(str(error))


class Rig:
    """The bench in real time, and acquisitions on it."""

    def __init__(self, bench: AcousticRig, out: Path) -> None:
        self.bench, self.out = bench, out
        self.said: list[str] = []

    def acquire(self, plan: SweepPlan = PLAN, stop_before: int | None = None, **how) -> Acquired:
        def progress(_: str, done: int, total: int) -> None:
            if done == stop_before and done < total:
                raise KeyboardInterrupt

        with ScopeDigitizer(self.bench.scope_name, settle_s=0.003, answer_s=0.15) as scope:
            return acquire(self.bench.port_url, scope, plan, self.out, say=self.said.append, progress=progress, **how)

    @property
    def armed(self) -> bool:
        return "armed" in str(operate.status(self.bench.port_url)["state"])


@pytest.fixture
def rig(board: NativeBoard, tmp_path: Path, request: pytest.FixtureRequest):
    how = getattr(request, "param", {})
    heard = receiver()
    if "stuck_after" in how:
        heard = Receiver.__new__(Receiver)
        heard.__dict__.update(receiver().__dict__)
        heard.setup = replace(receiver().setup, stuck_after=how["stuck_after"])
    bench = AcousticRig(board, heard, SimulatedScope(how.get("faults", {})))
    with serving(bench):
        yield Rig(bench, tmp_path / "raw.hdf5")


def test_a_sweep_is_what_the_receiver_heard_at_each_angle(rig: Rig) -> None:
    done = rig.acquire()
    assert (done.positions, done.shot, done.retries, done.clipped, done.findings) == (5, 5, 0, (), ())
    assert rig.bench.bursts == rig.bench.scope.triggers_seen == 10
    assert rig.bench.steps == 0 and not rig.armed  # back at the first angle, dark
    record = load_acoustic(rig.out)
    assert record.code == CODES["mpsl25-stuffed"] and record.chip_s == 0.5e-6 and record.averages == 2
    assert record.angles_deg.tolist() == [0.0, 72.0, 144.0, 216.0, 288.0]
    chips = np.flatnonzero([int(c) for c in record.code]).tolist()
    pulses = tuple((50 * i, 50 * i + 50) for i in chips)
    rate, samples = record.sampling_rate_hz, record.signals.shape[1]
    expected = np.stack([receiver().hear(pulses, 8 * i, record.t0_s, rate, samples) for i in range(5)])
    assert (record.signals - expected).std() < 1.3 * np.hypot(2e-4, 0.08 / 256 / 12**0.5) / 2**0.5


def test_the_trigger_may_come_before_or_after_the_burst(rig: Rig) -> None:
    early = replace(PLAN, positions=1, trigger_offset_us=-10.0)
    rig.acquire(early)
    first = load_acoustic(rig.out)
    rig.out.unlink()
    rig.acquire(replace(early, trigger_offset_us=7.5))
    second = load_acoustic(rig.out)
    assert first.t0_s == pytest.approx(0.0, abs=1e-12) and second.t0_s == pytest.approx(0.0, abs=1e-12)
    assert np.abs(first.signals - second.signals).std() < 4e-4 < 0.2 * first.signals.std()


def test_an_interrupted_sweep_goes_on_where_it_was(rig: Rig) -> None:
    with pytest.raises(KeyboardInterrupt):
        rig.acquire(stop_before=3)
    assert not rig.armed
    kept = load_acoustic(rig.out)
    assert kept.angles_deg.tolist() == [0.0, 72.0, 144.0]
    with pytest.raises(AnnulusError, match=r"raw\.hdf5: is there already"):
        rig.acquire()
    with pytest.raises(AnnulusError, match=r"was shot with averages = 2\.0, now 8: resume with the same settings"):
        rig.acquire(replace(PLAN, averages=8), resume=True)
    assert rig.bench.bursts == 6
    done = rig.acquire(resume=True)
    assert done.shot == 2 and rig.bench.bursts == 10
    whole = load_acoustic(rig.out)
    assert len(whole.signals) == 5 and np.array_equal(whole.signals[:3], kept.signals)
    assert rig.acquire(resume=True).shot == 0 and rig.bench.bursts == 10


def test_a_controller_that_restarted_has_lost_its_stage(rig: Rig) -> None:
    with pytest.raises(KeyboardInterrupt):
        rig.acquire(stop_before=2)
    record = load_acoustic(rig.out)
    save_acoustic(rig.out, replace(record, extra={**record.extra, "boot": 200.0}))
    with pytest.raises(AnnulusError, match=r"restarted since .* that it is homed"):
        rig.acquire(resume=True)
    assert rig.acquire(resume=True, homed=True).shot == 3


def test_an_open_interlock_ends_it_and_nothing_fires_until_it_is_cleared(rig: Rig) -> None:
    shots: list[int] = []

    def open_at_two(_: str, done: int, total: int) -> None:
        shots.append(done)
        if done == 2:
            rig.bench.interlock(closed=False)

    with (
        ScopeDigitizer(rig.bench.scope_name, settle_s=0.003, answer_s=0.15) as scope,
        pytest.raises(AnnulusError, match=r"interlock|unsafe"),
    ):
        acquire(rig.bench.port_url, scope, PLAN, rig.out, progress=open_at_two)
    bursts = rig.bench.bursts
    assert 4 <= bursts <= 6 and not rig.armed
    assert len(load_acoustic(rig.out).signals) == 2
    with pytest.raises(AnnulusError, match=r"interlock"):
        rig.acquire(resume=True)
    rig.bench.interlock(closed=True)
    assert rig.bench.bursts == bursts
    operate.clear(rig.bench.port_url)
    assert rig.acquire(resume=True).shot == 3 and rig.bench.bursts >= bursts + 6


@pytest.mark.parametrize(
    "rig", [{"faults": {1: "deaf", 3: "drop", 4: "hole"}}, {"faults": {0: "hang", 2: "nonsense"}}], indirect=True
)
def test_what_passes_is_shot_again_and_counted(rig: Rig) -> None:
    faults = len(rig.bench.scope.faults)
    done = rig.acquire()
    assert done.retries == faults == len(rig.said)
    assert rig.bench.bursts == 2 * (5 + faults)
    assert np.isfinite(load_acoustic(rig.out).signals).all()


@pytest.mark.parametrize("rig", [{"faults": {1: "deaf", 2: "deaf", 3: "deaf"}}], indirect=True)
def test_triggers_that_stay_lost_end_it_with_what_there_is(rig: Rig) -> None:
    with pytest.raises(AnnulusError, match=r"waits for a trigger .*3 times at angle 1; 1 of 5 angles are in"):
        rig.acquire()
    assert not rig.armed and len(load_acoustic(rig.out).signals) == 1
    assert rig.acquire(resume=True).shot == 4


def test_a_scope_that_is_gone_for_good_ends_it_with_what_there_is(rig: Rig) -> None:
    def pull(_: str, done: int, total: int) -> None:
        if done == 2:
            rig.bench.scope.faults = {2: "drop"}
            rig.bench.unplug_scope()

    with (
        ScopeDigitizer(rig.bench.scope_name, settle_s=0.003, answer_s=0.15) as scope,
        pytest.raises(AnnulusError, match=r"gone, expected the digitizer \(3 times at angle 2; 2 of 5 angles are in"),
    ):
        acquire(rig.bench.port_url, scope, PLAN, rig.out, progress=pull)
    assert not rig.armed and len(load_acoustic(rig.out).signals) == 2


@pytest.mark.parametrize("rig", [{"faults": {2: "clip"}}], indirect=True)
def test_clipped_traces_are_named(rig: Rig) -> None:
    done = rig.acquire()
    assert done.clipped == (2,) and "angle 2" in rig.said[0] and "clipped: 2" in done.findings[0]
    record = load_acoustic(rig.out)
    assert record.extra["clipped"] == "2"
    assert [(fault.kind, fault.positions) for fault in examine(sweep_of(record)) if fault.kind == "clipped"] == [
        ("clipped", (2,))
    ]


@pytest.mark.parametrize("rig", [{"stuck_after": 20}], indirect=True)
def test_an_encoder_tells_of_a_stage_that_did_not_move(rig: Rig) -> None:
    with pytest.raises(AnnulusError, match=r"its encoder counted 4, expected 8 for 8 steps"):
        rig.acquire(replace(PLAN, encoder_per_turn=40))
    assert len(load_acoustic(rig.out).signals) == 3


@pytest.mark.parametrize("rig", [{"stuck_after": 4}], indirect=True)
def test_without_one_the_sound_tells(rig: Rig) -> None:
    done = rig.acquire(replace(PLAN, positions=8, averages=8))
    assert any("sound the same" in finding for finding in done.findings)


def test_a_stage_that_moves_is_not_accused() -> None:
    rng = np.random.default_rng(5)
    clean = np.stack([receiver().hear(((0, 50),), i, 0.0, 10e6, 400) for i in range(40)])

    def record(signals: np.ndarray) -> AcousticRecord:
        noisy = signals + 1e-5 * rng.standard_normal(signals.shape)
        return AcousticRecord(noisy.astype("f4"), 9.0 * np.arange(len(signals)), 9.0, 10e6)

    assert stalled(record(clean)) == []
    assert "every angle" in stalled(record(np.repeat(clean[:1], 40, axis=0)))[0]
    stuck = clean.copy()
    stuck[10:15] = clean[10]
    assert "angles 10 to 14" in stalled(record(stuck))[0]


def test_another_code_than_was_asked_for_is_heard(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A controller that sends what it was not told: the pins decide what is heard."""

    def wrong(code: str, train: Train):
        return operate.train_messages("barker13", train)

    monkeypatch.setattr("annulus_pipe.wings.tai.acquire.train_messages", wrong)
    done = rig.acquire(replace(PLAN, positions=3, averages=8))
    assert done.findings == ("mpsl25-stuffed was asked for, but it sounds like barker13",)


def test_the_command_wants_one_bench_and_sane_settings(tmp_path: Path) -> None:
    run, raw = CliRunner(), str(tmp_path / "raw.hdf5")
    for bad, says in (
        ([], "--port and --scope"),
        (["--twin", "--port", "x"], "--twin alone"),
        (["--port", "x"], "--port and --scope"),
        (["--twin", "--angles", "50", "--steps-per-turn", "40"], "50 angles: expected 1..40"),
        (["--twin", "--rate-mhz", "1"], "a sampling rate of 1 MHz: expected 8 or more"),
        (["--port", "/dev/null/x", "--scope", "no scope"], "no scope"),
    ):
        answer = run.invoke(app, ["tai", "acquire", *bad, "-o", raw])
        assert isinstance(answer.exception, AnnulusError) and says in str(answer.exception), bad
    assert not Path(raw).exists()


def test_trains_at_the_limit_of_duty_one_after_the_other_never_meet_a_refusal(rig: Rig) -> None:
    """The second one came when the first one's chips were over: refused, and a fault latched."""
    code = "10" * 64
    train = Train(np.array([int(chip) for chip in code]), 3_000, 1, 3_840_000, 0)
    pattern, burst = operate.train_messages(code, train)
    assert pattern is not None
    with Client(rig.bench.port_url) as client:
        client.request(pattern)
        starts = [operate.send_train(client, "bench", burst)[0].start for _ in range(4)]
        assert operate.status_of(client).fault is FaultCode.NONE
    assert min(operate.ticks_between(a, b) for a, b in itertools.pairwise(starts)) >= burst.period


def test_ticks_are_compared_across_their_wrap() -> None:
    assert operate.ticks_between(2**32 - 5, 5) == 10
    assert operate.ticks_between(5, 2**32 - 5) == -10
