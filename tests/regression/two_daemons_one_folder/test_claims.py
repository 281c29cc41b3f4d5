"""Two daemons recorded into one folder and wrote each other's health.json, and an `ipc://` address was taken from
whoever had it; a port, a camera or a TCP address that another daemon had was noticed after 4 to 8 s, its camera knocked
at and workers started. Fails without daemon/claims.py."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.daemon.claims import claimed
from annulus_pipe.daemon.config import HeadConfig, SocketConfig
from annulus_pipe.vocabulary import AnnulusError


def head(folder: Path, number: int) -> HeadConfig:
    """Of two that have nothing in common."""
    return HeadConfig(
        (CameraConfig("remote", f"@camera-{number}-{folder}"),),
        port=f"socket://localhost:{number}",
        record_folder=folder / f"scans-{number}",
        publish=SocketConfig(f"ipc://{folder}/publish-{number}"),
        control=SocketConfig(f"tcp://127.0.0.1:{number}"),
    )


@pytest.mark.parametrize("same", ["cameras", "port", "record_folder", "publish", "control"])
def test_what_one_daemon_has_no_other_begins_with(same: str, tmp_path: Path) -> None:
    one, other = head(tmp_path, 1), head(tmp_path, 2)
    with claimed(one):
        taken = claimed(replace(other, **{same: getattr(one, same)}))
        with pytest.raises(AnnulusError, match=rf"in use by another annulus daemon \(process {os.getpid()}\)") as told:
            taken.__enter__()
        assert "\n" not in str(told.value)
        with claimed(other):
            pass
    with claimed(one):
        pass


def test_a_link_to_what_another_has_is_the_same_and_a_file_is_for_all(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "scans-1")
    one, film = head(tmp_path, 1), CameraConfig("video", "film.mp4")
    linked = claimed(HeadConfig((film,), record_folder=tmp_path / "link"))
    with claimed(one), pytest.raises(AnnulusError, match="the recording folder: in use"):
        linked.__enter__()
    with claimed(HeadConfig((film,))), claimed(HeadConfig((film,))):
        pass


def test_a_daemon_that_was_killed_has_nothing_any_more(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from annulus_pipe.daemon.claims import claimed\n"
        "from annulus_pipe.daemon.config import HeadConfig\n"
        "from annulus_pipe.daemon.camera_config import CameraConfig\n"
        "with claimed(HeadConfig((CameraConfig(),), record_folder=Path(sys.argv[1]))): os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)
    with claimed(HeadConfig((CameraConfig(),), record_folder=tmp_path)):
        pass
