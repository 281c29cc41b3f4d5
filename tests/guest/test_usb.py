"""The image's USB device under a real kernel: its vhci-hcd enumerates the emulated UF2 over USB/IP, its cdc_acm has the
port, and our own host works on that. What leaves the gates is read at the emulator's pins.
"""

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from emulated import MS, made_image
from machine import PYTHON, Guest
from served import Served

from annulus_pipe.controller import PIN_LED, PIN_MICROWAVE, PIN_PROJECTOR
from annulus_pipe.link.messages import BootCause, FaultCode, StateFlag

GUEST_SIDE = Path(__file__).with_name("on_usb.py")
LINE_STATE_OFF = bytes.fromhex("2122000000000000")  # DTR and RTS dropped
GONE = b""
DARK = MS // 2  # from what the kernel says on the bus to every gate low: a round of the main loop or two


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    with Served(made_image()) as served:
        yield served


@pytest.fixture(scope="module")
def attached(guest: Guest, served: Served) -> dict[str, Any]:
    guest.modprobe("vhci-hcd")
    guest.modprobe("cdc-acm")
    return on_guest(guest, "attach", served.port)


def on_guest(guest: Guest, verb: str, *arguments: object, status: int = 0) -> dict[str, Any]:
    done = guest.run([str(PYTHON), str(GUEST_SIDE), verb, *map(str, arguments)], seconds=120.0)
    assert done.status == status, f"{verb}: {done.stdout}{done.stderr}\n{guest.log[-2000:]}"
    return json.loads(done.stdout) if done.stdout else {}


def assert_dark_after(served: Served, since: int, what: bytes) -> None:
    """Lamps and microwave worked until the kernel said this, and then nothing is high any more, edges or not."""
    tick = next(tick for tick, setup in served.requests(since) if setup == what)
    served.run(50 * MS)
    changes = served.changes(since)
    for pins in ({PIN_PROJECTOR, PIN_LED}, {PIN_MICROWAVE}):
        assert any(tick - 30 * MS < when < tick for when, pin, _ in changes if pin in pins)
    last = max(when for when, _, _ in changes)
    levels = {pin: level for _, pin, level in changes}
    print(f"the last change {(last - tick) / MS:.2f} ms after it")
    assert not any(levels.values())
    assert last < tick + DARK


def test_the_kernel_finds_what_the_device_says_it_is(attached: dict[str, Any]) -> None:
    assert attached == {
        "manufacturer": "annulus",
        "product": "annulus controller",
        "serial": "E6616408438A1C2F",
        "idVendor": "2e8a",
        "speed": "12",
    }


@pytest.mark.usefixtures("attached")
def test_our_host_configures_arms_and_fires_through_cdc_acm(guest: Guest, served: Served) -> None:
    since = served.now
    found = on_guest(guest, "work")
    assert found["before"]["fault"] == FaultCode.NONE
    assert not found["state"] & (StateFlag.LAMPS_ARMED | StateFlag.MICROWAVE_ARMED)
    assert found["bursts"] == 500
    rises = [(tick, pin) for tick, pin, level in served.changes(since) if level]
    bursts = [tick for tick, pin in rises if pin == PIN_MICROWAVE][-500:]
    assert {after - before for before, after in pairwise(bursts)} == {10_000}
    lamps = [pin for _, pin in rises if pin in (PIN_PROJECTOR, PIN_LED)]
    assert len(lamps) >= 20
    assert all(one != other for one, other in pairwise(lamps))  # ratio 1: in turn


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.usefixtures("attached")
def test_two_thousand_pipelined_commands_are_answered_once_and_in_order(guest: Guest) -> None:
    found = on_guest(guest, "pipeline", 2000)
    assert found["answered"] == [i % 256 for i in range(2000)]
    assert (found["damaged"], found["after"]["bad_frames"]) == (0, found["before"]["bad_frames"])


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.usefixtures("attached")
def test_half_a_megabyte_of_noise_leaves_it_answering(guest: Guest, served: Served) -> None:
    found = on_guest(guest, "noise", 500_000)
    assert found["after"]["bad_frames"] > found["before"]["bad_frames"]
    assert found["after"]["fault"] == found["before"]["fault"]
    assert served.resets == []


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.usefixtures("attached")
def test_a_port_closed_while_armed_goes_dark_at_once(guest: Guest, served: Served) -> None:
    since = served.now
    on_guest(guest, "close")
    assert_dark_after(served, since, LINE_STATE_OFF)


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.usefixtures("attached")
def test_a_host_killed_while_armed_leaves_it_dark(guest: Guest, served: Served) -> None:
    since = served.now
    on_guest(guest, "die", status=-9)
    assert_dark_after(served, since, LINE_STATE_OFF)
    assert on_guest(guest, "identify")["fault"] == FaultCode.HOST_TIMEOUT


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.usefixtures("attached")
def test_a_driver_unbound_while_armed_leaves_it_dark(guest: Guest, served: Served) -> None:
    since = served.now
    found = on_guest(guest, "unbind")
    assert "the line went away" in found["said"]
    assert_dark_after(served, since, LINE_STATE_OFF)
    assert found["after"]["fault"] == FaultCode.HOST_TIMEOUT


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.usefixtures("attached")
def test_the_kernels_reset_of_the_device_is_survived(guest: Guest, served: Served) -> None:
    found = on_guest(guest, "bus_reset")
    assert found["before"]["boot"] == found["after"]["boot"]
    assert served.resets == []


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.usefixtures("attached")
def test_a_detached_device_goes_dark_and_can_be_attached_again(guest: Guest, served: Served) -> None:
    since = served.now
    found = on_guest(guest, "detach", served.port)
    assert_dark_after(served, since, GONE)
    assert found["fault"] == FaultCode.HOST_TIMEOUT


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.usefixtures("attached")
def test_a_restarted_controller_is_found_again(guest: Guest, served: Served) -> None:
    found = on_guest(guest, "reset", served.port)
    after = found["after"]
    assert (after["boot"], after["cause"]) == ((found["before"] + 1) % 256, BootCause.HOST_RESET)
    assert len(served.resets) == 1
