"""Lint, types and the gate's tests of one room, and nothing else.

python -m tools.room wall        what `make test ROOM=wall` does
"""

import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ROOT / "host/annulus_pipe"
BIN = Path(sys.executable).parent


def steps(room: str) -> list[list[str]]:
    """The commands, each to end with 0. Raises ValueError naming the rooms there are."""
    named = (ROOMS / room, ROOMS / f"{room}.py") if re.fullmatch(r"[a-z]\w*(/[a-z]\w*)*", room) else ()
    code = next((path for path in named if path.exists()), None)
    tests = [ROOT / "tests/unit" / room, ROOT / "tests" / room, ROOT / f"tests/unit/test_{room}.py"]
    tests = [path for path in tests if path.exists()]
    if code is None:
        known = sorted(path.parent.relative_to(ROOMS).as_posix() for path in ROOMS.rglob("__init__.py"))
        raise ValueError(f"no room {room!r}. There are: {', '.join(known[1:])}")
    places = [str(path.relative_to(ROOT)) for path in (code, *tests)]
    checks = [
        [str(BIN / "ruff"), "check", "--quiet", *places],
        [str(BIN / "ruff"), "format", "--check", "--quiet", *places],
        [str(BIN / "mypy")],  # its cache makes it 1 s; its daemon stumbles over packages whose imports are skipped
    ]
    names = places[1:]
    pytest = [str(BIN / "pytest"), "-n", "auto", "--dist", "loadfile", "-m", "not deep and not alone", *names]
    return [*checks, pytest] if names else checks


def main(arguments: list[str]) -> int:
    if len(arguments) != 1:
        print("one room, please: make test ROOM=wall", file=sys.stderr)
        return 2
    try:
        commands = steps(arguments[0].strip("/"))
    except ValueError as wrong:
        print(f"make test ROOM={arguments[0]}: {wrong}", file=sys.stderr)
        return 2
    began = time.monotonic()
    running = [subprocess.Popen(command, cwd=ROOT) for command in commands]  # side by side: pytest starts on one core
    statuses = [process.wait() for process in running]
    if any(statuses):
        return 1
    print(f"{arguments[0]}: {time.monotonic() - began:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
