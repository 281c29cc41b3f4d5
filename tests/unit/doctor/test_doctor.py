"""What a machine lacks is told with what to do about it, and what it has no use for is not called wrong."""

import errno
import itertools
import json
import os
import struct
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from annulus_pipe import doctor
from annulus_pipe.cli.app import app
from annulus_pipe.daemon import cameras as daemon_cameras
from annulus_pipe.daemon.check import CheckRow
from annulus_pipe.doctor import drive, lines, machine
from annulus_pipe.doctor.drive import disk
from annulus_pipe.doctor.eyes import cameras
from annulus_pipe.doctor.lines import ports, rule, users
from annulus_pipe.doctor.machine import clock, loops, memory
from annulus_pipe.numeric import native
from annulus_pipe.shipped import UDEV, shipped
from annulus_pipe.vocabulary import AnnulusError

MB = 1e6


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A file system with a port, a camera and a sensor, none of them real."""
    for folder in (
        "dev",
        "proc/77/fd",
        "sys/class/video4linux/video0",
        "sys/module/imx477/parameters",
        "etc/udev/rules.d",
    ):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "dev/ttyACM0").touch()
    (tmp_path / "dev/annulus-E6614").symlink_to("ttyACM0")
    (tmp_path / "dev/video0").touch()
    (tmp_path / "dev/tty1").touch()
    (tmp_path / "proc/77/comm").write_text("minicom\n")
    (tmp_path / "proc/meminfo").write_text("MemTotal: 4000000 kB\nMemAvailable:  3000000 kB\n")
    (tmp_path / "sys/class/video4linux/video0/name").write_text("vivid\n")
    (tmp_path / "sys/module/imx477/parameters/trigger_mode").write_text("0\n")
    return tmp_path


def rows(found: list[CheckRow]) -> dict[str, tuple[bool | None, str]]:
    return {one.what: (one.ok, one.text) for one in found}


def test_a_port_is_named_once_by_all_its_names_and_with_who_has_it(root: Path) -> None:
    assert ports(root) == [CheckRow("port", True, "annulus-E6614, ttyACM0: free")]
    (root / "proc/77/fd/5").symlink_to((root / "dev/ttyACM0").resolve())
    assert users((root / "dev/ttyACM0").resolve(), root) == "minicom (process 77)"
    assert ports(root) == [CheckRow("port", None, "annulus-E6614, ttyACM0: minicom (process 77) has it")]


def test_without_permission_the_group_is_named(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(lines, "_group", lambda _: "dialout")
    (found,) = ports(root)
    assert found.ok is False and "sudo usermod -aG dialout $USER" in found.text
    assert rows(cameras(root))["camera"] == (False, "/dev/video0: vivid: no permission: sudo usermod -aG video $USER")


def test_no_port_and_no_board_are_nothing_wrong(tmp_path: Path) -> None:
    assert ports(tmp_path)[0].ok is None
    assert [one.ok for one in lines.boards()] == [None]


@pytest.mark.parametrize(
    ("runs", "fits", "ok", "says"),
    [
        ("cafe0001", True, None, "runs cafe0001, annulus has beef0002: `annulus firmware flash` with this port"),
        ("beef0002", True, True, "runs beef0002, as annulus has it"),
        ("beef0002", False, False, "cannot talk to this host"),
    ],
)
def test_a_boards_firmware_is_held_against_the_image(
    runs: str, fits: bool, ok: bool | None, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lines.update, "board_fields", lambda _: {"git": runs, "fits_this_host": fits})
    monkeypatch.setattr(lines, "read_image", lambda _: None)
    monkeypatch.setattr(lines.update, "image_fields", lambda _: {"git": "beef0002"})
    found = lines._board("/dev/ttyACM9")
    assert found.ok is ok and says in found.text


def test_the_rule_is_there_or_another_versions_or_not(root: Path) -> None:
    assert rule(root)[0].ok is None and "sudo cp" in rule(root)[0].text
    (root / "etc/udev/rules.d" / UDEV).write_text("# old\n")
    assert rule(root)[0].ok is False
    (root / "etc/udev/rules.d" / UDEV).write_bytes(shipped(UDEV).read_bytes())
    assert rule(root) == [CheckRow("udev rule", True, f"/etc/udev/rules.d/{UDEV}")]


def test_a_sensor_that_does_not_lead_is_told(root: Path) -> None:
    ok, text = rows(cameras(root))["frame sync"]
    assert ok is False and text.startswith("imx477: trigger_mode 0")
    (root / "sys/module/imx477/parameters/trigger_mode").write_text("1\n")
    assert rows(cameras(root))["frame sync"][0] is True


class Picamera2:
    """As much of it as is asked."""

    sensor_modes = ({"size": (2028, 1520), "fps": 40.01}, {"size": (4056, 3040), "fps": 10.0})

    @staticmethod
    def global_camera_info() -> list[dict[str, str]]:
        return [{"Model": "imx477"}, {"Model": "ov9281"}]

    def __init__(self, number: int) -> None:
        if number == 1:
            raise RuntimeError("Failed to acquire camera: Device or resource busy")

    def close(self) -> None:
        pass


def test_a_pis_cameras_say_their_modes_unless_another_program_has_them(tmp_path: Path) -> None:
    free, taken = cameras(tmp_path, lambda: Picamera2)
    assert free == CheckRow("camera", True, "0: imx477 by Picamera2: 2028x1520 at 40 fps, 4056x3040 at 10 fps")
    assert taken.ok is None and "another program has it" in taken.text


def test_on_a_pi_picamera2_must_be_there_and_its_own_stages_are_no_cameras(root: Path) -> None:
    def none() -> Any:
        raise AnnulusError("camera: picamera2 is not installed for this Python")

    assert rows(cameras(root, none))["picamera2"][0] is None
    (root / "proc/device-tree").mkdir()
    (root / "proc/device-tree/model").write_text("Raspberry Pi 5 Model B Rev 1.0\0")
    (root / "sys/class/video4linux/video0/name").write_text("rp1-cfe-csi2_ch0\n")
    found = rows(cameras(root, none))
    assert found["picamera2"][0] is False
    assert found["camera"] == (None, "none on this machine")


def test_picamera2_built_for_an_older_numpy_is_one_line_that_says_what_mends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    why = (
        "numpy.dtype size changed, may indicate binary incompatibility. Expected 96 from C header, got 88 from PyObject"
    )
    (tmp_path / "picamera2.py").write_text(f"raise ValueError({why!r})")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "picamera2", raising=False)
    with pytest.raises(AnnulusError, match=r"does not load beside numpy 2.*make setup EXTRAS=pi$"):
        daemon_cameras.picamera2()


@pytest.mark.parametrize(("rate", "ok"), [(400 * MB, True), (60 * MB, False)])
def test_a_disk_is_held_against_the_frames_that_come(
    rate: float, ok: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drive, "speed", lambda *_: rate)
    monkeypatch.setattr(drive, "free_bytes", lambda _: 100_000_000_000)
    speed, free = disk(tmp_path / "not yet there")
    assert speed.ok is ok
    assert f"{rate / 1.5 / 2.050048e6:.0f} fps of 2.1 MB" in speed.text
    assert free == CheckRow("free space", True, f"{tmp_path / 'not yet there'}: 100.0 GB, 0.5 h at 51 MB/s")


def test_the_disk_is_measured_and_nothing_left_on_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert drive.speed(tmp_path, 8_000_000) > MB
    assert not list(tmp_path.iterdir())

    def full(*_: Any) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    assert disk(tmp_path)[0] == CheckRow(
        "disk", False, f"{tmp_path}: cannot be written (No space left on device). Choose another folder."
    )
    assert not list(tmp_path.iterdir())


def test_a_clock_that_jumps_or_was_never_set_is_told() -> None:
    now = 1_900_000_000_000_000_000
    steady = lambda: now  # noqa: E731
    assert clock(steady, lambda: 0, lambda: True, 0.0)[0].ok is True
    assert clock(steady, lambda: 0, lambda: False, 0.0)[0].ok is None
    jumps = itertools.chain([now], itertools.repeat(now + 40_000_000))
    assert clock(lambda: next(jumps), lambda: 0, lambda: True, 0.0)[0].ok is False
    assert "1970" in clock(lambda: 0, lambda: 0, lambda: True, 0.0)[0].text
    assert machine._synchronised() in (True, False, None)


def test_memory_is_held_against_the_frames_in_hand(root: Path) -> None:
    assert memory(root)[0].ok is True
    (root / "proc/meminfo").write_text("MemTotal: 500000 kB\nMemAvailable:  300000 kB\n")
    assert memory(root)[0].ok is False
    (root / "proc/meminfo").write_text("what is this\n")
    assert memory(root)[0].ok is None


def test_loops_that_are_not_there_are_a_fault_and_those_that_are_have_a_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    assert loops()[0].ok is True and native.level() in loops()[0].text
    monkeypatch.setattr(machine.native, "level", lambda: native.shipped("loops-of-another-kind.so"))
    assert loops()[0].ok is False and "`make setup`" in loops()[0].text


def test_the_command_is_a_table_or_json_and_its_status_says_whether_something_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drive, "speed", lambda *_: 1000 * MB)
    (tmp_path / "head.toml").write_text("no toml at all [")
    run = CliRunner().invoke(
        app, ["doctor", "--config", str(tmp_path / "head.toml"), "--folder", str(tmp_path), "--json"]
    )
    found = {row["what"]: row for row in json.loads(run.stdout)}
    assert run.exit_code == 1 and found["head.toml"]["ok"] is False
    monkeypatch.setattr(doctor, "examine", lambda *_: [CheckRow("disk", True, "fast"), CheckRow("port", None, "none")])
    run = CliRunner().invoke(app, ["doctor"])
    assert (run.exit_code, run.stdout.splitlines()) == (0, ["ok      disk          fast", "-       port          none"])
    where = CliRunner().invoke(app, ["doctor", "--where"]).stdout.strip()
    assert (Path(where) / UDEV).is_file()


def test_a_receiver_that_says_on_a_pin_when_a_frame_ends_is_found(root: Path) -> None:
    node = root / "proc/device-tree/soc/csi@7e801000"
    node.mkdir(parents=True)
    (node / "sync-gpios").write_bytes(struct.pack(">3I", 7, 17, 0))

    def none() -> Any:
        raise AnnulusError("no Picamera2 here")

    synced = [one for one in cameras(root, none) if one.what == "frame sync" and one.ok]
    (found,) = synced
    assert found.text.startswith("GPIO 17 of this computer follows the receiver csi@7e801000")
