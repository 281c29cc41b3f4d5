"""Serial ports, the boards behind them, and who may use either."""

import grp
import os
import re
from pathlib import Path

from annulus_pipe.daemon.check import CheckRow
from annulus_pipe.flash import update
from annulus_pipe.flash.image import read_image
from annulus_pipe.flash.picoboot import install_rule
from annulus_pipe.shipped import IMAGE, UDEV, shipped
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

NAMES = re.compile(r"tty(ACM|USB|AMA)\d+|serial\d|annulus-.+")


def ports(root: Path = Path("/")) -> list[CheckRow]:
    """Every serial port that a controller might be on: may it be used, and who has it now?"""
    found = []
    there = sorted(path for path in (root / "dev").glob("*") if NAMES.fullmatch(path.name))
    by_device: dict[Path, list[str]] = {}
    for path in there:
        by_device.setdefault(path.resolve(), []).append(path.name)
    for device, names in by_device.items():
        name = ", ".join(names)
        if not os.access(device, os.R_OK | os.W_OK):
            group = _group(device)
            found.append(
                CheckRow("port", False, f"{name}: no permission: sudo usermod -aG {group} $USER, then log in again")
            )
        elif who := users(device, root):
            found.append(CheckRow("port", None, f"{name}: {who} has it"))
        else:
            found.append(CheckRow("port", True, f"{name}: free"))
    return found or [CheckRow("port", None, "none: no controller is plugged in")]


def users(device: Path, root: Path = Path("/")) -> str:
    """Programs that have it open, of those that this user may look at; empty for none."""
    who = set()
    for link in (root / "proc").glob("[0-9]*/fd/*"):
        try:
            if Path(os.readlink(link)) == device:
                process = link.parent.parent
                who.add(f"{(process / 'comm').read_text().strip()} (process {process.name})")
        except OSError:  # it has ended, or is another user's
            continue
    return ", ".join(sorted(who))


def boards() -> list[CheckRow]:
    """Controllers on USB and whether their firmware is the one that comes with annulus; boot loaders that wait."""
    found = [
        CheckRow("board", None, f"USB {waiting['place']}: in its boot loader: annulus firmware flash")
        for waiting in update.boot_loader_fields()
    ]
    found += [_board(controller.port) for controller in update.find_controllers()]
    return found or [CheckRow("board", None, "none on USB")]


def _board(port: str) -> CheckRow:
    if who := users(Path(port)):
        return CheckRow("board", None, f"{port}: not asked, {who} has it")
    try:
        runs = update.board_fields(port)
        ours = update.image_fields(read_image(shipped(IMAGE)))
    except AnnulusError as error:
        return CheckRow("board", False, str(error))
    if not runs["fits_this_host"]:
        return CheckRow("board", False, f"{port}: cannot talk to this host: `annulus firmware flash` with this port")
    if runs["git"] != ours["git"]:
        text = f"{port}: runs {runs['git']}, annulus has {ours['git']}: `annulus firmware flash` with this port"
        return CheckRow("board", None, text)
    carrier = f" on a {runs['carrier']}" if runs.get("carrier") else ""
    return CheckRow("board", True, f"{port}: runs {runs['git']}, as annulus has it{carrier}")


def rule(root: Path = Path("/")) -> list[CheckRow]:
    """The udev rule that lets people use a board without being root."""
    if not (root / "etc/udev").is_dir():
        return [CheckRow("udev rule", None, "this machine has no udev")]
    ours = shipped(UDEV).read_bytes()
    for folder in ("etc/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d"):
        try:
            if (root / folder / UDEV).read_bytes() == ours:
                return [CheckRow("udev rule", True, f"/{folder}/{UDEV}")]
            return [CheckRow("udev rule", False, f"/{folder}/{UDEV} is of another version: {install_rule()}")]
        except OSError:
            continue
    return [CheckRow("udev rule", None, f"not installed; who flashes or runs a controller needs it: {install_rule()}")]


def libusb() -> list[CheckRow]:
    """The system's library that flashing over USB goes through."""
    from usb.backend import libusb1

    if libusb1.get_backend() is None:
        return [CheckRow("libusb", None, "not here; who flashes over USB needs it: sudo apt install libusb-1.0-0")]
    return [CheckRow("libusb", True, "there")]


def _group(device: Path) -> str:
    try:
        return grp.getgrgid(device.stat().st_gid).gr_name
    except (KeyError, OSError) as error:
        return f"GROUP ({one_line(str(error))})"
