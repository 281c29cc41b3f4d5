"""Cross bores while the head moves: what its capacitive sectors read over the last metres, judged once a second.

Lift-off is taken out where workers keep up with the rings' poses; `reprocess` has them all. A place is told when the
head is past it by what it is held against, so that it does not change its name.
"""

from collections.abc import Mapping
from typing import Any

from annulus_pipe.daemon.config import SectorsConfig
from annulus_pipe.daemon.observer import Observer, Observers
from annulus_pipe.daemon.state import State
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wings.crossbore.measure import (
    BORES,
    BoreIndication,
    CapacitiveHead,
    Gap,
    Passage,
    detect,
    likely,
    on_grid,
)
from annulus_pipe.wings.crossbore.measure.detect import BESIDE_MM, MERGED_MM
from annulus_pipe.wings.crossbore.recorded import take, take_pose

KEEP_MM = 8000.0  # 53 s at 150 mm/s: some milliseconds a look
STEP_MM = 100.0  # the head has moved so far since the last look, or there is none
PAST_MM = BESIDE_MM[1] + 100.0


class Bores(Observer):
    """Tells `observers` an event of kind "bore" for each place, once, and listens among them itself."""

    def __init__(self, sectors: SectorsConfig, observers: Observers) -> None:
        self._sectors, self._observers = sectors, observers
        observers.all.append(self)
        self._state = State.OFF
        self._head = CapacitiveHead(air_ff=1000 * sectors.air_pf, coupling_ff=sectors.coupling_ff)
        self._begin()

    def _begin(self) -> None:
        self._passage = Passage(self._sectors.ahead_mm, KEEP_MM)
        self._announced: list[BoreIndication] = []
        self._gaps: list[Gap] = []
        self._here_mm = self._looked_mm = float("nan")
        self._reads = self._broke = False

    def state(self, state: State, why: str) -> None:
        if state is State.ARMED and self._state is not State.FAULT:
            self._begin()
        self._state = state

    def telemetry(self, numbers: Mapping[str, Any]) -> None:
        self.look()

    def sample(self, sample: Sample) -> None:
        before = self._here_mm
        self._reads |= take(self._passage, sample)
        if sample.sensor == "odometer":
            self._here_mm = sample.values.get("z_mm", before)

    def profile(self, profile: Profile) -> None:
        take_pose(self._passage, profile, self._sectors.ahead_mm)

    def ending(self) -> None:
        self.look(final=True)

    def look(self, final: bool = False) -> list[BoreIndication]:
        """Places that were not reported before. final : the scan is over: those ahead, too."""
        if not self._reads or (not final and abs(self._here_mm - self._looked_mm) < STEP_MM):
            return []
        self._looked_mm = self._here_mm
        new: list[BoreIndication] = []
        found, gaps = self._found()
        for gap in gaps:
            behind = abs(self._here_mm + self._sectors.ahead_mm - gap.to_mm) >= PAST_MM
            known = any(old.from_mm - MERGED_MM < gap.to_mm < old.to_mm + MERGED_MM for old in self._gaps)
            if (behind or final) and not known:
                self._gaps.append(gap)
                self._observers.event("bore", f"no bore can be told: no readings of {gap}")
        for one in found:
            past = abs(self._here_mm + self._sectors.ahead_mm - one.odometer_mm) >= PAST_MM
            known = any(abs(old.odometer_mm - one.odometer_mm) < MERGED_MM for old in (*self._announced, *new))
            if (past or final) and not known:
                new.append(one)
                self._observers.event("bore", in_words(one))
        self._announced += new
        return new

    def _found(self) -> tuple[list[BoreIndication], list[Gap]]:
        """The places in all readings kept. An error here costs bores, never the scan, and is reported once."""
        try:
            accounts = [detect(on_grid(run.log, self._head), self._head) for run in self._passage.runs()]
            return [one for each in accounts for one in each.bores], [gap for each in accounts for gap in each.gaps]
        except Exception as error:
            if not self._broke:
                self._broke = True
                why = str(error) if isinstance(error, AnnulusError) else f"{type(error).__name__}: {error}"
                self._observers.event("bore", f"cross bores cannot be told: {why}")
            return [], []


def in_words(one: BoreIndication) -> str:
    """For people: "cross bore, air, at 12.340 m, 210 mm long, 97 %"."""
    assert one.kind in BORES
    sure = f"{100 * likely(one):.0f} % in simulated pipes" if one.odds else "the head wanders: no odds"
    return f"cross bore, {one.kind}, at {one.odometer_mm / 1000:.3f} m, {one.extent_mm:.0f} mm long, {sure}"
