"""The deep tests of the rooms that a change touches, and of those above, within a bound of time.

python -m tools.touched [BASE] [--minutes 8] [--list]        BASE: a commit; without it the last tag, or else HEAD~1

What is left out is said. Which files fit follows from tests/durations.json, by cores.
"""

import argparse
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import tiers  # noqa: E402  # it lies beside the tests

FOLDERS = ("wings", "unit", "scenes")  # whose next folder is a room
EVERYWHERE = ("system", "regression")  # whole programs: after any change of the host
FIRMWARE = ("firmware", "protocol", "tools/emulator", "tools/attack")


def git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def last_base() -> str:
    tagged = subprocess.run(
        ["git", "describe", "--tags", "--abbrev=0", "HEAD~1"], cwd=ROOT, capture_output=True, text=True
    )
    return tagged.stdout.strip() if tagged.returncode == 0 else "HEAD~1"


def floors() -> dict[str, int]:
    """Each room's, the highest is 0, where the wings stand: nothing of the core knows one."""
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = next(c["layers"] for c in config["tool"]["importlinter"]["contracts"] if c["type"] == "layers")
    wings = (path.parent.name for path in (ROOT / "host/annulus_pipe/wings").glob("*/__init__.py"))
    return dict.fromkeys(wings, 0) | {
        name.strip().removeprefix("annulus_pipe."): floor
        for floor, layer in enumerate(layers)
        for name in re.split(r"[|:]", layer)
    }


def touched(changed: list[str], floor: dict[str, int]) -> dict[str, int]:
    """The test files of deep cases that the change calls for, and how far above it they stand: nearest first."""
    inside = [Path(name).parts[2:] for name in changed if name.startswith("host/annulus_pipe/")]
    rooms = {parts[parts[0] == "wings"].removesuffix(".py") for parts in inside}
    rooms &= floor.keys()
    tested = {name for name in changed if name.startswith("tests/")}
    helped = {Path(name).parent for name in tested if not Path(name).name.startswith("test_") and name.endswith(".py")}
    firmware = any(name.startswith(FIRMWARE) for name in changed)
    far: dict[str, int] = {}
    for name, cost in tiers.read_durations().items():
        kind, room = Path(name).parts[1], Path(name).parts[2]
        above = [floor[one] - floor[room] for one in rooms if room in floor and floor[room] <= floor[one]]
        if cost["deep"] <= 0.0:
            continue
        beside = any(Path(name).parent.is_relative_to(folder) for folder in helped)
        silicon = firmware and (kind in ("emulator", "hil", "guest") or room == "firmware")
        if name in tested or room in rooms or silicon or beside:
            far[name] = 0
        elif kind in FOLDERS and above and min(above) > 0:  # rooms beside it on a floor do not know it
            far[name] = min(above)
        elif kind in EVERYWHERE and (rooms or firmware):
            far[name] = len(floor)
    return far


def fitting(far: dict[str, int], seconds: float) -> list[str]:
    """The nearest first, for as long as their processor seconds fit."""
    chosen, left = [], seconds
    costs = tiers.read_durations()
    for name in sorted(far, key=lambda name: (far[name], costs[name]["deep"])):
        if costs[name]["deep"] <= left:
            chosen.append(name)
            left -= costs[name]["deep"]
    return chosen


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("base", nargs="?", default=os.environ.get("BASE") or None, help="the commit before the change")
    parser.add_argument("--minutes", type=float, default=8.0, help="bound of time, of this machine left to itself")
    parser.add_argument("--list", action="store_true", help="say what would run, and run nothing")
    asked = parser.parse_args()
    if not 0.0 < asked.minutes < 1e6:
        parser.error(f"--minutes {asked.minutes:g}: expected more than 0")
    base = asked.base or last_base()
    try:
        commit = git("rev-parse", "--verify", "--end-of-options", f"{base}^{{commit}}")
        changed = git("diff", "--name-only", "--no-renames", "-z", commit, "--").split("\0")
        changed += git("ls-files", "-zo", "--exclude-standard").split("\0")
    except (OSError, subprocess.CalledProcessError) as wrong:
        why = str(getattr(wrong, "stderr", "") or wrong).strip().splitlines()[0]
        print(f"tools.touched: {base}: {why}", file=sys.stderr)
        return 2
    far = touched(changed, floors())
    cores = os.cpu_count() or 1
    chosen = fitting(far, asked.minutes * 60.0 * cores)
    left = sorted(far.keys() - set(chosen))
    print(f"deep tests that the change since {base} touches: {len(chosen)} files, within {asked.minutes:g} min")
    print(f"left out for time: {', '.join(left) or 'none'}; `make test-deep` runs all", flush=True)
    if not chosen or asked.list:
        return 0
    pytest = [sys.executable, "-m", "pytest"]
    beside = [*pytest, "-n", "auto", "--dist", "loadfile", "-m", "deep and not alone", *chosen]
    alone = [*pytest, "-m", "deep and alone", *chosen]
    strict = {**os.environ, "ANNULUS_NO_SKIPS": "1"}
    results = [subprocess.run(command, cwd=ROOT, env=strict, check=False).returncode for command in (beside, alone)]
    if all(status == 5 for status in results):  # 5: none of that kind was among them
        print("tools.touched: none of these files has a deep test: `make durations GATE=deep`", file=sys.stderr)
        return 1
    return next((status for status in results if status not in (0, 5)), 0)


if __name__ == "__main__":
    sys.exit(main())
