"""Hatch's build hook: a wheel of one kind of machine, with all in it that is no Python.

    make wheels                                    # both, into dist/
    ANNULUS_MACHINE=aarch64 hatchling build -t wheel

No ABI of Python's is touched, so one wheel a machine serves every version: py3-none. The native library is held to
what glibc had in version 2.17 (manylinux_2_17), the image is of the same commit, and a manual made by `make docs` goes
in where there is one. Who installs a wheel needs no compiler; who builds one needs gcc, for aarch64 on another machine
gcc-aarch64-linux-gnu, and gcc-arm-none-eabi. A machine that flashes no controller needs no image: ANNULUS_IMAGE=no
leaves it out. ANNULUS_COMMIT says the commit where the source is without its repository.
"""

import json
import os
import platform
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

GLIBC = (2, 17)
MACHINES = ("x86_64", "aarch64")
SHIPPED = "annulus_pipe/shipped"


class WheelHook(BuildHookInterface):  # type: ignore[type-arg, misc]
    """An editable install is left alone: `make` puts what it builds where the package looks for it."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version == "editable":
            return
        root, machine = Path(self.root), os.environ.get("ANNULUS_MACHINE", platform.machine())
        if machine not in MACHINES:
            raise SystemExit(f"annulus: machine {machine}: expected one of {', '.join(MACHINES)}")
        build = root / "firmware/build" / f"wheel-{machine}"
        build.mkdir(parents=True, exist_ok=True)
        commit = _commit(root)
        about = {"version": self.metadata.version, "commit": commit, "machine": machine}
        (build / "build.json").write_text(json.dumps(about) + "\n")
        made = {build / "build.json": "build.json"}
        made |= {library: library.name for library in libraries(root, machine, build)}
        if os.environ.get("ANNULUS_IMAGE") != "no":
            _run("make", "--silent", "-C", str(root / "firmware"), "image", "rig")
            for image in ("annulus.uf2", "annulus-rp2350.uf2", "rig.uf2"):
                made[root / "firmware/build" / image] = image
        manual = root / "host/annulus_pipe/shipped/manual"
        if manual.is_dir():
            made[manual] = "manual"
        build_data["force_include"] |= {str(source): f"{SHIPPED}/{name}" for source, name in made.items()}
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-manylinux_{GLIBC[0]}_{GLIBC[1]}_{machine}"


def libraries(root: Path, machine: str, build: Path) -> list[Path]:
    """For that machine: the native library, and the loops for its kinds of processor; less what a debugger reads."""
    prefix = "" if machine == platform.machine() else f"{machine}-linux-gnu-"
    _run("make", "--silent", "-C", str(root / "firmware"), "native", f"BUILD={build}", f"CC={prefix}gcc")
    loops = ("-C", str(root / "host/native"), f"BUILD={build}", f"CC={prefix}gcc", f"MACHINE={machine}")
    _run("make", "--silent", *loops)
    slim = build / "slim"
    slim.mkdir(exist_ok=True)
    for made in sorted(build.glob("*.so")):
        _run(f"{prefix}strip", "--strip-debug", "-o", str(slim / made.name), str(made))
        if (newest := glibc_needed(made)) > GLIBC:
            raise SystemExit(f"annulus: {made}: needs glibc {newest[0]}.{newest[1]}, expected at most 2.17")
    return sorted(slim.glob("*.so"))


def glibc_needed(library: Path) -> tuple[int, ...]:
    """The newest version of glibc that a library asks for."""
    said = _run("readelf", "--version-info", "--wide", str(library))
    return max(tuple(map(int, name.split("."))) for name in re.findall(r"Name: GLIBC_([\d.]+)", said))


def _commit(root: Path) -> str:
    if told := os.environ.get("ANNULUS_COMMIT"):
        return told
    if shutil.which("git") is None or not (root / ".git").exists():
        return "unknown"
    return _run("git", "-C", str(root), "rev-parse", "--short=8", "HEAD").strip()


def _run(*command: str) -> str:
    try:
        run = subprocess.run(command, capture_output=True, text=True)
    except FileNotFoundError:
        raise SystemExit(f"annulus: {command[0]}: not found, and a wheel is built with it") from None
    if run.returncode:
        raise SystemExit(f"annulus: {' '.join(command)}: {run.stderr.strip()[-2000:]}")
    return run.stdout
