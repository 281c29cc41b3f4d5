"""Promises of the check before a scan: what fails is a line, what is in order is one too, all is looked at."""

import json
import socket
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.capture.camera import CameraDriver, CapturedFrame, grab
from annulus_pipe.cli import main
from annulus_pipe.controller import PIN_INTERLOCK_ANTIVALENT
from annulus_pipe.daemon import check, disk, priority
from annulus_pipe.daemon.check import check_head
from annulus_pipe.link import operate
from annulus_pipe.testing.heads import SimulatedHead

HEAD = """
[camera]
kind = "folder"
device = "{folder}/scan"
width = 64
height = 48

[record]
folder = "recordings"
min_free_gb = 0
reserve_mb = 0

[daemon]
realtime = false
"""


@pytest.fixture
def head(tmp_path: Path) -> Path:
    (tmp_path / "scan").mkdir()
    cv2.imwrite(str(tmp_path / "scan" / "0.png"), np.zeros((48, 64, 3), np.uint8))
    (tmp_path / "scan" / "frames.csv").write_text("index,file,light,z_mm\n0,0.png,led,0\n")
    path = tmp_path / "head.toml"
    path.write_text(HEAD.format(folder=tmp_path))
    return path


def found(path: Path) -> dict[str, tuple[bool | None, str]]:
    return {one.what: (one.ok, one.text) for one in check_head(path)}


def test_a_head_in_order_is_said_to_be_in_order(head: Path) -> None:
    rows = found(head)
    assert [what for what, (ok, _) in rows.items() if ok] == ["head.toml", "camera 0", "recording"]
    assert not [what for what, (ok, _) in rows.items() if ok is False]
    assert rows["camera 0"][1].endswith("64x48 bgr8, a frame came")
    assert "GB free" in rows["recording"][1] and not list((head.parent / "recordings").iterdir())


def test_an_interlock_that_contradicts_itself_is_told_before_the_scan(head: Path) -> None:
    with SimulatedHead() as controller:
        head.write_text(
            HEAD.format(folder=head.parent)
            + f'[controller]\nport = "{controller.url}"\n[interlock]\nantivalent = true\n'
        )
        ok, text = found(head)["controller"]
        assert ok is False and "contradicts itself: GP7 closed, GP13 open" in text
        controller.board.input(controller.board.tick, PIN_INTERLOCK_ANTIVALENT, 1)
        controller.run(0.01)
        operate.clear(controller.url)
        assert found(head)["controller"][0] is True
        assert operate.status(controller.url)["interlock"] == "closed (GP7 and GP13)"


@pytest.mark.parametrize("setting", ["1\n", "0\n", None])
def test_a_kernel_that_makes_edges_wait_is_told_of(
    head: Path, setting: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(priority, "AUTOGROUP", tmp_path / "sched_autogroup_enabled")
    if setting is not None:
        priority.AUTOGROUP.write_text(setting)
    head.write_text(HEAD.format(folder=tmp_path).replace("realtime = false", "realtime = true"))
    assert ("kernel.sched_autogroup_enabled=0" in found(head)["priority"][1]) == (setting == "1\n")


def test_everything_that_is_wrong_is_found_in_one_go(head: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        head.write_text(
            HEAD.format(folder=head.parent).replace("width = 64", "width = 66").replace("min_free_gb = 0", "")
            + f'[control]\naddress = "tcp://127.0.0.1:{port}"\n[publish]\naddress = "tcp://0.0.0.0:0"\n'
            + '[controller]\nport = "/dev/ttyNowhere"\n[log]\nfile = "scan/0.png/head.log"\n'
            + f'[[sensor]]\ndevice = "ipc://{head.parent}/nobody"\n'
        )
        monkeypatch.setattr(check, "SENSOR_S", 0.05)
        monkeypatch.setattr(disk, "free_bytes", lambda *_: 10**9)
        rows = found(head)
    wrong = {what: text for what, (ok, text) in rows.items() if ok is False}
    assert list(wrong) == ["controller", "camera 0", "sensors", "recording", "publish", "control", "log"]
    assert "cannot be opened" in wrong["controller"] and "64x48, but head.toml says 66x48" in wrong["camera 0"]
    assert "nobody speaks there" in wrong["sensors"] and "1.0 GB free, expected at least 2 GB" in wrong["recording"]
    assert "Address already in use" in wrong["control"] and "CURVE keys" in wrong["publish"]
    assert not [text for text in wrong.values() if "\n" in text]


def test_a_camera_that_waits_for_ever_is_not_waited_for(head: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_go = threading.Event()
    for name, value in (("FRAME_S", 0.05), ("PERIODS", 0.0), ("START_S", 0.0)):
        monkeypatch.setattr(check, name, value)

    def wait(camera: object) -> None:
        let_go.wait(20.0)
        raise TimeoutError

    monkeypatch.setattr(check, "grab", wait)
    assert found(head)["camera 0"] == (False, f"{head.parent}/scan: no frame within 0.05 s")
    let_go.set()


def test_a_camera_of_few_frames_a_second_is_waited_for(head: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waits = iter(range(3))

    def slow(camera: CameraDriver) -> CapturedFrame:
        if next(waits, None) is not None:
            raise TimeoutError  # as a driver does whose one wait is shorter than the camera's period
        return grab(camera)

    monkeypatch.setattr(check, "grab", slow)
    assert found(head)["camera 0"][0]


def test_the_command_prints_a_table_and_its_status_says_whether_all_is_well(
    head: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*options: str) -> tuple[object, str]:
        monkeypatch.setattr("sys.argv", ["annulus", "daemon", "--config", str(head), "--check", *options])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr().out

    status, table = run()
    assert status == 0 and table.splitlines()[0] == f"ok      head.toml     {head}"
    head.write_text("[camra]")
    status, table = run()
    assert status == 1 and table.startswith("NOT OK  head.toml") and table.count("\n") == 1
    assert json.loads(run("--json")[1])[0]["ok"] is False
