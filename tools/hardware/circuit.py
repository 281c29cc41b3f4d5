"""The reference circuit, net by net. A net that leaves the Pico has its pin's name in protocol/messages.toml."""

from typing import Any

from tools.hardware.oneshot import LAMP, MICROWAVE, OneShot, shown
from tools.hardware.parts import PICO, part

from skidl import POWER, Circuit, Net  # isort: skip  # after parts, which tells it where no libraries are


class _Board:
    """Nets by name, and what is done again and again."""

    def __init__(self, circuit: Circuit, pins: dict[str, int]) -> None:
        self.circuit = circuit
        self._nets: dict[str, Any] = {}
        self.pico = self.part("Pico", "Raspberry Pi Pico")
        for name, at in pins.items():
            self.net(name).connect(self.pico[f"GP{at}"])

    def net(self, name: str) -> Any:
        if name not in self._nets:
            self._nets[name] = Net(name, circuit=self.circuit)
        return self._nets[name]

    def part(self, kind: str, value: str = "", **nets: str) -> Any:
        """With its pins on these nets. Pin names that are no words are written with a leading underscore."""
        made = part(kind, value, circuit=self.circuit, tag=str(len(self.circuit.parts)))
        for name, net in nets.items():
            self.net(net).connect(made[name.removeprefix("_")])
        return made

    def two(self, kind: str, value: str, first: str, second: str) -> Any:
        return self.part(kind, value, _1=first, _2=second)

    def chip(self, kind: str, supply: str, **nets: str) -> Any:
        """With 100 nF at its supply."""
        self.two("C", "100n", supply, "gnd")
        power = {"UCC27517": "VDD"}.get(kind, "VCC")
        return self.part(kind, **{power: supply, "GND": "gnd", **nets})

    def limited(self, name: str, shot: OneShot) -> str:
        """Behind a pin: high while the pin is and its one-shot runs. The net that is."""
        self.two("R", "33", name, f"{name}_in")
        self.two("R", "10k", name, "gnd")
        self.two("R", shown(shot.ohm), f"{name}_rx", "3v3")
        self.two("C", shown(shot.farad), f"{name}_cx", f"{name}_rx")
        self.chip(
            "74LVC1G123", "3v3", AN="gnd", B=f"{name}_in", CLR="3v3", Q=f"{name}_q", CX=f"{name}_cx", RX=f"{name}_rx"
        )
        self.chip("74LVC1G08", "3v3", A=f"{name}_in", B=f"{name}_q", Y=f"{name}_limited")
        return f"{name}_limited"

    def contact(self, name: str, outside: str, pull: str) -> None:
        """An input behind a contact: 1 kohm, 100 nF, and a pull that says open."""
        self.two("R", "1k", outside, name)
        self.two("R", "4.7k", name, pull)
        self.two("C", "100n", name, "gnd")


def build(pins: dict[str, int]) -> Circuit:
    """All of it; `pins`: GPIO of each name in messages.toml that is on the edge."""
    circuit = Circuit(name="annulus controller")
    board = _Board(circuit, pins)
    for step in (_supply, _lamps, _microwave, _interlock, _sync, _odometer, _turntable, _lines):
        step(board)
    _rest(board, pins)
    return circuit


def _supply(board: _Board) -> None:
    board.part("Connector2", "lamp supply 14.5 V", _1="supply", _2="gnd")
    board.two("Fuse", "for the lamps' duty", "supply", "14v5")
    board.part("Diode", "SMBJ18A", K="14v5", A="gnd")
    board.two("C_big", "1000u 25V", "14v5", "gnd")
    board.part("Converter", "14.5 V to 5 V, 1 A", VIN="14v5", GND="gnd", VOUT="5v")
    board.part("Diode", "1N5819", K="vsys", A="5v")
    for name in ("supply", "14v5", "vsys", "gnd", "camera_1v8"):
        board.net(name).drive = POWER  # comes from outside, or through a fuse or diode
    for pin, (name, _) in PICO.items():
        if name.startswith(("GND", "AGND")):
            board.net("gnd").connect(board.pico[pin])
    board.net("3v3").connect(board.pico["36"])
    board.net("vsys").connect(board.pico["39"])
    board.net("vbus_socket").connect(board.pico["40"])  # the Pico's own divider takes it to GP24


def _lamps(board: _Board) -> None:
    for name in ("projector", "slide_2", "slide_3", "slide_4", "led"):
        limited = board.limited(name, LAMP)
        board.two("R", "10k", limited, "gnd")  # with the gate's chip unpowered
        board.two("C", "1u", "14v5", "gnd")
        board.chip("UCC27517", "14v5", INP=limited, INN="gnd", OUT=f"{name}_driver")
        board.two("R", "10", f"{name}_driver", f"{name}_gate")
        board.two("R", "10k", f"{name}_gate", "gnd")
        board.part("IRLZ44N", G=f"{name}_gate", D=f"{name}_lamp", S="gnd")
        board.part("Diode", "SB540", K="14v5", A=f"{name}_lamp")
        board.part("Connector2", f"{name} lamp", _1="14v5", _2=f"{name}_lamp")


def _microwave(board: _Board) -> None:
    limited = board.limited("microwave", MICROWAVE)
    board.two("R", "10k", limited, "gnd")
    board.part("Connector2", "source's trigger", _1="source_trigger", _2="gnd")  # behind contact b
    board.two("R", "33", "trigger", "trigger_in")
    board.two("R", "10k", "trigger", "gnd")
    board.chip("74LVC1G17", "3v3", A="trigger_in", Y="trigger_line")
    board.two("R", "50", "trigger_line", "digitizer")
    board.part("Connector2", "digitizer", _1="digitizer", _2="gnd")


def _interlock(board: _Board) -> None:
    relay = {
        "A1": "chain",
        "A2": "chain_0v",
        "_13": "source_enable_1",
        "_14": "source_enable_2",  # a
        "_23": "microwave_5v",
        "_24": "source_trigger",  # b
        "_33": "interlock_contact",
        "_34": "gnd",  # c
        "_43": "antivalent_contact",
        "_44": "3v3",  # d
    }
    board.part("SR4D4024", "24 V, forced contacts", **relay)
    board.part("Diode", "1N5819", K="chain", A="chain_0v")
    board.part("Connector2", "interlock chain 24 V", _1="chain", _2="chain_0v")
    board.part("Connector2", "source's enable", _1="source_enable_1", _2="source_enable_2")
    board.contact("interlock", "interlock_contact", "3v3")
    board.contact("interlock_antivalent", "antivalent_contact", "gnd")


def _sync(board: _Board) -> None:
    board.part(
        "Connector4",
        "camera: 1.8 V, sync, trigger, ground",
        _1="camera_1v8",
        _2="camera_sync",
        _3="camera_xtr",
        _4="gnd",
    )
    board.two("C", "100n", "camera_1v8", "gnd")
    board.two("C", "100n", "3v3", "gnd")
    board.part(
        "74LVC1T45", VCCA="camera_1v8", VCCB="3v3", GND="gnd", A="camera_sync", B="sync_3v3", DIR="camera_1v8"
    )  # A to B
    board.two("R", "100", "sync_3v3", "sync")
    board.two("C", "100p", "sync", "gnd")
    board.two("R", "33", "camera_trigger", "camera_trigger_in")
    board.two("R", "10k", "camera_trigger", "gnd")
    board.two("C", "100n", "camera_1v8", "gnd")
    board.two("C", "100n", "3v3", "gnd")
    board.part(
        "74LVC1T45", VCCA="camera_1v8", VCCB="3v3", GND="gnd", A="camera_xtr", B="camera_trigger_in", DIR="gnd"
    )  # B to A


def _odometer(board: _Board) -> None:
    board.part(
        "Connector6",
        "encoder: 5 V, ground, A, /A, B, /B",
        _1="5v",
        _2="gnd",
        _3="encoder_a",
        _4="encoder_an",
        _5="encoder_b",
        _6="encoder_bn",
    )
    board.two("R", "120", "encoder_a", "encoder_an")
    board.two("R", "120", "encoder_b", "encoder_bn")
    board.chip(
        "AM26LV32",
        "3v3",
        A1="encoder_a",
        B1="encoder_an",
        Y1="odometer_a",
        A2="encoder_b",
        B2="encoder_bn",
        Y2="odometer_b",
        G="3v3",
        GN="gnd",
        A3="gnd",
        B3="3v3",
        A4="gnd",
        B4="3v3",
    )


def _turntable(board: _Board) -> None:
    board.chip(
        "74HCT125",
        "5v",
        A1="microwave_limited",
        Y1="microwave_5v",
        A2="step",
        Y2="step_5v",
        A3="direction",
        Y3="direction_5v",
        A4="enable",
        Y4="enable_5v",
        OE1="gnd",
        OE2="gnd",
        OE3="gnd",
        OE4="gnd",
    )
    board.two("R", "10k", "step", "gnd")
    board.two("R", "10k", "direction", "gnd")
    board.two("R", "10k", "enable", "3v3")
    board.part("Connector4", "turntable's driver", _1="step_5v", _2="direction_5v", _3="enable_5v", _4="gnd")
    for name in ("end_low", "end_high"):
        board.part("Connector2", f"{name} switch, normally closed", _1=f"{name}_contact", _2="gnd")
        board.contact(name, f"{name}_contact", "3v3")


def _lines(board: _Board) -> None:
    board.part("Connector3", "UART: TX, RX, ground", _1="uart_tx", _2="uart_rx", _3="gnd")
    board.part("Connector4", "SWD: SWCLK, ground, SWDIO, RUN", _1="swclk", _2="gnd", _3="swdio", _4="run")
    for name, pin in (("swclk", "D1"), ("swdio", "D3"), ("run", "30")):
        board.net(name).connect(board.pico[pin])


def _rest(board: _Board, pins: dict[str, int]) -> None:
    """A test point at each pin and supply; what is not used is said to be so."""
    for name in (
        *pins,
        "gnd",
        "3v3",
        "5v",
        "14v5",
        "vsys",
        "vbus_socket",
        "projector_gate",
        "led_gate",
        "microwave_5v",
    ):
        board.part("Testpoint", name, _1=name)
    for one in board.circuit.parts:
        for pin in one.pins:
            if not pin.is_connected():
                board.circuit.NC.connect(pin)
