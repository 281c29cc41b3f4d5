"""What a scan's labels followed from, who and what made it, and what was lost of it, into the recording: `/evidence`,
`/identity`, `/drops`.

Rows go out several at a time, for every message costs the recorder's index some memory. `first` counts them through,
so that a reader knows what is missing, and each `/identity` says how many there were by then. Where rows are missing
z is not known any more, so every minute there is a row of the odometer's state, from which it is. 17 to 35 kB/s at
25 fps, a thousandth of the frames.
"""

import importlib.metadata
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from functools import cache
from typing import Any

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.labelling.evidence import Row
from annulus_pipe.labelling.labelling import CameraMode
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.link.head import HeadControl
from annulus_pipe.link.messages import Configuration
from annulus_pipe.record.frames import DROPS_TOPIC, EVIDENCE, IDENTITY

FLUSH_S = 0.25  # a kill costs so much
ROWS_MAX = 200  # of one message
IDENTITY_S = 60.0  # between two looks at the wall clock

Note = Callable[[str, Mapping[str, Any]], None]


class Evidence:
    """Of one scan; `note` is its recorder's."""

    def __init__(
        self,
        note: Note,
        navigation: Navigation,
        account: Account,
        config: HeadConfig,
        modes: Sequence[CameraMode],
        head: HeadControl | None,
    ) -> None:
        self._note, self._navigation, self._account = note, navigation, account
        self._config, self._modes, self._head = config, modes, head
        self._rows: list[Row] = []
        self._first = 0  # number of the first of them
        self._drops: dict[str, int] = {}
        self._controller: Mapping[str, Any] | None = None
        self._recorders = 0  # that were replaced
        self._next_flush_s = self._next_identity_s = 0.0
        self._configuration_crc: int | None = None  # of what was read back last
        navigation.write_down(self._append)
        self.identify("start")

    def turn(self, now_s: float) -> None:
        """Now and then: what has gathered goes out."""
        if now_s < self._next_flush_s and len(self._rows) < ROWS_MAX:
            return
        self._next_flush_s = now_s + FLUSH_S
        drops = self._account.drops
        if drops != self._drops:
            new = {kind: count - self._drops.get(kind, 0) for kind, count in drops.items()}
            self._note(DROPS_TOPIC, {"new": {kind: count for kind, count in new.items() if count}, "all": drops})
            self._drops = drops
            self._navigation.journal.note("drops", host_ns=time.monotonic_ns(), **drops)
        if drops.get("recorders_replaced", 0) != self._recorders:
            self._recorders = drops["recorders_replaced"]
            self._navigation.write_down(self._append)  # the new file begins with what is known
            self.identify("another recorder")
        why = "controller" if self._controller != self._at_the_line() else "minute"
        if why == "controller" or now_s >= self._next_identity_s:
            self.identify(why)
            self._navigation.remember()
        self._flush()

    def identify(self, why: str) -> None:
        """Who and what is at work, and what time it is."""
        self._next_identity_s = time.monotonic() + IDENTITY_S
        self._controller = self._at_the_line()
        cameras = [
            {**asdict(wanted), "encoding": mode.encoding, "gives": [mode.width, mode.height]}
            for mode, wanted in zip(self._modes, self._config.cameras, strict=True)
        ]
        before_ns = time.monotonic_ns()
        utc_ns = time.time_ns()
        body = {
            "why": why,
            "host_ns": (before_ns + time.monotonic_ns()) // 2,
            "utc_ns": utc_ns,
            "utc": datetime.fromtimestamp(utc_ns / 1e9, UTC).isoformat(timespec="milliseconds"),
            "controller": self._controller,
            "cameras": cameras,
            "job": self._config.job.to_dict(),
            "versions": versions(),
            "evidence_rows": self._first + len(self._rows),
        }
        self._note(IDENTITY, body)

    def close(self) -> None:
        """The scan is over."""
        self._navigation.write_down(None)
        self.identify("end")
        self._flush()

    def _append(self, row: Row) -> None:
        if row["what"] == "answer" and row["to"] == Configuration.__name__:
            self._configuration_crc = row.get("crc")
        self._rows.append(row)

    def _at_the_line(self) -> dict[str, Any] | None:
        who = controller_identity(self._head)
        return None if who is None else {**who, "configuration_crc": self._configuration_crc}

    def _flush(self) -> None:
        if self._rows:
            self._note(EVIDENCE, {"first": self._first, "rows": list(self._rows)})
            self._first += len(self._rows)
            self._rows.clear()


def controller_identity(head: HeadControl | None) -> dict[str, Any] | None:
    """What the controller says of itself; None without one, or before it has said anything."""
    if head is None or head.identity is None:
        return None
    who, info = head.identity, head.session.info
    out = {
        "board": _text(who.board),
        "git": _text(who.git),
        "protocol": who.protocol,
        "schema": f"{who.schema:08x}",
        "boot": who.boot,
        "epoch": head.boot_epoch,
    }
    if info is not None:
        out |= {
            "version": f"{info.major}.{info.minor}.{info.patch}",
            "serial": _text(info.serial),
            "level": info.level,
            "nonce": info.nonce,
        }
    return out


@cache
def versions() -> dict[str, str]:
    """Of what runs here, whatever is installed meanwhile, and where no file can be opened any more."""
    return {
        "annulus": importlib.metadata.version("annulus-pipe"),
        "python": platform.python_version(),
        "kernel": platform.release(),
        "machine": platform.machine(),
    }


def _text(ascii_bytes: bytes) -> str:
    return ascii_bytes.rstrip(b"\0").decode("ascii", "replace")
