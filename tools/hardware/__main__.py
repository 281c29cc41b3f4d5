"""`python -m tools.hardware OUT`: the netlist for KiCad, the picture, the parts and the labels, once the circuit has
passed its electrical rules; status 1 else. `make docs` takes the pictures.
"""

import contextlib
import io
import os
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


def _pins() -> dict[str, dict[str, Any]]:
    table: dict[str, dict[str, Any]] = tomllib.loads((ROOT / "protocol/messages.toml").read_text("utf-8"))["pins"]
    return table


def edge_pins() -> dict[str, int]:
    """GPIO of each name of messages.toml that is on the Pico's edge."""
    return {name: pin["number"] for name, pin in _pins().items() if "pico" in pin}


def uses() -> dict[str, str]:
    """in, out or line, by name."""
    return {name: pin["use"] for name, pin in _pins().items()}


@contextlib.contextmanager
def quietly() -> Iterator[None]:
    """SKiDL writes logs where it is called, and says much."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                yield
        finally:
            os.chdir(before)


def check(circuit: Any) -> list[str]:
    """What SKiDL's electrical rule check has against it: errors and warnings, a line each."""
    from skidl import erc_logger

    with quietly():
        erc_logger.error.reset()
        erc_logger.warning.reset()
        circuit.ERC()
        errors, warnings = erc_logger.error.count, erc_logger.warning.count
    return [f"{errors} errors"] * bool(errors) + [f"{warnings} warnings"] * bool(warnings)


def parts_table(circuit: Any) -> str:
    """How many of what, in Markdown."""
    counted = Counter(
        (part.ref_prefix, part.name if part.value == part.name else f"{part.name} {part.value}")
        for part in circuit.parts
        if part.ref_prefix not in ("TP", "J")
    )
    rows = [f"| {count} | {what} |" for (_, what), count in sorted(counted.items())]
    return "\n".join(["| n | part |", "|---|---|", *rows, ""])


def write(out: Path) -> list[str]:
    """All of it into a folder; what the rules have against it, and then nothing is written."""
    out = out.resolve()
    with quietly():
        from tools.hardware.circuit import build
        from tools.hardware.draw import draw
        from tools.hardware.label import TEXTS, label

        circuit = build(edge_pins())
    wrong = check(circuit)
    if wrong:
        return wrong
    out.mkdir(parents=True, exist_ok=True)
    with quietly():
        circuit.generate_netlist(file_=str(out / "annulus.net"))
    (out / "hardware.svg").write_text(draw(circuit, edge_pins()), "utf-8")
    (out / "hardware-parts.md").write_text(parts_table(circuit), "utf-8")
    for language in TEXTS:
        (out / f"label-{language}.svg").write_text(label(language), "utf-8")
    return []


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("python -m tools.hardware OUT: expected the folder to write to")
    if found := write(Path(sys.argv[1])):
        sys.exit(f"the circuit breaks its electrical rules: {', '.join(found)}")
