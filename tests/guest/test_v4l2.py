"""The V4L2 camera at a real driver: the kernel's vivid, which can also drop, lie, break and vanish.

The camera of before, through OpenCV, opened no V4L2 device at all: seen here as "cannot be opened as a V4L2 camera.
In use, or no permission?" where these tests take frames.
"""

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from machine import PYTHON, Guest

MS = 1_000_000
PERIOD = 40 * MS  # 25 fps
JITTER = 100 * MS  # of a stamp, where QEMU comes late on a busy machine; a frame of another moment is off by more
BARS = [(r * 191, g * 191, b * 191) for g in (1, 0) for r in (1, 0) for b in (1, 0)]  # white .. black, vivid's 75 %


@pytest.fixture(scope="module")
def vivid(guest: Guest) -> Guest:
    guest.modprobe("vivid", "n_devs=2", "node_types=0x1,0x101", "num_inputs=1,1", "input_types=0x0,0x3")
    return guest


def chapter(guest: Guest, name: str) -> dict[str, Any]:
    done = guest.run([str(PYTHON), str(Path(__file__).with_name("vivid.py")), name], seconds=200.0)
    assert done.status == 0, done.stderr + guest.log[-2000:]
    facts: dict[str, Any] = json.loads(done.stdout)
    return facts


@pytest.fixture(scope="module")
def refusals(vivid: Guest) -> dict[str, str]:
    return chapter(vivid, "refusals")


@pytest.fixture(scope="module")
def streaming(vivid: Guest) -> dict[str, Any]:
    return chapter(vivid, "streaming")


@pytest.fixture(scope="module")
def going(vivid: Guest) -> dict[str, Any]:
    return chapter(vivid, "going")


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
@pytest.mark.parametrize(
    ("what", "said"),
    {
        "absent": "/dev/video77: no such camera. `ls /dev/video*` lists the devices.",
        "plain file": "not a camera but a file or folder",
        "folder": "/dev: not a camera but a file or folder",
        "other device": "/dev/null: not a camera: no V4L2 device",
        "output": "/dev/video2: not a camera: vivid gives no video here",
        "permission": "/dev/video0: no permission.",
        "busy": "/dev/video0: in use by another program",
        "busy, same settings": "/dev/video0: in use by another program",
        "format unread": "AR24 is not read, expected one of YU12, ",
        "format not offered": "offers no MJPG, expected one of YUYV, ",
        "size": "gives 1920x1080 where 1664x1232 was asked for; YU12 comes in 320x180, 640x360, 640x480, 1280x720,",
        "rate": "frame rate is 25, expected 24; 640x360 YU12 comes at 1, 2, 4, 5, 10, 12.5, 15, 25, 30, 40",
        "hdmi rate": "/dev/video1: frame rate is 60, expected 25; 1664x1232 YU12 comes at 60",
        "no buffers": "does not begin to stream (",
        "no start": "does not begin to stream (",
    }.items(),
)
def test_what_cannot_be_used_says_why_in_one_line(refusals: dict[str, str], what: str, said: str) -> None:
    assert said in refusals[what] and "\n" not in refusals[what]


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_a_refusal_leaves_nothing_behind(refusals: dict[str, str]) -> None:
    assert refusals["afterwards"] == "(360, 640, 3)"


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_every_format_gives_the_same_colours(vivid: Guest) -> None:
    facts = chapter(vivid, "formats")
    bars = facts["bars"]
    assert (
        {"YUYV", "YU12", "NV12", "GREY", "RGB3", "RGGB", "BA81"}
        < set(bars)
        <= {name for fourcc in facts["offered"] for name in (fourcc, f"{fourcc}, full range", f"{fourcc}, BT.709")}
    )
    wrong = {}
    for name, seen in bars.items():
        for (red, green, blue), got in zip(BARS, seen, strict=True):
            match name:
                case "GREY":
                    meant = [0.2126 * red + 0.7152 * green + 0.0722 * blue]
                case "RGGB":
                    meant = [red]  # of a mosaic the cell that was looked at, the first
                case "BA81":
                    meant = [blue]
                case "GBRG" | "GRBG":
                    meant = [green]
                case _:
                    meant = [blue, green, red]
            got = got if isinstance(got, list) else [got]
            if max(abs(a - b) for a, b in zip(got, meant, strict=True)) > 4:  # of 255; vivid rounds its own too
                wrong[name] = (got, meant)
    assert not wrong


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_our_size_and_rate_from_a_signal_in_television_colours(vivid: Guest) -> None:
    facts = chapter(vivid, "our_size")
    assert facts["shape"] == [1232, 1664, 3]
    in_step(facts)
    for (red, green, blue), got in zip(BARS, facts["bars"], strict=True):
        assert max(abs(a - b) for a, b in zip(got, (blue, green, red), strict=True)) <= 4


def in_step(facts: dict[str, Any]) -> None:
    """Each frame is stamped when the driver's count says it was taken, and none of the future."""
    stamps, counts = facts["stamps"], facts["counts"]
    assert all(a < b for a, b in pairwise(stamps)) and all(a < b for a, b in pairwise(counts))
    assert all(abs(s - stamps[0] - (n - counts[0]) * PERIOD) < JITTER for s, n in zip(stamps, counts, strict=True))
    assert stamps[-1] < facts["now"] + PERIOD


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_frames_are_counted_and_stamped_by_the_driver_on_the_monotonic_clock(streaming: dict[str, Any]) -> None:
    plain = streaming["plain"]
    in_step(plain)
    assert plain["began"] <= plain["stamps"][0]


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_frames_that_waited_in_a_pause_keep_their_own_stamps(streaming: dict[str, Any]) -> None:
    paused = streaming["after a pause"]
    in_step(paused)
    old = [stamp for stamp in paused["stamps"] if stamp < paused["resumed"] - 500 * MS]
    assert 1 <= len(old) <= 4  # the driver's buffers
    assert paused["counts"][len(old)] - paused["counts"][len(old) - 1] > 10  # and the hole behind them is counted


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_after_a_stop_nothing_old_comes(streaming: dict[str, Any]) -> None:
    again = streaming["after a stop"]
    in_step(again)
    assert again["began"] <= again["stamps"][0]


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_dropped_frames_are_holes_in_the_count(streaming: dict[str, Any]) -> None:
    dropped = streaming["half dropped"]
    in_step(dropped)
    assert dropped["counts"][-1] - dropped["counts"][0] >= len(dropped["counts"])


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_a_silent_camera_times_out_at_rest_and_goes_on(streaming: dict[str, Any]) -> None:
    silent = streaming["all dropped"]
    assert silent["said"] == "TimeoutError: /dev/video0: no whole frame within 2000 ms"
    assert silent["seconds"] > 1.9 and silent["cpu"] < 0.5 * silent["seconds"]
    in_step(streaming["mended"])


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_stamps_of_another_clock_are_refused(streaming: dict[str, Any]) -> None:
    assert "ahead of CLOCK_MONOTONIC" in streaming["other clock"]["said"]


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_a_rate_that_is_not_the_one_promised_is_found_out(streaming: dict[str, Any]) -> None:
    said = streaming["another rate"]["said"]
    assert re.fullmatch(r"AnnulusError: /dev/video0: frames come at 1[45]\.\d fps, expected 25", said)


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_controls_are_read_back(streaming: dict[str, Any]) -> None:
    said = streaming["controls"]
    assert (said["automatic off"], said["automatic read"]) == ("", "0")  # its own gain would wander
    assert (said["gain"], said["gain read"]) == ("", "77")
    assert said["gain too high"].endswith(
        "gain is 255, expected 9000 (in the device's own unit); it takes 0 to 255 in steps of 1"
    )
    assert said["exposure"].startswith("NoSuchControl: /dev/video0: has no ExposureTime")
    assert (said["same rate"], said["other rate"]) == ("", "")
    assert "frame rate is 30, expected 27.027" in said["no such rate"]


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_a_device_that_breaks_or_goes_is_one_error_at_once_and_its_return_is_a_start(going: dict[str, Any]) -> None:
    assert going["broken"]["said"] == "AnnulusError: /dev/video0: stopped streaming (Input/output error)"
    in_step(going["started again"])
    assert going["gone"]["said"] == "AnnulusError: /dev/video0: the camera is gone"
    assert going["while gone"] == "/dev/video0: no such camera: it was unplugged, or has no driver"
    assert max(going[name]["seconds"] for name in ("broken", "gone")) < 2.0
    in_step(going["back"])


@pytest.mark.deep(gate="tests/unit/capture/test_opencv.py::test_a_frame_has_the_drivers_stamp_its_arrival_and_no_count")
def test_through_opencv_frames_have_the_drivers_stamps_and_no_count(vivid: Guest) -> None:
    facts = chapter(vivid, "opencv")
    assert "OpenCV does not open it" in facts["absent"]
    assert "expected YU12 1664x1232 at 25" in facts["size"] and "expected MJPG 640x360 at 25" in facts["format"]
    assert facts["shape"] == "(360, 640, 3)" and not facts["counted"]
    assert all(0 <= late < PERIOD + JITTER for late in facts["late_ns"])
    assert all(
        step > 0 for step in facts["steps_ns"]
    )  # the driver may lose some on a busy machine, and no count shows it
    assert abs(sorted(facts["steps_ns"])[len(facts["steps_ns"]) // 2] - PERIOD) < PERIOD // 4
    assert "gone" in facts["gone"] or "no frame within" in facts["gone"]
