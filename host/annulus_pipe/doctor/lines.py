"""Serial ports, the boards behind them, and who may use either."""

import grp
import os
import re
from pathlib import Path

from annulus_pipe.daemon.check import Finding
from annulus_pipe.flash import update
from annulus_pipe.flash.image import read_image
from annulus_pipe.flash.picoboot import install_rule
from annulus_pipe.shipped import IMAGE, UDEV, shipped
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

NAMES = re.compile(r"tty(ACM|USB|AMA)\d+|serial\d|annulus-.+")


def ports(root: Path = Path("/")) -> list[Finding]:
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
                Finding("port", False, f"{name}: no permission: sudo usermod -aG {group} $USER, then log in again")
            )
        elif who := users(device, root):
            found.append(Finding("port", None, f"{name}: {who} has it"))
        else:
            found.append(Finding("port", True, f"{name}: free"))
    return found or [Finding("port", None, "none: no controller is plugged in")]


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


def boards() -> list[Finding]:
    """Controllers on USB and whether their firmware is the one that comes with annulus; boot loaders that wait."""
    found = [
        Finding("board", None, f"USB {waiting['place']}: in its boot loader: annulus firmware flash")
        for waiting in update.boot_loader_fields()
    ]
    found += [_board(controller.port) for controller in update.find_controllers()]
    return found or [Finding("board", None, "none on USB")]


def _board(port: str) -> Finding:
    if who := users(Path(port)):
        return Finding("board", None, f"{port}: not asked, {who} has it")
    try:
        runs = update.board_fields(port)
        ours = update.image_fields(read_image(shipped(IMAGE)))
    except AnnulusError as error:
        return Finding("board", False, str(error))
    if not runs["fits_this_host"]:
        return Finding("board", False, f"{port}: cannot talk to this host: `annulus firmware flash` with this port")
    if runs["git"] != ours["git"]:
        text = f"{port}: runs {runs['git']}, annulus has {ours['git']}: `annulus firmware flash` with this port"
        return Finding("board", None, text)
    carrier = f" on a {runs['carrier']}" if runs.get("carrier") else ""
    return Finding("board", True, f"{port}: runs {runs['git']}, as annulus has it{carrier}")


def rule(root: Path = Path("/")) -> list[Finding]:
    """The udev rule that lets people use a board without being root."""
    if not (root / "etc/udev").is_dir():
        return [Finding("udev rule", None, "this machine has no udev")]
    ours = shipped(UDEV).read_bytes()
    for folder in ("etc/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d"):
        try:
            if (root / folder / UDEV).read_bytes() == ours:
                return [Finding("udev rule", True, f"/{folder}/{UDEV}")]
            return [Finding("udev rule", False, f"/{folder}/{UDEV} is of another version: {install_rule()}")]
        except OSError:
            continue
    return [Finding("udev rule", None, f"not installed; who flashes or runs a controller needs it: {install_rule()}")]


def libusb() -> list[Finding]:
    """The system's library that flashing over USB goes through."""
    from usb.backend import libusb1

    if libusb1.get_backend() is None:
        return [Finding("libusb", None, "not here; who flashes over USB needs it: sudo apt install libusb-1.0-0")]
    return [Finding("libusb", True, "there")]


def _group(device: Path) -> str:
    try:
        return grp.getgrgid(device.stat().st_gid).gr_name
    except (KeyError, OSError) as error:
        return f"GROUP ({one_line(str(error))})"
