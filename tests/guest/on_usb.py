"""Runs in the guest: what a host does with the controller behind /dev/ttyACM0. `on_usb.py VERB ..`, JSON on stdout."""

import fcntl
import json
import os
import random
import signal
import socket
import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import serial

from annulus_pipe.link import operate
from annulus_pipe.link import port as link_port
from annulus_pipe.link.client import Client
from annulus_pipe.link.codec import Decoder, Frame, encode
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstDone,
    Clear,
    Command,
    Commit,
    Edge,
    Reply,
    Reset,
    Stage,
    Status,
    StatusReply,
)
from annulus_pipe.link.session import EventReceived
from annulus_pipe.vocabulary import AnnulusError, Lamp

TTY = Path("/dev/ttyACM0")
VHCI = Path("/sys/devices/platform/vhci_hcd.0")
DRIVER = Path("/sys/bus/usb/drivers/cdc_acm")
PATIENCE_S = 30.0  # of everything here: the guest is slow, and the board's time slower
link_port.WRITE_S = operate.TRAIN_SLACK_S = PATIENCE_S  # seconds on the wall, while the board's time is slower
MAGIC_RESET = 0x7E5E7B00
USBDEVFS_RESET = 0x5514
FLASHES = 20
PERIOD = 1_000_000  # 10 ms, as the edges come
TRAIN = Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=10_000, trigger_offset=0)


def until(what: Callable[[], Any], why: str) -> Any:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if found := what():
            return found
        time.sleep(0.02)
    raise AssertionError(f"{why}: not within {PATIENCE_S:g} s")


def client() -> Client:
    return Client(str(TTY), timeout_s=PATIENCE_S)


def status(line: Client) -> dict[str, int]:
    reply = line.request(Status(), PATIENCE_S)
    assert isinstance(reply, StatusReply)
    return {"fault": reply.fault, "state": reply.state, "edges": reply.edges, "bad_frames": reply.bad_frames}


def flash(line: Client, *more: Command, outputs: ArmFlag = ArmFlag.LAMPS) -> None:
    """Configure, arm, and see some flashes."""
    if status(line)["fault"]:
        line.request(Clear(), PATIENCE_S)
    stage = Stage(
        generation=1,
        ratio=1,
        frame_period=PERIOD,
        exposure=PERIOD,
        readout=0,
        tolerance=100,
        host_timeout=5000,
        projector_delay=100_000,
        projector_width=400_000,
        led_delay=100_000,
        led_width=400_000,
    )
    for command in (stage, Commit(1), Arm(outputs), *more):
        line.request(command, PATIENCE_S)
    end, count = time.monotonic() + PATIENCE_S, FLASHES
    while count > 0:
        assert time.monotonic() < end, f"{count} flashes are missing"
        line.keep_alive()
        for happening in line.poll(0.1):
            if isinstance(happening, EventReceived) and isinstance(happening.event, Edge):
                count -= happening.event.lamp != Lamp.DARK


def all_on(line: Client) -> None:
    flash(line, TRAIN, outputs=ArmFlag.LAMPS | ArmFlag.MICROWAVE)


def attach(port: str) -> dict[str, Any]:
    """As usbip does: import the device, hand the connection to the kernel, wait for the serial port."""
    until(lambda: _imported(int(port)), "the device is offered")
    until(TTY.exists, "the serial port is there")
    device = Path(os.path.realpath(f"/sys/class/tty/{TTY.name}/device")).parent
    return {
        name: (device / name).read_text().strip() for name in ("manufacturer", "product", "serial", "idVendor", "speed")
    }


def _imported(port: int) -> bool:
    with socket.create_connection(("10.0.2.2", port), timeout=PATIENCE_S) as line:
        line.sendall(struct.pack(">HHI32s", 0x0111, 0x8003, 0, b"1-1"))
        answer = b""
        while len(answer) < 8 or (answer[4:8] == bytes(4) and len(answer) < 320):
            if not (new := line.recv(320 - len(answer))):
                return False
            answer += new
        if answer[4:8] != bytes(4):
            return False
        bus, device, speed = struct.unpack_from(">III", answer, 8 + 288)
        rows = [row.split() for row in (VHCI / "status").read_text().splitlines()[1:]]
        free = next(int(row[1]) for row in rows if row[0] == "hs" and row[2] == "004")
        line.settimeout(None)
        (VHCI / "attach").write_text(f"{free} {line.fileno()} {bus << 16 | device} {speed}")
    return True


def work() -> dict[str, Any]:
    """Status, configure, arm, and a train of bursts to its end."""
    with client() as line:
        before = status(line)
        flash(line)
        line.request(Arm(ArmFlag(0)), PATIENCE_S)
        armed = status(line)["state"]
        reply, done = operate.send_train(line, str(TTY), Burst(BurstCode.SINGLE, 100, 500, 10_000, 0))
        assert isinstance(done, BurstDone)
        return {"before": before, "state": armed, "bursts": done.done, "chips": reply.length}


def raw() -> serial.Serial:
    """The port without our session on it."""
    return serial.Serial(str(TTY), timeout=0.0, write_timeout=PATIENCE_S)


def pipeline(count: str) -> dict[str, Any]:
    """Commands one after the other, whatever has been answered."""
    with client() as line:
        before = status(line)
    heard, damaged, decoder = list[int](), 0, Decoder()
    end = time.monotonic() + PATIENCE_S
    with raw() as port:
        for sent in range(0, int(count) + 1, 20):  # never more under way than the kernel's buffers hold
            while len(heard) < sent - 20 * (sent < int(count)) and time.monotonic() < end:
                for frame in decoder.feed(port.read(4096)):
                    damaged += not isinstance(frame, Frame)
                    if isinstance(frame, Frame) and isinstance(frame.message, Reply):
                        heard.append(frame.sequence)
            if sent < int(count):
                port.write(b"".join(encode(Frame(Status(), (sent + i) % 256)) for i in range(20)))
    with client() as line:
        return {"before": before, "after": status(line), "answered": heard, "damaged": damaged}


def noise(size: str) -> dict[str, Any]:
    rng = random.Random(6)
    with client() as line:
        before = status(line)
    with raw() as port:
        for _ in range(int(size) // 1000):
            port.write(rng.randbytes(1000))
            port.read(4096)
    with client() as line:
        return {"before": before, "after": status(line)}


def reset(port: str) -> dict[str, Any]:
    """The command: the controller leaves the bus, and is there again."""
    with client() as line:
        before = line.identity.boot
        line.request(Reset(MAGIC_RESET), PATIENCE_S)
        until(lambda: not TTY.exists(), "the serial port is gone")
    attach(port)
    return {"before": before, "after": identify()}


def identify() -> dict[str, int]:
    with client() as line:
        return {"boot": line.identity.boot, "cause": line.identity.cause, **status(line)}


def die() -> None:
    with client() as line:
        all_on(line)
        os.kill(os.getpid(), signal.SIGKILL)


def close() -> dict[str, Any]:
    with client() as line:
        all_on(line)
    return {}


def unbind() -> dict[str, Any]:
    """The driver is taken away under an open port, and given back."""
    with client() as line:
        all_on(line)
        interface = os.path.basename(os.path.realpath(f"/sys/class/tty/{TTY.name}/device"))
        (DRIVER / "unbind").write_text(interface)
        said = ""
        try:
            line.request(Status(), 2.0)
        except AnnulusError as error:
            said = str(error)
    (DRIVER / "bind").write_text(interface)
    until(TTY.exists, "the serial port is back")
    return {"said": said, "after": identify()}


def bus_reset() -> dict[str, Any]:
    """As usbreset does."""
    before = identify()
    device = Path(os.path.realpath(f"/sys/class/tty/{TTY.name}/device")).parent
    node = f"/dev/bus/usb/{int((device / 'busnum').read_text()):03}/{int((device / 'devnum').read_text()):03}"
    with open(node, "wb") as file:
        fcntl.ioctl(file, USBDEVFS_RESET, 0)
    until(TTY.exists, "the serial port is there")
    return {"before": before, "after": identify()}


def detach(port: str) -> dict[str, Any]:
    """The plug is pulled while it works, and put in again."""
    with client() as line:
        all_on(line)
        rows = [row.split() for row in (VHCI / "status").read_text().splitlines()[1:]]
        (VHCI / "detach").write_text(next(row[1] for row in rows if row[2] == "006"))
        until(lambda: not TTY.exists(), "the serial port is gone")
    attach(port)
    return identify()


if __name__ == "__main__":
    verb = {
        each.__name__: each
        for each in (attach, work, pipeline, noise, reset, identify, die, close, unbind, bus_reset, detach)
    }[sys.argv[1]]
    print(json.dumps(verb(*sys.argv[2:])))
