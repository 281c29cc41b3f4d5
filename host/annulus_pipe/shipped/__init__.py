"""Files that come with the package and are no Python: the native library, the Picos' images, udev rule, units, manual.

They lie in this folder, in a wheel and in a checkout alike: a build puts what it makes here (git ignores it), and
nothing looks for it by a parent's folder. What only a checkout has is asked for here too.
"""

import json
from pathlib import Path

from annulus_pipe.vocabulary import AnnulusError

NATIVE, UDEV, MANUAL = "libannulus_native.so", "99-annulus.rules", "manual"
LOOPS = "loops-"  # of each kind of processor one library of the methods' loops
IMAGE, IMAGE_RP2350 = "annulus.uf2", "annulus-rp2350.uf2"
RIG = "rig.uf2"  # of a second Pico that tests the first
UNIT, CONSOLE_UNIT = "annulus.service", "annulus-console.service"
BUILD = "build.json"  # which version, commit and machine a wheel is of; only a wheel has it
EMULATOR = "tools/emulator/emulate.mjs"
_MADE_BY = {
    NATIVE: "make setup",
    IMAGE: "make firmware",
    IMAGE_RP2350: "make firmware",
    RIG: "make firmware",
    MANUAL: "make docs",
}


_HERE = Path(__file__).parent


def shipped(name: str) -> Path:
    """Where one of them lies. Raises AnnulusError where it is missing, with what makes it."""
    path = _HERE / name
    if not path.exists():
        made = f"In a checkout `{_made_by(name)}` makes it" if _made_by(name) else "It is part of the checkout"
        raise AnnulusError(f"{path}: is missing. {made}; a wheel has it: install annulus again.")
    return path


def _made_by(name: str) -> str:
    return "make setup" if name.startswith(LOOPS) else _MADE_BY.get(name, "")


def is_shipped(name: str) -> bool:
    return (_HERE / name).exists()


def commit() -> str:
    """Of the source that runs, eight digits; of a checkout, as last committed. 'unknown' where nobody can say."""
    if is_shipped(BUILD):
        return str(json.loads((_HERE / BUILD).read_text(encoding="utf-8"))["commit"])
    import subprocess  # by `--version` and by reports

    try:
        asked = ["git", "-C", str(_HERE), "rev-parse", "--short=8", "HEAD"]
        return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def of_checkout(name: str) -> Path:
    """A file that no wheel has, by its path in the checkout. AnnulusError where annulus is installed from one."""
    for folder in _HERE.parents:
        if (folder / "protocol/messages.toml").is_file() and (folder / name).is_file():
            return folder / name
    raise AnnulusError(f"{name}: is part of annulus's source only, and this is an installed one. Run it in a checkout.")
