"""Angle by angle along a pipe's joint with a near-field probe (Alzuhiri 2022, ch. 9.6), point by point onto the disk.

The controller's turntable turns the pipe, a linear stage carries the probe along it, always forwards while it measures
so that the screw's play is on one side, and the probe is read once all stands. Every point is in the log
(`record.raster_log`) before the next; whatever ends the run, `resume` goes on with the points that are missing. The
raster (.npz) is written when all are there.
"""

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from annulus_pipe.link.client import Client
from annulus_pipe.link.operate import move_turntable, require_no_fault
from annulus_pipe.numeric.arrays import FloatArray, IntArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.probe import Probe, ProbeLostError
from annulus_pipe.wings.joints.raster_file import SAMPLES_MAX, SIDE_MAX
from annulus_pipe.wings.joints.raster_log import RasterLog, write_raster

RETRIES = 2  # of one reading
BACK_MM = 1.0  # before the first place of a line, so that play is on one side
TOLD_EVERY = 10  # points


class LinearAxis(Protocol):
    """What carries the probe along the pipe."""

    def position(self) -> float: ...

    def move(self, to_mm: float) -> None: ...


@dataclass(frozen=True, slots=True)
class RasterPlan:
    """What is to be scanned. Kept in the log; `resume` insists on it."""

    angles: int = 100
    first_mm: float = 0.0  # of the stage
    last_mm: float = 40.0
    step_mm: float = 0.5
    averages: int = 4
    settle_ms: float = 20.0
    steps_per_turn: int = 400
    step_us: float = 1000.0

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("first_mm", self.first_mm, -1e4, 1e4),
            ("last_mm", self.last_mm, -1e4, 1e4),
            ("step_mm", self.step_mm, 1e-3, 100.0),
            ("settle_ms", self.settle_ms, 0.0, 1e4),
        ):
            if not (math.isfinite(value) and low <= value <= high):
                raise AnnulusError(f"{name} is {value:g}, expected {low:g}..{high:g}")
        if not 3 <= self.angles <= self.steps_per_turn:
            raise AnnulusError(f"{self.angles} angles: expected 3..{self.steps_per_turn}, the steps of a turn")
        if self.last_mm - self.first_mm < self.step_mm:
            raise AnnulusError(
                f"from {self.first_mm:g} to {self.last_mm:g} mm in steps of {self.step_mm:g} mm: expected two or more"
            )
        if max(len(self.z_mm), self.angles) > SIDE_MAX or len(self.z_mm) * self.angles > SAMPLES_MAX:
            raise AnnulusError(f"{self.angles} x {len(self.z_mm)} points: expected {SAMPLES_MAX} at most")

    @property
    def z_mm(self) -> FloatArray:
        """(Z,) places of the stage."""
        count = math.floor((self.last_mm - self.first_mm) / self.step_mm + 1.001)
        return np.asarray(self.first_mm + self.step_mm * np.arange(count))

    @property
    def steps(self) -> IntArray:
        """(angles,) where the turntable stands."""
        return np.round(np.arange(self.angles) * (self.steps_per_turn / self.angles)).astype(np.int64)

    @property
    def angle_deg(self) -> FloatArray:
        return np.asarray(self.steps * (360.0 / self.steps_per_turn))


@dataclass(frozen=True, slots=True)
class Scanned:
    """What happened, for a person or a program."""

    points: int
    measured: int  # in this run
    retries: int
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def log_of(out: Path) -> Path:
    """Where the points of a raster are kept."""
    return out.with_name(out.name + ".points.csv")


def scan(
    port: str,
    stage: LinearAxis,
    probe: Probe,
    plan: RasterPlan,
    out: Path,
    *,
    resume: bool = False,
    homed: bool = False,
    say: Callable[[str], None] = lambda line: None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Scanned:
    """Measures the points that the log of `out` does not have yet, then writes `out`.

    resume : go on with the log where there is one. homed : turntable and stage were put back to where they began;
    needed if the controller restarted in between, for it counts its steps from there.

    AnnulusError for whatever ends the scan early: a latched fault, a turntable or a stage that does not arrive, a probe
    that stays lost after RETRIES. What was measured until then is in the log.
    """
    begun = time.monotonic()
    if out.suffix != ".npz":
        raise AnnulusError(f"{out}: expected a name ending in .npz")
    if out.exists():
        raise AnnulusError(f"{out}: is there already, expected a new name")
    with Client(port) as client:
        require_no_fault(client, port)
        log = _log(plan, out, probe, client.identity.boot, resume=resume, homed=homed)
        measured = retries = 0
        try:
            total = plan.angles * len(plan.z_mm)
            for i, step in enumerate(plan.steps):
                missing = [j for j in range(len(plan.z_mm)) if (i, j) not in log.points]
                if not missing:
                    continue
                move_turntable(client, port, int(step), plan.step_us, hold=True)
                stage.move(float(plan.z_mm[missing[0]]) - BACK_MM)
                for j in missing:
                    if progress and len(log.points) % TOLD_EVERY == 0:
                        progress("points", len(log.points), total)
                    stage.move(float(plan.z_mm[j]))
                    client.poll(0.0)  # the controller hears that its host is there
                    time.sleep(1e-3 * plan.settle_ms)
                    values, again = _read(probe, plan.averages, say, f"angle {i}, z {plan.z_mm[j]:g} mm")
                    log.add(i, j, values)
                    measured, retries = measured + 1, retries + again
            move_turntable(client, port, 0, plan.step_us, hold=False)
        except AnnulusError as error:
            raise AnnulusError(
                f"{error} ({len(log.points)} of {total} points are in {log.path}, which can be resumed)"
            ) from None
        finally:
            log.close()
    if progress:
        progress("points", total, total)
    write_raster(out, log, plan.angle_deg, plan.z_mm)
    return Scanned(total, measured, retries, time.monotonic() - begun)


def _log(plan: RasterPlan, out: Path, probe: Probe, boot: int, *, resume: bool, homed: bool) -> RasterLog:
    path = log_of(out)
    wanted = asdict(plan)
    if not (resume and path.exists()):
        return RasterLog(path, {**wanted, "boot": boot}, probe.channels)
    log = RasterLog.resumed(path)
    for key, want in wanted.items():
        have = log.plan.get(key)
        if isinstance(have, bool) or not isinstance(have, int | float) or not math.isclose(have, want, rel_tol=1e-9):
            raise AnnulusError(f"{path}: was scanned with {key} = {have}, now {want:g}: resume with the same settings")
    if log.channels != probe.channels:
        raise AnnulusError(f"{path}: has {', '.join(log.channels)}, now {', '.join(probe.channels)}")
    outside = [place for place in log.points if not (0 <= place[0] < plan.angles and 0 <= place[1] < len(plan.z_mm))]
    if outside:
        raise AnnulusError(f"{path}: has a point {outside[0]}, expected indices of {plan.angles} x {len(plan.z_mm)}")
    if log.plan.get("boot") != boot and not homed:
        raise AnnulusError(
            f"{path}: the controller restarted since and counts its steps anew: put turntable and stage back to where "
            "they began and say that they are homed"
        )
    return log


def _read(probe: Probe, averages: int, say: Callable[[str], None], where: str) -> tuple[dict[str, float], int]:
    """Mean of the readings, and how many were made again."""
    again = 0
    rows: list[dict[str, float]] = []
    while len(rows) < averages:
        try:
            rows.append(probe.read())
        except ProbeLostError as error:
            if again == RETRIES:
                raise AnnulusError(f"{error} ({RETRIES + 1} times at {where})") from None
            again += 1
            say(f"{where}: {error}; read again")
            try:
                probe.recover()
            except ProbeLostError:
                time.sleep(0.2)
    return {name: float(np.mean([row[name] for row in rows])) for name in probe.channels}, again
