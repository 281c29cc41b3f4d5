"""JavaScript: what the emulator needs to know of the controller and its pins."""

import json

from generator.schema import GENERATED, Protocol


def controller_module(protocol: Protocol) -> str:
    high = [pin.number for pin in protocol.pins.values() if pin.use == "out" and pin.high_at_reset]
    low = [pin.number for pin in protocol.pins.values() if pin.use == "in" and not pin.high_at_reset]
    out = [f"// {GENERATED}", "", f"export const TICK_HZ = {protocol.tick_hz};", ""]
    out += ["export const PIN = {"]
    out += [f"  {name.upper()}: {pin.number}, // {pin.what}" for name, pin in protocol.pins.items()]
    out += ["};"]
    for name, numbers in (
        ("INPUT_PINS", protocol.pin_numbers("in")),
        ("OUTPUT_PINS", protocol.pin_numbers("out")),
        ("OUTPUTS_HIGH_AT_RESET", high),
        ("INPUTS_LOW_AT_REST", low),
    ):
        out.append(f"export const {name} = {json.dumps(numbers)};")
    return "\n".join([*out, ""])
