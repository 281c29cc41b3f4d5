"""Promises of the systemd units: what runs unattended may do what a head needs, and nothing else."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from annulus_pipe.shipped import CONSOLE_UNIT, UNIT, shipped

EXPOSURE_MAX = 35  # tenths; systemd calls below 4 "OK". 19 and 14 are measured (systemd 252), 89 without confinement
NEEDED = ("video4linux", "media", "dma_heap", "ttyACM", "ttyUSB", "ttyAMA", "ttyS", "usb_device", "i2c")


@pytest.mark.parametrize("name", [UNIT, CONSOLE_UNIT])
def test_a_unit_is_confined(name: str) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs Debian's systemd")
    asked = ["systemd-analyze", "security", "--offline=true", f"--threshold={EXPOSURE_MAX}", str(shipped(name))]
    ran = subprocess.run(asked, capture_output=True, text=True)
    assert ran.returncode == 0, "\n".join(line for line in ran.stdout.splitlines() if "✓" not in line)
    said = ran.stderr + ran.stdout
    assert "Unknown" not in said and "Failed to parse" not in said and "ignoring" not in said, said


def settings(name: str) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for key, value in re.findall(r"^(\w+)=(.*)$", shipped(name).read_text(encoding="utf-8"), re.MULTILINE):
        found.setdefault(key, []).append(value)
    return found


def test_the_daemon_has_its_devices_and_its_priority() -> None:
    unit = settings(UNIT)
    assert {f"char-{name} rw" for name in NEEDED} <= set(unit["DeviceAllow"])
    assert unit["LimitRTPRIO"] == ["20"] and "RestrictRealtime" not in unit, "SCHED_FIFO for frames and labels"
    assert "AF_NETLINK" in unit["RestrictAddressFamilies"][0], "libcamera and libusb hear what is plugged in"
    assert "PrivateDevices" not in unit and "PrivateNetwork" not in unit
    refused = [one for one in unit["SystemCallFilter"] if one.startswith("~")]
    assert refused == ["~@privileged"], "@resources holds sched_setscheduler"


def test_the_page_has_no_device_and_no_network_but_this_machines() -> None:
    unit = settings(CONSOLE_UNIT)
    assert unit["PrivateDevices"] == ["yes"] and "DeviceAllow" not in unit
    assert unit["IPAddressDeny"] == ["any"] and unit["IPAddressAllow"] == ["localhost"]
    assert unit["RestrictRealtime"] == ["yes"] and "LimitRTPRIO" not in unit


def test_the_manual_installs_what_is_shipped() -> None:
    manual = (Path(__file__).parents[3] / "docs/manual/install.md").read_text(encoding="utf-8")
    assert all(name in manual for name in (UNIT, CONSOLE_UNIT))
