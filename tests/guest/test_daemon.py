"""The whole daemon at a real camera driver: what is lost is counted; a plug that is pulled ends one scan, not all."""

import json
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from machine import HOST, PYTHON, Guest

from annulus_pipe.controller import PIN_INTERLOCK, PIN_LED, PIN_PROJECTOR, PIN_SYNC, TICK_NS
from annulus_pipe.twin.line import TcpLine
from annulus_pipe.twin.native import NativeBoard

PERIOD = 20_000_000  # ticks: 5 fps, which an emulated machine has time for beside others too
HIGH = 1_000_000  # ticks that frame-sync is high


class Controller(threading.Thread):
    """The firmware on its native board, slaved to the clock, with frame-sync at 5 Hz; offered over TCP."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.line = TcpLine()
        self.port = self.line.url.replace("127.0.0.1", HOST)
        self.flashes = {PIN_PROJECTOR: 0, PIN_LED: 0}
        self.dark = False  # at the end
        self.done = threading.Event()

    def run(self) -> None:
        board = NativeBoard()
        board.power_on(boot=1)
        board.input(1, PIN_INTERLOCK, 0)
        began, edge, unsent = time.monotonic_ns(), PERIOD, b""
        while not self.done.wait(0.001):
            now = (time.monotonic_ns() - began) // TICK_NS
            while edge < now + PERIOD:
                board.input(edge - HIGH, PIN_SYNC, 1)
                board.input(edge, PIN_SYNC, 0)
                edge += PERIOD
            board.serial_write(self.line.read())
            board.run_until(now)
            unsent += board.serial_read()
            unsent = unsent[self.line.write(unsent) :]
            for change in board.pins():
                if change["pin"] in self.flashes and change["level"]:
                    self.flashes[int(change["pin"])] += 1
        self.dark = not (board.level(PIN_PROJECTOR) or board.level(PIN_LED))
        self.line.close()


@pytest.fixture
def controller() -> Iterator[Controller]:
    controller = Controller()
    controller.start()
    yield controller
    controller.done.set()
    controller.join()


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.timeout(600)  # half of it is the daemon's imports
def test_drops_are_counted_and_a_camera_that_goes_and_comes_back_is_used_again(
    guest: Guest, controller: Controller
) -> None:
    guest.modprobe("vivid", "n_devs=2", "node_types=0x1,0x101", "num_inputs=1,1", "input_types=0x0,0x3")
    scan = str(Path(__file__).with_name("scan.py"))
    done = guest.run([str(PYTHON), scan, controller.port, "/tmp/annulus-scan"], seconds=400.0)
    assert done.status == 0, done.stderr
    facts = json.loads(done.stdout)
    said = facts["said"]
    assert facts["operator"] == "" and facts["stopped"] == "idle", said
    assert "/dev/video0: the camera is gone" in said
    assert "/dev/video0: has no ExposureTime to set" in said
    assert "Traceback" not in said

    scans = [scan for scan in facts["scans"] if scan["counts"]]
    assert len(scans) == 1, said
    [scan] = scans
    counts, stamps_ns = scan["counts"], scan["stamps_ns"]
    begun_ns = [stamp - count * PERIOD * TICK_NS for stamp, count in zip(stamps_ns, counts, strict=True)]
    anew = [at for at in range(1, len(counts)) if begun_ns[at] - begun_ns[at - 1] > 10 * PERIOD * TICK_NS]
    assert len(anew) == 1, (counts, said)  # the driver's count began anew
    [again] = anew
    lost = {kind: int(count) for count, kind in re.findall(r"(\d+) (\w+)", re.findall(r"^lost: (.*)$", said, re.M)[-1])}
    missing = 0
    for run in (counts[:again], counts[again:]):
        assert len(run) > 10 and run == sorted(set(run))
        missing += run[-1] - run[0] + 1 - len(run)
    assert 0 < lost["camera"] <= missing <= sum(lost.values())  # every frame was recorded or is in the account
    assert scan["shapes"] == [[180, 320, 3]] and scan["labels"] == ["unknown"]  # no lamp lit what vivid shows
    controller.done.set()
    controller.join()
    assert controller.flashes[PIN_PROJECTOR] > 10 and controller.flashes[PIN_LED] > 2 and controller.dark
