"""`annulus doctor`: what of this machine a head or a reconstruction would stumble over, and what to do about each.

Looks and measures; changes nothing but a file that it writes for the disk's speed and takes away again. A row is right,
wrong, or neither: what only a head needs is not wrong on a machine that has none.
"""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from annulus_pipe.console.access import password_file
from annulus_pipe.daemon.check import CheckRow, check_head, priority
from annulus_pipe.daemon.config import HeadConfig, load_config
from annulus_pipe.doctor.drive import disk
from annulus_pipe.doctor.eyes import cameras
from annulus_pipe.doctor.lines import boards, libusb, ports, rule
from annulus_pipe.doctor.machine import clock, loops, memory, secrets, versions
from annulus_pipe.vocabulary import AnnulusError

__all__ = ["CheckRow", "examine"]


def examine(config: Path | None = None, folder: Path | None = None, root: Path = Path("/")) -> list[CheckRow]:
    """All rows. config : head.toml, whose own parts are then looked at as well, as before a scan. folder : where
    recordings would go; that of head.toml, or the present one. root : of the file system, another in tests.
    """
    head: HeadConfig | None = None
    if config is not None:
        with suppress(AnnulusError):  # the first of its own rows says it
            head = load_config(config)
    where = folder or (head.record_folder if head is not None else None) or Path.cwd()
    looks: tuple[Callable[[], list[CheckRow]], ...] = (
        versions,
        loops,
        lambda: ports(root),
        boards,
        libusb,
        lambda: rule(root),
        lambda: cameras(root),
        lambda: disk(where, head),
        lambda: clock(),
        lambda: memory(root, head),
        lambda: secrets([password_file()]),
    )
    found = [finding for look in looks for finding in look()]
    if config is None:
        found.append(priority(None))
        return found
    return found + check_head(config)
