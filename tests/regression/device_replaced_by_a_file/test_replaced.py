"""A file written whole took the place of a pipe or a device, with status 0, and of a link: its file stayed old."""

import os
import socket
import stat
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.export.forms import _in_place
from annulus_pipe.report.results import staged
from annulus_pipe.storage.calibration_file import save_part
from annulus_pipe.storage.place import StoragePath, writer
from annulus_pipe.storage.whole import written_whole
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, save_acoustic


def pipe(path: Path) -> Path:
    os.mkfifo(path)
    return path


def bound(path: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(str(path))
    return path


def link_to_pipe(path: Path) -> Path:
    path.symlink_to(pipe(path.with_name("pipe")))
    return path


def folder(path: Path) -> Path:
    path.mkdir()
    return path


def sound(path: Path) -> None:
    save_acoustic(path, AcousticRecord(np.zeros((4, 32), np.float32), np.arange(4.0), 50.0, 1e6))


def plain(path: Path) -> None:
    with written_whole(path) as file:
        file.write(b"new")


def by_writer(path: Path) -> None:
    with writer(path.parent, path.name) as file:
        file.write(b"new")


def into_results(path: Path) -> None:
    with staged(path.parent) as inside:
        (inside / path.name).write_bytes(b"new")


def into_exports(path: Path) -> None:
    with _in_place(path.parent, []) as inside:
        (inside / path.name).write_bytes(b"new")


WRITES = {
    "plain": plain,
    "writer": by_writer,
    "place": lambda path: StoragePath(path.parent).write(path.name, b"new"),
    "part": lambda path: save_part(path, {"new": 1}),
    "sound": sound,
    "results": into_results,
    "exports": into_exports,
}


@pytest.mark.parametrize("there", [pipe, bound, link_to_pipe, folder])
@pytest.mark.parametrize("name", WRITES)
def test_what_is_no_file_stays_what_it_is(tmp_path: Path, name: str, there) -> None:
    path = there(tmp_path / "out.npz")
    before = os.lstat(path)
    with pytest.raises(AnnulusError) as refused:
        WRITES[name](path)
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)
    assert os.path.samestat(before, os.lstat(path))
    assert {one.name for one in tmp_path.iterdir()} <= {"out.npz", "pipe"}


def test_a_device_stays_one(tmp_path: Path) -> None:
    device = tmp_path / "null"
    try:
        os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only root makes devices")
    with pytest.raises(AnnulusError, match="a device"):
        plain(device)
    assert stat.S_ISCHR(os.lstat(device).st_mode)


@pytest.mark.parametrize("name", ["plain", "writer", "place", "part", "sound"])
@pytest.mark.parametrize("old", [True, False], ids=["to a file", "to nothing yet"])
def test_a_link_stays_and_what_it_leads_to_is_new(tmp_path: Path, name: str, old: bool) -> None:
    (tmp_path / "far").mkdir()
    behind, link = tmp_path / "far" / "behind.npz", tmp_path / "out.npz"
    if old:
        behind.write_bytes(b"old")
    link.symlink_to(behind)
    WRITES[name](link)
    assert link.is_symlink() and not behind.is_symlink()
    assert behind.read_bytes() not in (b"", b"old")
    assert [one.name for one in behind.parent.iterdir()] == ["behind.npz"]
