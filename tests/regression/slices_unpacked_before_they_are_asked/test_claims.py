"""A TIFF slice of 0.2 MB took 4.2 GB, and a deflated DICOM file of 3.1 MB took 3.1 GB, before anybody had asked how
large their slices are."""

import json
import resource
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import tifffile
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.filewriter import dcmwrite
from pydicom.uid import CTImageStorage, DeflatedExplicitVRLittleEndian, generate_uid

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.volume_file import open_volume

GREY = np.random.default_rng(2).integers(0, 4000, (3, 12, 10)).astype(np.uint16)
MORE_MB = 100  # of address space, over what is in use: a slice of 120 pixels needs none of it


@contextmanager
def little_memory() -> Iterator[None]:
    used = next(int(line.split()[1]) for line in Path("/proc/self/status").read_text().splitlines() if "VmData" in line)
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (used * 1024 + (MORE_MB << 20), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def says(folder: Path) -> Path:
    (folder / "ct.json").write_text(json.dumps({"voxel_mm": [0.4, 0.3, 0.2]}))
    return folder


@pytest.mark.parametrize("which", [0, 1], ids=["the first", "a later one"])
def test_a_slice_that_claims_a_plain_of_pixels_is_one_line(which: int, tmp_path: Path) -> None:
    for z in range(3):
        tifffile.imwrite(says(tmp_path) / f"{z}.tif", GREY[z], compression="zlib")
    with tifffile.TiffFile(tmp_path / f"{which}.tif", mode="r+b") as tiff:
        for tag in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            tiff.pages[0].tags[tag].overwrite(65_000)
    with little_memory(), pytest.raises(AnnulusError, match=r"voxels; expected 2 to 8192|expected greys of 12 x 10"):
        open_volume(tmp_path).slices(0, 3)


@pytest.mark.parametrize("stacked", [False, True])
def test_a_tile_larger_than_its_page_is_one_line(stacked: bool, tmp_path: Path) -> None:
    page = np.zeros((40, 48), np.uint16)
    for z in range(1 if stacked else 3):
        pages = np.stack([page] * 3) if stacked else page
        tifffile.imwrite(
            says(tmp_path) / f"{z}.tif", pages, compression="zlib", tile=(16, 16), photometric="minisblack"
        )
        with tifffile.TiffFile(tmp_path / f"{z}.tif", mode="r+b") as tiff:
            for one in tiff.pages:
                for tag in ("TileWidth", "TileLength"):
                    one.tags[tag].overwrite(32_768)
    with little_memory(), pytest.raises(AnnulusError, match="larger than their page"):
        open_volume(tmp_path).slices(0, 3)


def test_a_strip_that_unpacks_to_more_than_it_holds_is_one_line(tmp_path: Path) -> None:
    for z in range(3):
        tifffile.imwrite(says(tmp_path) / f"{z}.tif", GREY[z], compression="zlib", rowsperstrip=12)
    packed = zlib.compress(bytes(1 << 27), 1)
    with tifffile.TiffFile(tmp_path / "1.tif", mode="r+b") as tiff:
        at = tiff.filehandle.size
        tiff.filehandle.seek(at)
        tiff.filehandle.write(packed)
        tiff.pages[0].tags["StripOffsets"].overwrite(at)
        tiff.pages[0].tags["StripByteCounts"].overwrite(len(packed))
    with little_memory(), pytest.raises(AnnulusError, match="slice 1 of 3 cannot be read"):
        open_volume(tmp_path).slices(0, 3)


def deflated(folder: Path, pixels: int = 240) -> None:
    uid = generate_uid()
    for z in range(3):
        tags = Dataset()
        tags.file_meta = FileMetaDataset()
        tags.file_meta.TransferSyntaxUID = DeflatedExplicitVRLittleEndian
        tags.file_meta.MediaStorageSOPClassUID = tags.SOPClassUID = CTImageStorage
        tags.file_meta.MediaStorageSOPInstanceUID = tags.SOPInstanceUID = generate_uid()
        tags.SeriesInstanceUID = uid
        tags.Rows, tags.Columns, tags.SamplesPerPixel, tags.PhotometricInterpretation = 12, 10, 1, "MONOCHROME2"
        tags.BitsAllocated = tags.BitsStored = 16
        tags.HighBit, tags.PixelRepresentation, tags.NumberOfFrames = 15, 0, 1
        tags.PixelSpacing, tags.ImageOrientationPatient = [0.3, 0.2], [1, 0, 0, 0, 1, 0]
        tags.ImagePositionPatient = [0, 0, 0.4 * z]
        tags.PixelData = GREY[z].tobytes() + bytes(pixels - 240)
        dcmwrite(folder / f"{z}.dcm", tags, enforce_file_format=True)


def test_a_deflated_series_is_read(tmp_path: Path) -> None:
    deflated(tmp_path)
    assert np.array_equal(open_volume(tmp_path).slices(0, 3), GREY)


def test_a_deflated_file_is_unpacked_no_further_than_its_slice(tmp_path: Path) -> None:
    deflated(tmp_path)
    bytes_of_nobody = zlib.compressobj(1, wbits=-15).compress(bytes(1 << 27))
    for file in tmp_path.iterdir():
        data = file.read_bytes()
        packed = zlib.compressobj(1, wbits=-15)
        at = 132 + 12 + int.from_bytes(data[140:144], "little")  # behind the file's own tags, which are as they are
        plain = zlib.decompress(data[at:], -15)
        bomb = packed.compress(plain) + packed.flush(zlib.Z_FULL_FLUSH) + bytes_of_nobody
        file.write_bytes(data[:at] + bomb)
    with little_memory():
        volume = open_volume(tmp_path)
        try:
            assert np.array_equal(volume.slices(0, 3), GREY)
        except AnnulusError as error:
            assert "slice 0 of 3 cannot be read" in str(error)
