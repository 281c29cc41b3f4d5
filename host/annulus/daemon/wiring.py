"""What head.toml says of the wires between controller, lamps and cameras."""

from collections.abc import Mapping
from typing import Any

from annulus.link.pins import INVERTIBLE
from annulus.untrusted import shown

WATCHFUL = ("interlock", "end_low", "end_high")  # inputs that say unsafe when their wire breaks


def inverted_pins(content: Mapping[str, Any]) -> tuple[str, ...]:
    """Of [controller]. Raises ValueError."""
    names = content.get("inverted", [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"[controller] inverted is {shown(names)}, expected a list of {', '.join(INVERTIBLE)}")
    for name in names:
        if name not in INVERTIBLE:
            why = ": a broken wire must say unsafe" if name in WATCHFUL else ""
            raise ValueError(f"[controller] inverted names {shown(name)}{why}, expected of {', '.join(INVERTIBLE)}")
    return tuple(names)
