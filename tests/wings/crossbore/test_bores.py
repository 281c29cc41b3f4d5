"""A head that passes a sewer says so while it moves, once, and where it is."""

import math

import pytest

from annulus_pipe.daemon.config import SectorsConfig
from annulus_pipe.daemon.observer import Observer, Observers
from annulus_pipe.daemon.state import State
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.wings.crossbore.ground import Bore, Drawn, Ground, log
from annulus_pipe.wings.crossbore.live import PAST_MM, Bores

GROUND = Ground(9000.0, bores=(Bore(3000.0, 101.0), Bore(6000.0, 76.0, 76.0, 200.0), Bore(8300.0, 101.0)))


class Told(Observer):
    def __init__(self) -> None:
        self.texts: list[str] = []

    def event(self, kind: str, text: str) -> None:
        assert kind == "bore"
        self.texts.append(text)


def pulled(bores: Bores, drawn: Drawn, listener: Told) -> list[tuple[float, str]]:
    """The head's place when each was told, and what."""
    rows = drawn.rows()
    said: list[tuple[float, str]] = []
    units = {**dict.fromkeys(("c1_pf", "c2_pf", "c3_pf", "cref_pf"), "pF")}
    for i, t in enumerate(rows.t_s):
        ns, z = round(1e9 * t), float(rows.odometer_mm[i])
        if i % 8 == 0:
            bores.sample(Sample("odometer", ns, {"counts": 0.0, "z_mm": z}, {"counts": "counts", "z_mm": "mm"}))
        bores.sample(Sample("imu", ns, {"roll_deg": float(rows.roll_deg[i])}, {"roll_deg": "deg"}))
        values = {f"c{k + 1}_pf": float(rows.c_pf[i, k]) for k in range(3)} | {"cref_pf": float(rows.reference_pf[i])}
        bores.sample(Sample("capacitance", ns, values, units))
        if i % 40 == 0:
            bores.telemetry({})
            said += [(z, text) for text in listener.texts[len(said) :]]
    return said


def test_each_is_told_once_soon_after_the_head_has_passed_it() -> None:
    listener = Told()
    bores = Bores(SectorsConfig(), observers := Observers([listener]))
    assert bores in observers.all
    bores.state(State.ARMED, "")
    said = pulled(bores, log(GROUND, 2), listener)
    places = [1000 * float(text.split(" at ")[1].split(" m")[0]) for _, text in said]
    assert places == pytest.approx([3006, 6012], abs=25)
    for (here, text), place in zip(said, places, strict=True):
        assert PAST_MM - 50 < here - place < PAST_MM + 400 and "cross bore, air" in text
    bores.look(final=True)  # the head stopped before it was past the third
    assert len(listener.texts) == 3 and "8.3" in listener.texts[2]
    bores.look(final=True)
    assert len(listener.texts) == 3


def test_another_scan_forgets_and_a_fault_does_not() -> None:
    listener = Told()
    bores = Bores(SectorsConfig(), Observers([listener]))
    drawn = log(Ground(6000.0, bores=(Bore(3000.0, 101.0),)), 2)
    pulled(bores, drawn, listener)
    for state in (State.FAULT, State.ARMED):
        bores.state(state, "")
    bores.look(final=True)
    assert len(listener.texts) == 1
    for state in (State.SCANNING, State.IDLE, State.ARMED):
        bores.state(state, "")
    assert bores.look(final=True) == []
    pulled(bores, drawn, listener)
    assert len(listener.texts) == 2


def test_a_head_without_sectors_is_never_looked_at() -> None:
    listener = Told()
    bores = Bores(SectorsConfig(), Observers([listener]))
    bores.sample(Sample("imu", 1, {"roll_deg": math.nan}, {"roll_deg": "deg"}))
    assert bores.look(final=True) == [] and listener.texts == []


def test_what_goes_wrong_costs_bores_and_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("at last")

    monkeypatch.setattr("annulus_pipe.wings.crossbore.live.on_grid", broken)
    listener = Told()
    pulled(Bores(SectorsConfig(), Observers([listener])), log(Ground(6000.0), 2), listener)
    assert listener.texts == ["cross bores cannot be told: ZeroDivisionError: at last"]
