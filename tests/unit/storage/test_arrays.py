"""Promises of array files from outside: nothing in them leads out of them, or becomes more than they hold."""

import io
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, load_acoustic, save_acoustic

RECORD = AcousticRecord(np.zeros((4, 32), np.float32), np.arange(4) * 90.0, 100.0, 1e6)
DATA = "binary_time_series_data"


def said(path: Path) -> str:
    with pytest.raises(AnnulusError) as caught:
        load_acoustic(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) <= 500
    return str(caught.value)


def external_link(root: h5py.File, other: Path) -> None:
    root[DATA] = h5py.ExternalLink(str(other), DATA)


def soft_link(root: h5py.File, other: Path) -> None:
    root["away"] = h5py.SoftLink("/meta_data")


def external_data(root: h5py.File, other: Path) -> None:
    root.create_dataset(DATA, (4, 32), "f4", external=[(str(other), 0, 512)])


def virtual(root: h5py.File, other: Path) -> None:
    layout = h5py.VirtualLayout((4, 32, 1, 1), "f4")
    layout[:] = h5py.VirtualSource(str(other), DATA, (4, 32, 1, 1))
    root.create_virtual_dataset(DATA, layout)


def bomb(root: h5py.File, other: Path) -> None:
    root.create_dataset(DATA, (8192, 20_000), "f4", chunks=(64, 20_000), compression="gzip")


def larger_than_memory(root: h5py.File, other: Path) -> None:
    root.create_dataset(DATA, (8192, 1 << 22), "f4", chunks=(1, 1 << 20))


def odd_filter(root: h5py.File, other: Path) -> None:
    root.create_dataset(DATA, (4, 32), "f4", compression="lzf")


def circle(root: h5py.File, other: Path) -> None:
    root["meta_data/again"] = root["/"]
    root["meta_data/ad_sampling_rate"][()] = -1.0


def test_collections_of_texts_within_each_other_are_not_walked_again_and_again(tmp_path: Path) -> None:
    path, count = tmp_path / "a.hdf5", 20_000
    save_acoustic(path, RECORD)
    heads = np.zeros(count, [("name", "S8"), ("size", "<u8"), ("number", "<u8"), ("length", "<u8")])
    objects = np.zeros(count, [("number", "<u8"), ("length", "<u8")])
    before_the_end = np.arange(count)[::-1]  # heads
    heads["name"], heads["number"], heads["length"] = b"GCOL\x01", 1, heads.itemsize * before_the_end
    heads["size"] = heads["length"] + heads.itemsize + objects.nbytes
    objects["number"] = 1
    with h5py.File(path, "r+") as root:
        root.create_dataset("heads", data=np.frombuffer(heads.tobytes() + objects.tobytes(), np.uint8))
    started = time.process_time()
    with pytest.raises(AnnulusError, match="within each other"):
        load_acoustic(path)
    assert time.process_time() - started < 2.0  # s; 0.1 measured, minutes before


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (external_link, "leads elsewhere (ExternalLink)"),
        (soft_link, "leads elsewhere (SoftLink)"),
        (external_data, "lies in other files"),
        (virtual, "lies in other files"),
        (bomb, "would become 655360000 bytes from 0"),
        (larger_than_memory, "131072 MiB"),
        (odd_filter, "is packed by b'lzf'"),
        (circle, "sampling_rate_hz is -1"),
    ],
)
def test_hdf5_that_leads_elsewhere_or_swells_is_refused(
    spoil: Callable[[h5py.File, Path], None], says: str, tmp_path: Path
) -> None:
    for name in ("a.hdf5", "other.hdf5"):
        save_acoustic(tmp_path / name, RECORD)
    with h5py.File(tmp_path / "a.hdf5", "r+") as root:
        if spoil not in (soft_link, circle):
            del root[DATA]
        spoil(root, tmp_path / "other.hdf5")
    assert says in said(tmp_path / "a.hdf5")


def member(head: str, data: bytes = b"") -> bytes:
    text = head.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (
            member("{'descr': '<f4', 'fortran_order': False, 'shape': (100000, 100000)}"),
            "says it has 40000000000 bytes",
        ),
        (member("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}", b"\x80\x04."), "an array of object"),
        (member("{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}"), "an array of no shape"),
        (member("[" * 3000), "does not say what it is"),
        (b"import os", "what is not an array"),
    ],
)
def test_an_archive_that_says_more_than_it_holds_is_refused(content: bytes, says: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("signals.npy", content)
    assert says in said(tmp_path / "a.npz")


def test_an_archive_that_swells_is_refused(tmp_path: Path) -> None:
    zeros = io.BytesIO()
    np.save(zeros, np.zeros(20 << 20, np.float32))
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("signals.npy", zeros.getvalue())
    assert "would become 83886208 bytes" in said(tmp_path / "a.npz")
