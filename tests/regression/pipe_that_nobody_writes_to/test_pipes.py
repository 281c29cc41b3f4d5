"""A pipe that nobody writes to was waited for, a device read to the bound, a CT volume of one called a bug of ours."""

import logging
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.export.wall_map import read_wall
from annulus_pipe.flash.image import read_image
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.log_file import read_bore_log
from annulus_pipe.wings.joints.volume_file import open_volume
from annulus_pipe.wings.tai.acoustic_file import load_acoustic
from annulus_pipe.wings.tai.design import load_transducer

READERS: dict[str, Callable[[Path], object]] = {
    "log.csv": read_bore_log,
    "log.csv.gz": read_bore_log,
    "annulus.uf2": read_image,
    "ct.tif": lambda path: open_volume(path, (1.0, 1.0, 1.0)),
    "ct.npy": lambda path: open_volume(path, (1.0, 1.0, 1.0)),
    "sound.npz": load_acoustic,
    "sound.hdf5": load_acoustic,
    "pulse.csv": load_transducer,
    "wall.npz": read_wall,
}


@pytest.mark.parametrize("name", READERS)
def test_what_is_no_file_is_said_at_once(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    os.mkfifo(path)
    with pytest.raises((AnnulusError, ValueError), match="not a file"):
        READERS[name](path)


@pytest.mark.parametrize("name", [name for name in READERS if name != "wall.npz"])
def test_a_device_is_not_read(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.symlink_to("/dev/zero")
    with pytest.raises(AnnulusError, match="not a file"):
        READERS[name](path)


def test_a_cut_volume_is_one_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    import tifffile

    tifffile.imwrite(tmp_path / "ct.tif", np.zeros((40, 16, 16), np.uint16))
    whole = (tmp_path / "ct.tif").read_bytes()
    (tmp_path / "ct.tif").write_bytes(whole[: len(whole) // 2])
    logging.getLogger("tifffile").setLevel(logging.NOTSET)  # another test may have opened a volume
    with pytest.raises(AnnulusError):
        open_volume(tmp_path / "ct.tif", (1.0, 1.0, 1.0))
    assert not caplog.records
