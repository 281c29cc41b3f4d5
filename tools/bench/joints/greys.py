"""A drawn joint in Hounsfield units and other scales, as DICOM and .npy: against its truth and against itself."""

import json
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure import ArrayVolume, JointImage, features, image
from annulus_pipe.wings.joints.volume_file import open_volume
from tools.bench.blind.others.joint_volumes import Joint, beyond_disc, draw, reconstructed
from tools.bench.table import Row

NOTE = """
Four joints of the second drawer, seeds of this table alone. Each is measured in parts of plastic first, then as it
would be stored: whole Hounsfield units, plastic at -122 and air at -1000 HU, in a DICOM series whose slices are discs
with 0 HU (denser than plastic) or -3024 HU around them; 16 bits with an offset; a negative. Moved by the scale: rms
over the angles of the difference, in sigma; whole numbers are a noise of their own. T off the truth informs: its sigma
falls short for notches finer than a voxel in any grey (tools/bench/blind/others).
"""
SEEDS = range(9301, 9309, 2)
AIR_HU, PLASTIC_HU = -1000.0, -122.0
OFFSET_HU = 4096  # stored = HU + this: no negative numbers, as some scanners write
SAME_SIGMA = 0.5  # a reading that a scale moves by less is the same reading: rounding is noise of its own
RADIUS_MM = 0.05


class Scale(NamedTuple):
    """Grey = gain density + offset; around : what lies beyond the disc, None where the slice is whole."""

    gain: float
    offset: float
    around: float | None
    dicom: bool


HOUNSFIELD = PLASTIC_HU - AIR_HU
SCALES: Mapping[str, Scale] = {
    "HU, DICOM, 0 HU around a disc": Scale(HOUNSFIELD, AIR_HU, 0.0, True),
    "HU, DICOM, -3024 HU around a disc": Scale(HOUNSFIELD, AIR_HU, -3024.0, True),
    "16 bits, gain 31000, offset 20000": Scale(31e3, 20e3, None, False),
    "negative, gain -9000, offset 12000": Scale(-9e3, 12e3, None, False),
}


def write_series(folder: Path, hounsfield: np.ndarray, voxel_mm: tuple[float, float, float]) -> None:
    """(z, y, x) whole HU as single-slice CT images, named against their order."""
    series = generate_uid()
    for z, grey in enumerate(hounsfield):
        tags = Dataset()
        tags.file_meta = FileMetaDataset()
        tags.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        tags.file_meta.MediaStorageSOPClassUID = tags.SOPClassUID = CTImageStorage
        tags.file_meta.MediaStorageSOPInstanceUID = tags.SOPInstanceUID = generate_uid()
        tags.SeriesInstanceUID = series
        tags.Rows, tags.Columns = grey.shape
        tags.PixelSpacing, tags.ImageOrientationPatient = [f"{v:.9g}" for v in voxel_mm[1:]], [1, 0, 0, 0, 1, 0]
        tags.ImagePositionPatient = ["0", "0", f"{z * voxel_mm[0]:.9g}"]
        tags.RescaleSlope, tags.RescaleIntercept = 1, -OFFSET_HU
        tags.BitsAllocated, tags.BitsStored, tags.HighBit = 16, 16, 15
        tags.PixelRepresentation, tags.SamplesPerPixel = 0, 1
        tags.PhotometricInterpretation = "MONOCHROME2"
        tags.PixelData = (grey.astype(np.int32) + OFFSET_HU).astype(np.uint16).tobytes()
        pydicom.dcmwrite(folder / f"{9999 - z}.dcm", tags, enforce_file_format=True)


def _stored(scale: Scale, density: np.ndarray, joint: Joint, folder: Path) -> JointImage:
    grey = np.round(scale.gain * density + scale.offset)
    if scale.around is not None:
        grey[:, beyond_disc(joint)] = scale.around
    if scale.dicom:
        write_series(folder, grey, joint.voxel)
        return image(open_volume(folder))
    np.save(folder / "ct.npy", np.clip(grey, 0, 65535).astype(np.uint16))
    (folder / "ct.json").write_text(json.dumps({"voxel_mm": joint.voxel}), encoding="utf-8")
    return image(open_volume(folder / "ct.npy"))


def rows() -> list[Row]:
    got: dict[str, list[tuple[float, float, float, bool]]] = {name: [] for name in SCALES}
    refused: dict[str, int] = dict.fromkeys(SCALES, 0)
    for seed in SEEDS:
        rng = np.random.default_rng([seed, 91])
        joint = draw(rng)
        density, _ = reconstructed(joint, rng)
        plain = image(ArrayVolume(density.astype(np.float32), joint.voxel))
        for name, scale in SCALES.items():
            with tempfile.TemporaryDirectory() as folder:
                try:
                    found = _stored(scale, density, joint, Path(folder))
                except AnnulusError:
                    refused[name] += 1
                    continue
            got[name].append((*_against(found, joint), *_alike(found, plain)))
    table = []
    for name, cases in got.items():
        radius, thick, moved = (max((case[k] for case in cases), default=math.nan) for k in range(3))
        same = sum(case[3] for case in cases)
        count = len(cases) + refused[name]
        table.append(
            Row(
                f"{name}: measured; flaws as in parts of plastic",
                "-",
                "all",
                f"{len(cases)} of {count}; {same} of {count}",
                same == count,
            )
        )
        table.append(
            Row(
                f"{name}: outer radius off the truth; W, T moved by the scale; T off the truth; worst joint",
                "-",
                f"<= {RADIUS_MM:g} mm; <= {SAME_SIGMA:g} sigma; -",
                f"{radius:.3f} mm; {moved:.2f} sigma; {thick:.1f} sigma",
                radius <= RADIUS_MM and moved <= SAME_SIGMA,
            )
        )
    return table


def _against(found: JointImage, joint: Joint) -> tuple[float, float]:
    """Outer radius, rms against the truth, mm; T, rms against the truth in its own sigma."""
    phi, far = found.phi, np.full(len(found.phi), 1e3)
    true_radius = 0.5 * (joint.surface(False, phi, far) + joint.surface(False, phi, -far))
    true_t = joint.surface(False, phi, 0 * phi) - joint.surface(True, phi, 0 * phi)
    off_t = (found.thickness_mm - true_t) / found.thickness_sigma_mm
    return _rms(found.outer_sides.at_mm.mean(axis=0) - true_radius), _rms(off_t)


def _alike(found: JointImage, plain: JointImage) -> tuple[float, bool]:
    """Of W and T the larger difference, rms in sigma; whether kinds and places of the flaws agree, 4 deg and 1 mm."""
    one, other = features(found), features(plain)
    moved = [(np.asarray(one[n], float) - np.asarray(other[n], float)) / other[f"{n}_sigma"] for n in ("W", "T")]
    flaws = [sorted((flaw.kind, round(flaw.phi_deg / 4), round(flaw.rho)) for flaw in a.flaws) for a in (found, plain)]
    return max(_rms(row) for row in moved if np.isfinite(row).any()), flaws[0] == flaws[1]


def _rms(off: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(np.asarray(off, float) ** 2)))
