"""Runs in the guest: the daemon with vivid as its camera and a controller on the host. Facts on stdout, in JSON.

    python scan.py PORT FOLDER     PORT: the controller's, for pyserial

An operator's thread drops frames, pulls the camera's plug while a scan runs, and puts it back.
"""

import contextlib
import io
import json
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from annulus_pipe.capture import videodev
from annulus_pipe.daemon import run_daemon
from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.daemon.state import State
from annulus_pipe.record.recording import open_recording
from annulus_pipe.vocabulary import AnnulusError

STEP_S = 100.0  # the longest thing an operator waits for: a recorder that comes up
DEVICE, DROPPED, DISCONNECT = "/dev/video0", 0x00F0_F040, 0x00F0_F041
HEAD = """
[controller]
port = "{port}"
[camera]
device = "{device}"
format = "YUYV"
width = 320
height = 180
fps = 5
exposure_us = 198000
[record]
folder = "."
min_free_gb = 0
reserve_mb = 0
[control]
address = "ipc://{folder}/control"
autostart = false
"""


def main() -> None:
    port, folder = sys.argv[1], Path(sys.argv[2])
    folder.mkdir()
    (folder / "head.toml").write_text(HEAD.format(port=port, device=DEVICE, folder=folder))
    facts: dict[str, Any] = {"operator": ""}
    said = io.StringIO()
    operator = threading.Thread(target=operate, args=(f"ipc://{folder}/control", said, facts), daemon=True)
    with contextlib.redirect_stderr(said):
        operator.start()
        run_daemon(folder / "head.toml")
    facts["said"] = said.getvalue()
    facts["scans"] = []
    for path in sorted(folder.glob("*.mcap")):
        recording = open_recording(path)
        labels = [recording.label(frame) for frame in recording.frames]
        facts["scans"].append(
            {
                "counts": [label["sequence"] for label in labels],
                "stamps_ns": [label["timestamp_ns"] for label in labels],
                "labels": sorted({label["label"] for label in labels}),
                "shapes": sorted({recording.read(frame).shape for frame in recording.frames}),
            }
        )
    json.dump(facts, sys.stdout)


def operate(address: str, said: io.StringIO, facts: dict[str, Any]) -> None:
    """Ends the daemon, whatever happens."""

    def is_idle() -> bool:
        with contextlib.suppress(AnnulusError):
            return head.state() is State.IDLE
        return False

    def unknown() -> int:
        return int((re.findall(r"(\d+) unknown;", said.getvalue()) or [0])[-1])

    def frames_beyond(count: int) -> Callable[[], bool]:
        return lambda: unknown() > count

    try:
        with ControlClient(address) as head:
            until(is_idle)
            head.start()
            until(frames_beyond(20))
            camera(DROPPED, 30)
            until(frames_beyond(40))
            camera(DROPPED, 0)
            held = videodev.Device(DEVICE)  # while somebody has it open, vivid does not come back
            held.call(videodev.S_CTRL, videodev.Control(DISCONNECT, 1))
            until(lambda: "the camera is gone" in said.getvalue())
            held.close()
            until(lambda: "is back after" in said.getvalue())  # frames from before may still be counted until then
            until(frames_beyond(unknown() + 30))  # the scan goes on with it
            facts["stopped"] = str(head.stop())
    except Exception as error:
        facts["operator"] = f"{type(error).__name__}: {error}"
    os.kill(os.getpid(), signal.SIGINT)


def until(come: Callable[[], bool]) -> None:
    end = time.monotonic() + STEP_S
    while not come():
        if time.monotonic() > end:
            raise AnnulusError(f"a step takes over {STEP_S:g} s")
        time.sleep(0.1)


def camera(control: int, value: int) -> None:
    device = videodev.Device(DEVICE)
    device.call(videodev.S_CTRL, videodev.Control(control, value))
    device.close()


if __name__ == "__main__":
    main()
