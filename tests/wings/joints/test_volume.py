"""CT volumes come in as they were written, in the order of their places, or are refused in one line."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
import tifffile
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.volume_file import open_volume

GREY = np.random.default_rng(1).integers(0, 4000, (7, 12, 10)).astype(np.uint16)
SIZES = (0.4, 0.3, 0.2)


def says(folder: Path, **said: Any) -> None:
    (folder / "ct.json").write_text(json.dumps({"voxel_mm": SIZES, **said}))


def dicom(folder: Path, names: list[str], left_out: int | None = None, series: dict[int, str] | None = None) -> None:
    """A series whose names say nothing of its order."""
    uid = generate_uid()
    for z, name in enumerate(names):
        if z == left_out:
            continue
        tags = Dataset()
        tags.file_meta = FileMetaDataset()
        tags.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        tags.file_meta.MediaStorageSOPClassUID = CTImageStorage
        tags.file_meta.MediaStorageSOPInstanceUID = tags.SOPInstanceUID = generate_uid()
        tags.SOPClassUID = CTImageStorage
        tags.SeriesInstanceUID = (series or {}).get(z, uid)
        tags.Rows, tags.Columns = GREY.shape[1:]
        tags.PixelSpacing, tags.ImageOrientationPatient = [SIZES[1], SIZES[2]], [1, 0, 0, 0, 1, 0]
        tags.ImagePositionPatient = [-3.0, -4.0, round(5.0 + SIZES[0] * z, 6)]
        tags.RescaleSlope, tags.RescaleIntercept = 2, -1000
        tags.BitsAllocated = tags.BitsStored = 16
        tags.HighBit, tags.PixelRepresentation, tags.SamplesPerPixel = 15, 0, 1
        tags.PhotometricInterpretation = "MONOCHROME2"
        tags.PixelData = GREY[z].tobytes()
        pydicom.dcmwrite(folder / name, tags, enforce_file_format=True)


NAMES = [f"IM{n:04d}.dcm" for n in (5, 0, 3, 6, 1, 4, 2)]


@pytest.mark.parametrize("compression", [None, "zlib", "lzw"])
def test_a_tiff_stack_comes_in_slice_by_slice(tmp_path: Path, compression: str | None) -> None:
    tifffile.imwrite(tmp_path / "ct.tif", GREY, compression=compression, photometric="minisblack")
    says(tmp_path, pipe={"outer_diameter_mm": 60.3, "wall_mm": 5.5})
    volume = open_volume(tmp_path / "ct.tif")
    assert volume.shape == GREY.shape
    assert volume.voxel_mm == SIZES
    assert (volume.outer_diameter_mm, volume.wall_mm) == (60.3, 5.5)
    assert np.array_equal(volume.slices(2, 5), GREY[2:5])
    assert np.array_equal(open_volume(tmp_path).slices(0, 7), GREY)


def test_numbered_tiffs_come_in_by_number_and_a_hole_is_told(tmp_path: Path) -> None:
    says(tmp_path)
    for z in range(7):
        tifffile.imwrite(tmp_path / f"slice{z + 7}.tif", GREY[z])  # 9 stands before 10
    assert np.array_equal(open_volume(tmp_path).slices(0, 7), GREY)
    (tmp_path / "slice10.tif").unlink()
    with pytest.raises(AnnulusError, match="slice 10 is missing between 7 and 13"):
        open_volume(tmp_path)


def test_npy_is_mapped(tmp_path: Path) -> None:
    np.save(tmp_path / "ct.npy", GREY)
    assert np.array_equal(open_volume(tmp_path / "ct.npy", SIZES).slices(3, 7), GREY[3:7])


def test_a_dicom_series_is_ordered_by_place_and_rescaled(tmp_path: Path) -> None:
    dicom(tmp_path, NAMES)
    volume = open_volume(tmp_path)
    assert volume.voxel_mm == pytest.approx(SIZES)
    assert np.array_equal(volume.slices(0, 7), 2.0 * GREY - 1000)


@pytest.mark.parametrize(("missing", "form"), [("imagecodecs", "TIFF"), ("tifffile", "TIFF"), ("pydicom", "DICOM")])
def test_a_missing_extra_is_named_with_what_brings_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: str, form: str
) -> None:
    tifffile.imwrite(tmp_path / "ct.tif", GREY, photometric="minisblack")
    (tmp_path / "series").mkdir()
    dicom(tmp_path / "series", NAMES)
    says(tmp_path)
    monkeypatch.setitem(sys.modules, missing, None)  # as if it were not installed
    with pytest.raises(AnnulusError, match=f'{missing} is not installed: it is part of the extra "joints". make setup'):
        open_volume(tmp_path / ("series" if form == "DICOM" else "ct.tif"))


def test_bad_series_are_one_line(tmp_path: Path) -> None:
    dicom(tmp_path, NAMES, left_out=3)
    with pytest.raises(AnnulusError, match=r"1 slices are missing between 5.8 and 6.6 mm, 0.4 mm apart"):
        open_volume(tmp_path)
    dicom(tmp_path, NAMES, series={2: generate_uid()})
    with pytest.raises(AnnulusError, match=r"2 series mixed"):
        open_volume(tmp_path)
    dicom(tmp_path, NAMES)
    dicom(tmp_path, ["again.dcm"])
    with pytest.raises(AnnulusError, match=r"2 series mixed|lie at one place"):
        open_volume(tmp_path)
    (tmp_path / "again.dcm").unlink()
    says(tmp_path, voxel_mm=[0.4, 0.3, 0.25])
    with pytest.raises(AnnulusError, match=r"0.25 mm along x in ct.json, of 0.2 mm in its headers"):
        open_volume(tmp_path)


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ('{"voxel_mm": [288, 288, 288]}', "not in um"),
        ('{"voxel_mm": [0.3, 0.3]}', "voxel_mm"),
        ('{"voxel_mm": [0.3, 0.3, NaN]}', "ct.json"),
        ("{", "ct.json"),
        ('{"voxel_mm": [0.3, 0.3, 0]}', "expected 0.002 to 5 mm"),
        ('{"voxel_mm": [0.3, 0.3, 0.3], "pipe": {"wall_mm": "thick"}}', "wall_mm"),
        ("{}", "nothing says how large"),
    ],
)
def test_a_size_that_is_none_is_refused(tmp_path: Path, said: str, why: str) -> None:
    np.save(tmp_path / "ct.npy", GREY)
    (tmp_path / "ct.json").write_text(said)
    with pytest.raises(AnnulusError, match=why):
        open_volume(tmp_path / "ct.npy")


def test_what_is_no_volume_is_one_line(tmp_path: Path) -> None:
    says(tmp_path)
    for name, data in (("ct.tif", b"II*\0nothing"), ("ct.npy", b"\x93NUMPY"), ("ct.raw", b"1")):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(AnnulusError, match=name):
            open_volume(tmp_path / name)
    with pytest.raises(AnnulusError, match="several volumes"):
        open_volume(tmp_path)
    with pytest.raises(AnnulusError, match="no such file"):
        open_volume(tmp_path / "gone")


def test_a_slice_cut_short_is_named(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "ct.tif", GREY, compression="zlib", photometric="minisblack")
    data = bytearray((tmp_path / "ct.tif").read_bytes())
    with tifffile.TiffFile(tmp_path / "ct.tif") as tiff:
        at = tiff.pages[4].dataoffsets[0]  # type: ignore[union-attr]
    data[at : at + 20] = bytes(20)
    (tmp_path / "ct.tif").write_bytes(data)
    volume = open_volume(tmp_path / "ct.tif", SIZES)
    with pytest.raises(AnnulusError, match="slice 4 of 7 cannot be read"):
        volume.slices(0, 7)
