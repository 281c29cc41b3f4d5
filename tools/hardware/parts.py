"""Parts as SKiDL wants them, defined here: no library of KiCad's is needed to check or write the netlist."""

import logging
import os
from functools import cache
from typing import Any

for _version in ("", "5", "6", "7", "8", "9", "10"):  # where libraries are, which SKiDL asks for when it is imported
    os.environ.setdefault(f"KICAD{_version}_SYMBOL_DIR", os.devnull)

from skidl import SKIDL, TEMPLATE, Part, Pin  # noqa: E402

logging.setLoggerClass(logging.Logger)  # SKiDL leaves its own behind for the whole process, which takes text only

LETTERS = {"i": "INPUT", "o": "OUTPUT", "b": "BIDIR", "p": "PASSIVE", "w": "PWRIN", "s": "PWROUT", "n": "NOCONNECT"}


def _pins(text: str) -> dict[str, tuple[str, str]]:
    """Name and function by number, of "1:OE1:i 2:A1:i ..": a letter of LETTERS each."""
    split = (one.split(":") for one in text.split())
    return {number: (name, LETTERS[letter]) for number, name, letter in split}


# The edge of a Pico, pins 1 to 40, and its three debug pins. GP pins are named by their number.
_GROUNDS = (3, 8, 13, 18, 23, 28, 38)
_EDGE = (1, 2, 4, 5, 6, 7, 9, 10, 11, 12, 14, 15, 16, 17, 19, 20, 21, 22, 24, 25, 26, 27, 29, 31, 32, 34)
PICO = {
    **{str(at): (f"GP{gpio}", LETTERS["b"]) for at, gpio in zip(_EDGE, (*range(23), 26, 27, 28), strict=True)},
    **{str(at): (f"GND{at}", LETTERS["w"]) for at in _GROUNDS},
    **_pins(
        "30:RUN:i 33:AGND:w 35:ADC_VREF:p 36:3V3:s 37:3V3_EN:p 39:VSYS:w 40:VBUS:p D1:SWCLK:i D2:GNDD:w D3:SWDIO:b"
    ),
}
_HEADER = "Connector_PinHeader_2.54mm:PinHeader_1x0{0}_P2.54mm_Vertical"
_SMALL = "Package_TO_SOT_SMD:SOT-353_SC-70-5"
_TWO = "1:1:p 2:2:p"
_BUFFER = "1:OE1:i 2:A1:i 3:Y1:o 4:OE2:i 5:A2:i 6:Y2:o 7:GND:w 8:Y3:o 9:A3:i 10:OE3:i 11:Y4:o 12:A4:i 13:OE4:i 14:VCC:w"
_RECEIVER = (
    "1:B1:i 2:A1:i 3:Y1:o 4:G:i 5:Y2:o 6:A2:i 7:B2:i 8:GND:w 9:B3:i 10:A3:i 11:Y3:o 12:GN:i 13:Y4:o 14:A4:i 15:B4:i"
    " 16:VCC:w"
)
# Four contacts that are closed while the coil is energised.
_RELAY = "A1:A1:p A2:A2:p " + " ".join(f"{n}{end}:{n}{end}:p" for n in "1234" for end in "34")

# Name: prefix of its reference, footprint, pins.
KINDS: dict[str, tuple[str, str, str]] = {
    "R": ("R", "Resistor_SMD:R_0805_2012Metric", _TWO),
    "C": ("C", "Capacitor_SMD:C_0805_2012Metric", _TWO),
    "C_big": ("C", "Capacitor_THT:CP_Radial_D12.5mm_P5.00mm", _TWO),
    "Fuse": ("F", "Fuse:Fuseholder_Blade_ATO_Littelfuse_Pudenz_2_Pin", _TWO),
    "Diode": ("D", "Diode_SMD:D_SMB", "1:K:p 2:A:p"),
    "Testpoint": ("TP", "TestPoint:TestPoint_Loop_D1.80mm_Drill1.0mm_Beaded", "1:1:p"),
    "Connector2": ("J", "TerminalBlock:TerminalBlock_bornier-2_P5.08mm", _TWO),
    "Connector3": ("J", _HEADER.format(3), " ".join(f"{n}:{n}:p" for n in range(1, 4))),
    "Connector4": ("J", _HEADER.format(4), " ".join(f"{n}:{n}:p" for n in range(1, 5))),
    "Connector6": ("J", _HEADER.format(6), " ".join(f"{n}:{n}:p" for n in range(1, 7))),
    "Converter": ("U", "Converter_DCDC:Converter_DCDC_TRACO_TSR-1_THT", "1:VIN:w 2:GND:w 3:VOUT:s"),
    "UCC27517": ("U", "Package_TO_SOT_SMD:SOT-23-5", "1:VDD:w 2:GND:w 3:INP:i 4:INN:i 5:OUT:o"),
    "IRLZ44N": ("Q", "Package_TO_SOT_THT:TO-220-3_Vertical", "1:G:i 2:D:p 3:S:p"),
    "74LVC1G123": (
        "U",
        "Package_SO:VSSOP-8_2.3x2mm_P0.5mm",
        "1:AN:i 2:B:i 3:CLR:i 4:GND:w 5:Q:o 6:CX:p 7:RX:p 8:VCC:w",
    ),
    "74LVC1G08": ("U", _SMALL, "1:A:i 2:B:i 3:GND:w 4:Y:o 5:VCC:w"),
    "74LVC1G17": ("U", _SMALL, "1:NC:n 2:A:i 3:GND:w 4:Y:o 5:VCC:w"),
    "74LVC1T45": ("U", "Package_TO_SOT_SMD:SOT-363_SC-70-6", "1:VCCA:w 2:GND:w 3:A:i 4:B:o 5:DIR:i 6:VCCB:w"),
    "74HCT125": ("U", "Package_SO:SOIC-14_3.9x8.7mm_P1.27mm", _BUFFER),
    "AM26LV32": ("U", "Package_SO:SOIC-16_3.9x9.9mm_P1.27mm", _RECEIVER),
    "SR4D4024": ("K", "Relay_THT:Relay_SPST-NO_x4", _RELAY),
}


@cache
def _template(kind: str) -> Any:
    prefix, footprint, pins = (
        ("A", "Module:RaspberryPi_Pico_Common_THT", PICO)
        if kind == "Pico"
        else (*KINDS[kind][:2], _pins(KINDS[kind][2]))
    )
    made = [Pin(num=number, name=name, func=getattr(Pin.types, func)) for number, (name, func) in pins.items()]
    return Part(name=kind, ref_prefix=prefix, tool=SKIDL, dest=TEMPLATE, footprint=footprint, pins=made)


def part(kind: str, value: str = "", **fields: Any) -> Any:
    """One more of them, in the circuit that is being made."""
    return _template(kind)(value=value or kind, **fields)
