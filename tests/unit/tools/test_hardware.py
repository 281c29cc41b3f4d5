"""The reference circuit keeps its electrical rules, has each pin where messages.toml says, every output dark by itself,
and one-shots that end within the controller's limits whatever their parts' tolerances do.
"""

from pathlib import Path
from typing import Any

import pytest

from annulus_pipe.controller import LAMP_WIDTH_MAX_TICKS, MICROWAVE_PULSE_MAX_TICKS, TICK_HZ
from tools.hardware import __main__ as hardware
from tools.hardware.oneshot import (
    CAPACITOR_LEAST_F,
    LAMP,
    MICROWAVE,
    RESISTOR_LEAST_OHM,
    RESISTOR_MOST_OHM,
    OneShot,
    read,
    shown,
)

SLIDES = ("slide_2", "slide_3", "slide_4")  # lamps as the projector's
DARK = {
    "projector": "gnd",
    **dict.fromkeys(SLIDES, "gnd"),
    "led": "gnd",
    "microwave": "gnd",
    "trigger": "gnd",
    "camera_trigger": "gnd",
    "step": "gnd",
    "direction": "gnd",
}
PULLS = {  # an output off, an input open
    **DARK,
    "enable": "3v3",
    "interlock": "3v3",
    "interlock_antivalent": "gnd",
    "end_low": "3v3",
    "end_high": "3v3",
}
LIMITS = {
    "projector": LAMP_WIDTH_MAX_TICKS / TICK_HZ,
    **dict.fromkeys(SLIDES, LAMP_WIDTH_MAX_TICKS / TICK_HZ),
    "led": LAMP_WIDTH_MAX_TICKS / TICK_HZ,
    "microwave": MICROWAVE_PULSE_MAX_TICKS / TICK_HZ,
}


@pytest.fixture(scope="module")
def circuit() -> Any:
    with hardware.quietly():
        from tools.hardware.circuit import build

        return build(hardware.edge_pins())


def nets(part: Any) -> list[str]:
    return [pin.net.name for pin in part.pins if pin.net is not None]


def between(circuit: Any, kind: str, first: str, second: str) -> list[Any]:
    return [part for part in circuit.parts if part.name == kind and sorted(nets(part)) == sorted((first, second))]


def test_the_electrical_rules_are_kept_and_would_tell(circuit: Any) -> None:
    assert hardware.check(circuit) == []
    with hardware.quietly():
        from tools.hardware.circuit import build

        broken = build(hardware.edge_pins())
        buffer = next(part for part in broken.parts if part.name == "74LVC1G17")
        gate = next(part for part in broken.parts if part.name == "74LVC1G08")
        buffer["Y"].net.connect(gate["Y"].net)  # two outputs on one net
    assert hardware.check(broken) != []


def test_every_pin_is_on_the_net_of_its_name_and_can_be_probed(circuit: Any) -> None:
    [pico] = [part for part in circuit.parts if part.name == "Pico"]
    for name, gpio in hardware.edge_pins().items():
        assert pico[f"GP{gpio}"].net.name == name
        assert [part for part in circuit.parts if part.name == "Testpoint" and nets(part) == [name]], name
    for name, at in (("swclk", "D1"), ("swdio", "D3"), ("run", "30")):
        assert pico[at].net.name == name


def test_every_output_is_dark_and_every_contact_open_by_a_resistor_of_its_own(circuit: Any) -> None:
    assert set(DARK) | {"enable"} == {
        name for name, use in hardware.uses().items() if use == "out" and name in hardware.edge_pins()
    }
    for name, supply in PULLS.items():
        assert [read(part.value) for part in between(circuit, "R", name, supply)] in ([10e3], [4.7e3]), name


@pytest.mark.parametrize("name", LIMITS)
def test_no_gate_stays_on_beyond_the_controllers_limit_over_all_tolerances(circuit: Any, name: str) -> None:
    [resistor] = between(circuit, "R", f"{name}_rx", "3v3")
    [capacitor] = between(circuit, "C", f"{name}_rx", f"{name}_cx")
    shot = OneShot(read(resistor.value), read(capacitor.value), LIMITS[name])
    assert 0.7 * shot.limit_s < shot.shortest_s < shot.longest_s <= shot.limit_s
    assert RESISTOR_LEAST_OHM <= shot.ohm <= RESISTOR_MOST_OHM and shot.farad >= CAPACITOR_LEAST_F
    [gate] = [part for part in circuit.parts if part.name == "74LVC1G08" and f"{name}_in" in nets(part)]
    assert {gate["A"].net.name, gate["B"].net.name} == {f"{name}_in", f"{name}_q"}  # the pin and its one-shot
    [one_shot] = [part for part in circuit.parts if part.name == "74LVC1G123" and f"{name}_in" in nets(part)]
    assert (one_shot["B"].net.name, one_shot["Q"].net.name) == (f"{name}_in", f"{name}_q")


def test_values_are_shown_as_they_are_read() -> None:
    for value in (LAMP.ohm, LAMP.farad, MICROWAVE.ohm, MICROWAVE.farad, 33.0, 4700.0):
        assert read(shown(value)) == pytest.approx(value)


@pytest.mark.deep(gate="tests/unit/tools/test_hardware.py::test_the_electrical_rules_are_kept_and_would_tell")
def test_netlist_picture_parts_and_labels_are_written(tmp_path: Path) -> None:
    assert hardware.write(tmp_path) == []
    netlist = (tmp_path / "annulus.net").read_text("utf-8")
    picture = (tmp_path / "hardware.svg").read_text("utf-8")
    for name in hardware.edge_pins():
        assert f'(name "{name}")' in netlist and f">{name}<" in picture
    assert "Epilepsie" in (tmp_path / "label-de.svg").read_text("utf-8")
    assert "epilepsy" in (tmp_path / "label-en.svg").read_text("utf-8")
