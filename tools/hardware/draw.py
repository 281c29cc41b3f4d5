"""The circuit as a picture: a row for each pin, from the Pico outwards, drawn from the circuit's own nets.

A row follows signals from part to part. What goes from a net to ground or a supply hangs below it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from typing import Any

SUPPLIES = ("gnd", "3v3", "5v", "14v5", "vsys", "camera_1v8", "supply")
# Through which pins of a part its signal goes, outwards from the Pico or inwards to it.
FLOW: dict[str, tuple[tuple[str, str], ...]] = {
    "74LVC1G123": (("B", "Q"),),
    "74LVC1G08": (("A", "Y"),),
    "74LVC1G17": (("A", "Y"),),
    "74LVC1T45": (("A", "B"),),
    "74HCT125": tuple((f"A{n}", f"Y{n}") for n in range(1, 5)),
    "AM26LV32": tuple((f"A{n}", f"Y{n}") for n in range(1, 5)),
    "UCC27517": (("INP", "OUT"),),
    "IRLZ44N": (("G", "D"),),
    "SR4D4024": tuple((f"{n}3", f"{n}4") for n in "1234"),
}
ORDER = ("74LVC1G123", "R", "74LVC1G08")  # where a net leads to several parts
BOX_W, BOX_H, GAP, ROW, LEFT = 212, 34, 22, 78, 254
FONT = 'font-family="sans-serif" font-size="11"'


@dataclass(frozen=True)
class _Hop:
    part: Any
    net: str  # behind it
    beside: tuple[str, ...]  # what hangs on that net


def _nets_of(part: Any) -> list[str]:
    return [pin.net.name for pin in part.pins if pin.net is not None]


def _beside(circuit: Any, net: str) -> tuple[str, ...]:
    """Two-legged parts from a net to a supply, as "10k to gnd"."""
    found = []
    for part in circuit.parts:
        names = _nets_of(part)
        if len(names) == 2 and net in names and part.name in ("R", "C", "Diode", "C_big"):
            other = names[1] if names[0] == net else names[0]
            if other in SUPPLIES:
                value = {"R": "Ω", "C": "F"}.get(part.name, "")
                found.append(f"{part.value}{value} to {other}")
    return tuple(found)


def _steps(circuit: Any, net: str, used: set[str]) -> Iterator[tuple[Any, str]]:
    """Parts that carry a signal on from a net, with the net behind; resistors and contacts both ways."""
    for part in circuit.parts:
        if part.ref in used:
            continue
        if part.name == "R":
            names = _nets_of(part)
            if net in names:
                other = names[1] if names[0] == net else names[0]
                if other not in SUPPLIES:
                    yield part, other
        for first, second in FLOW.get(part.name, ()):
            ends = [part[first].net, part[second].net]
            names = ["" if end is None else end.name for end in ends]
            if net in names:
                yield part, names[1] if names[0] == net else names[0]


def _row(circuit: Any, name: str) -> list[_Hop]:
    """From a pin to what is outside: one-shots go before the gates that wait for them."""
    hops: list[_Hop] = []
    used: set[str] = set()
    net = name
    while True:
        steps = sorted(_steps(circuit, net, used), key=lambda step: (*ORDER, step[0].name).index(step[0].name))
        steps = [step for step in steps if step[1] not in ("", *SUPPLIES) or step[0].name == "SR4D4024"]
        if not steps:
            return hops
        part, behind = steps[0]
        used.add(part.ref)
        if part.name == "74LVC1G123":  # its output and the pin meet in the gate
            hops.append(_Hop(part, net, ()))
            continue
        if behind in SUPPLIES:  # a contact that closes to it
            return [*hops, _Hop(part, behind, ())]
        hops.append(_Hop(part, behind, _beside(circuit, behind)))
        net = behind


def _label(part: Any) -> str:
    return f"{part.value} Ω" if part.name == "R" else part.name


def _box(x: float, y: float, text: str, below: str, fill: str) -> str:
    return (
        f'<rect x="{x}" y="{y}" width="{BOX_W}" height="{BOX_H}" rx="4" fill="{fill}" stroke="#333"/>'
        f'<text x="{x + BOX_W / 2}" y="{y + 14}" text-anchor="middle" {FONT} font-weight="bold">{escape(text)}</text>'
        f'<text x="{x + BOX_W / 2}" y="{y + 28}" text-anchor="middle" {FONT}>{escape(below)}</text>'
    )


def _wire(left: float, right: float, y: float) -> str:
    return f'<line x1="{left}" y1="{y}" x2="{right}" y2="{y}" stroke="#333"/>'


def _outside(circuit: Any, net: str) -> str:
    if net in SUPPLIES:
        return f"{net}, by a contact"
    return next((p.value for p in circuit.parts if p.ref_prefix == "J" and net in _nets_of(p)), "")


def draw(circuit: Any, pins: dict[str, int]) -> str:
    """An SVG of all rows."""
    rows = {name: _row(circuit, name) for name in pins}
    width = LEFT + (max(map(len, rows.values())) + 1) * (BOX_W + GAP) + 20
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{ROW * len(rows) + 30}"'
        f' viewBox="0 0 {width} {ROW * len(rows) + 30}" role="img"><title>Reference circuit, a row for each pin</title>'
        f'<rect width="100%" height="100%" fill="#fff"/>'
    ]
    for number, (name, hops) in enumerate(rows.items()):
        y = 20 + ROW * number
        middle = y + BOX_H / 2
        out.append(_box(20, y, f"GP{pins[name]}", name, "#dcebfa"))
        hanging = [(20.0, _beside(circuit, name))]
        x = float(LEFT)
        out.append(_wire(20 + BOX_W, x, middle))
        for hop in hops:
            out.append(
                _box(x, y, _label(hop.part), hop.part.ref, "#fff7d6" if hop.part.ref_prefix == "U" else "#f4f4f4")
            )
            hanging.append((x, hop.beside))
            out.append(_wire(x + BOX_W, x + BOX_W + GAP, middle))
            x += BOX_W + GAP
        out.append(_box(x, y, "outside", _outside(circuit, hops[-1].net if hops else name), "#e3f4e1"))
        for at, items in hanging:
            for line, item in enumerate(items):
                out.append(
                    f'<text x="{at + BOX_W / 2}" y="{y + BOX_H + 16 + 14 * line}" text-anchor="middle" {FONT}'
                    f' fill="#555">{escape(item)}</text>'
                )
    return "\n".join([*out, "</svg>", ""])
