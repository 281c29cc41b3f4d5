"""An empty sampling rate was an IndexError, text of characters that are none a SystemError of numpy. Fails where only
the usual errors of a reader are made one line."""

import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, load_acoustic, save_acoustic

RATE = "meta_data/ad_sampling_rate"
SOUND = AcousticRecord(np.zeros((4, 32), np.float32), np.linspace(0.0, 270.0, 4), 100.0, 1e7, 0.0, None, "code")


def test_a_rate_of_no_values(tmp_path: Path) -> None:
    path = tmp_path / "a.hdf5"
    save_acoustic(path, SOUND)
    with h5py.File(path, "r+") as root:
        del root[RATE]
        root[RATE] = np.zeros(0)
    with pytest.raises(AnnulusError, match="cannot be read as acoustic data"):
        load_acoustic(path)


def test_a_code_of_no_characters(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    save_acoustic(path, SOUND)
    with np.load(path) as data:
        arrays = {name: data[name] for name in data.files}
    arrays["code"] = np.array([0x7FFFFFFF], "<u4").view("<U1").reshape(())
    np.savez(path, **arrays)
    with pytest.raises(AnnulusError, match="cannot be read as acoustic data"):
        load_acoustic(path)


def test_texts_that_never_end(tmp_path: Path) -> None:
    """The HDF5 library walked them for ever. Fails where they are not looked at before it does."""
    path = tmp_path / "a.hdf5"
    save_acoustic(path, SOUND)
    data = bytearray(path.read_bytes())
    heap = data.index(b"GCOL")
    first = int.from_bytes(data[heap + 24 : heap + 32], "little")
    second = heap + 32 + first + -first % 8
    assert load_acoustic(path).code == "code" and data[second] == 2
    data[second : second + 16] = bytes(16)
    path.write_bytes(data)
    with pytest.raises(AnnulusError, match="do not end"):
        load_acoustic(path)


def test_an_array_of_which_only_the_name_is_there(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("signals.npy", b"\x93NUMPY\x01\0")
    with pytest.raises(AnnulusError, match="cannot be read as acoustic data"):
        load_acoustic(path)
