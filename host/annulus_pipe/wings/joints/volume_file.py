"""CT volumes on disk, read slice by slice as they are asked for: TIFF stacks, NumPy's .npy, DICOM series.

A TIFF or NPY volume has no size of its own that can be believed: a `ct.json` beside it says
`{"voxel_mm": [z, y, x], "pipe": {"outer_diameter_mm": .., "wall_mm": ..}}` (`pipe` may be left out; it is what the
volume is checked against). A DICOM series is ordered by where its slices lie, never by name or number.

A packed slice says how large it is before it is unpacked, and is held to it (slices.py).
"""

import json
import logging
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.extras import need
from annulus_pipe.numeric.arrays import Float32Array
from annulus_pipe.untrusted import mapping, number, numbers, parse_json, read_file, shown
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.slices import dicom_pixels, dicom_tags, tiff_page, tiff_size

JSON_MAX = 1 << 16
SIDE_MAX = 8192  # voxels; a slice of 8192^2 is 128 MB
VOXEL_MM = (0.002, 5.0)  # the smallest and largest that a joint can be seen with
EVEN = 0.02  # of the slices' spacing: so far may one be off its place
AGREE = 0.01  # a voxel's size in ct.json and in the DICOM headers
TIFF, DICOM = (".tif", ".tiff"), (".dcm", ".dicom", ".ima", "")


@dataclass(frozen=True, slots=True)
class CtVolume:
    """A volume whose slices are read when asked for. `voxel_mm` along z, y, x; `pipe` what ct.json says of it, mm."""

    shape: tuple[int, int, int]
    voxel_mm: tuple[float, float, float]
    form: str
    outer_diameter_mm: float | None
    wall_mm: float | None
    read: Callable[[int], Any]
    path: Path

    def slices(self, start: int, stop: int) -> Float32Array:
        """(stop - start, rows, columns) grey values. Raises AnnulusError naming file and slice."""
        out = np.empty((max(stop - start, 0), *self.shape[1:]), np.float32)
        for z in range(start, stop):
            try:
                grey = np.asarray(self.read(z))
            except Exception as error:  # of three libraries and their codecs
                raise AnnulusError(
                    f"{self.path}: slice {z} of {self.shape[0]} cannot be read ({_why(error)})"
                ) from None
            if grey.shape != self.shape[1:] or grey.dtype.kind not in "iuf":
                raise AnnulusError(
                    f"{self.path}: slice {z} is {grey.dtype} of {grey.shape}, expected greys of {self.shape[1:]}"
                )
            out[z - start] = grey
        if not np.isfinite(out).all():
            raise AnnulusError(f"{self.path}: slices {start} to {stop - 1} hold what is no number")
        return out


def open_volume(path: Path, voxel_mm: tuple[float, float, float] | None = None) -> CtVolume:
    """A volume from a file (.tif, .npy), a folder of one of these, or a folder of a DICOM series or of TIFF slices.

    voxel_mm : z, y, x, in place of ct.json's. Raises AnnulusError, one line: no such file, another form, slices missing
    or of several series, a voxel's size that is missing, no size or another than the headers'.
    """
    if not path.exists():
        raise AnnulusError(f"{path}: no such file or folder")
    if not (path.is_file() or path.is_dir()):
        raise AnnulusError(f"{path}: not a file; expected a volume in .tif or .npy, or a folder of one")
    folder = path if path.is_dir() else path.parent
    description = _description(folder / "ct.json") if (folder / "ct.json").is_file() else {}
    pipe = mapping(description.get("pipe", {}), "pipe") if description else {}
    stated = voxel_mm or description.get("voxel_mm")
    shape, form, read, own = _form(path)
    if stated is None and own is None:
        raise AnnulusError(
            f'{path}: nothing says how large its voxels are; expected ct.json beside it with {{"voxel_mm": [z, y, x]}}'
        )
    if stated is not None and own is not None:
        for axis, a, b in zip("zyx", stated, own, strict=True):
            if abs(a - b) > AGREE * b:
                raise AnnulusError(f"{path}: voxels of {a:g} mm along {axis} in ct.json, of {b:g} mm in its headers")
    voxel = tuple(float(v) for v in (own or stated or ()))
    if len(voxel) != 3 or not all(VOXEL_MM[0] <= v <= VOXEL_MM[1] for v in voxel):
        size = " x ".join(f"{v:g}" for v in voxel)
        raise AnnulusError(f"{path}: voxels of {size} mm; expected {VOXEL_MM[0]:g} to {VOXEL_MM[1]:g} mm: not in um?")
    if min(shape) < 2 or max(shape) > SIDE_MAX:
        raise AnnulusError(f"{path}: {' x '.join(map(str, shape))} voxels; expected 2 to {SIDE_MAX} a side")
    try:
        outer, wall = (
            number(pipe[key], f"pipe.{key}", 1e4) if key in pipe else None for key in ("outer_diameter_mm", "wall_mm")
        )
    except ValueError as error:
        raise AnnulusError(f"{folder / 'ct.json'}: {error}") from None
    return CtVolume(shape, (voxel[0], voxel[1], voxel[2]), form, outer, wall, read, path)


_Opened = tuple[tuple[int, int, int], str, Callable[[int], Any], tuple[float, float, float] | None]


def _form(path: Path) -> _Opened:
    if path.is_file():
        if path.suffix.lower() in TIFF:
            return _tiff(path)
        if path.suffix.lower() == ".npy":
            return _npy(path)
        raise AnnulusError(f"{path}: expected a volume in .tif or .npy, or a folder of a DICOM series or TIFF slices")
    files = sorted(file for file in path.iterdir() if file.is_file() and not file.name.startswith("."))
    tiffs = [file for file in files if file.suffix.lower() in TIFF]
    arrays = [file for file in files if file.suffix.lower() == ".npy"]
    dicom = [file for file in files if _is_dicom(file)]
    kinds = [kind for kind in (tiffs, arrays, dicom) if kind]
    if len(kinds) > 1 or len(arrays) > 1:
        raise AnnulusError(f"{path}: holds several volumes ({', '.join(kind[0].name for kind in kinds)}); name one")
    if not kinds:
        raise AnnulusError(f"{path}: no volume in it; expected .tif, .npy or a DICOM series")
    if dicom:
        return _dicom(path, dicom)
    if arrays:
        return _npy(arrays[0])
    return _tiff(tiffs[0]) if len(tiffs) == 1 else _tiffs(path, tiffs)


def _description(path: Path) -> dict[str, Any]:
    try:
        content = dict(mapping(parse_json(read_file(path, JSON_MAX), JSON_MAX), "ct.json"))
        if "voxel_mm" in content:
            content["voxel_mm"] = numbers(content["voxel_mm"], "voxel_mm", (3,), 1e6)
    except (ValueError, OSError, json.JSONDecodeError) as error:
        raise AnnulusError(f'{path}: {_why(error)}; expected {{"voxel_mm": [z, y, x]}}') from None
    return content


def _why(error: BaseException) -> str:
    return str(error).splitlines()[0][:200] if str(error) else type(error).__name__


def _npy(path: Path) -> _Opened:
    try:
        grey = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:
        raise AnnulusError(f"{path}: cannot be read as .npy ({_why(error)})") from None
    if not isinstance(grey, np.ndarray) or grey.ndim != 3 or grey.dtype.kind not in "iuf":
        raise AnnulusError(f"{path}: {grey.dtype} of {grey.shape}; expected greys of (z, y, x)")
    return (grey.shape[0], grey.shape[1], grey.shape[2]), "NPY", lambda z: grey[z], None


def _tifffile() -> Any:
    need("imagecodecs")  # what TIFF's compressions need: told here, not at the first slice
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # what it says of a damaged file is no line of ours
    return need("tifffile")


def _tiff(path: Path) -> _Opened:
    tifffile = _tifffile()
    try:
        # Kept open for as long as slices are asked for; one handle, no pixel read yet.
        tiff = tifffile.TiffFile(path)
        pages = tiff.pages
        several = len(pages) > 1
        shape = (len(pages), *pages[0].shape) if several else tiff.series[0].shape
    except Exception as error:
        raise AnnulusError(f"{path}: cannot be read as TIFF ({_why(error)})") from None
    if len(shape) != 3:
        raise AnnulusError(f"{path}: a TIFF of {' x '.join(map(str, shape))}; expected a stack of grey slices")
    if not several:  # one block with one head, as ImageJ writes what is large
        try:
            whole = tifffile.memmap(path, mode="r")
        except ValueError as error:
            raise AnnulusError(
                f"{path}: a compressed volume in one page ({_why(error)}); expected a page a slice"
            ) from None
        return (shape[0], shape[1], shape[2]), "TIFF stack", lambda z: whole[z], None
    size = (shape[1], shape[2])
    return (shape[0], *size), "TIFF stack", lambda z: tiff_page(pages[z], size), None


def _tiffs(folder: Path, files: list[Path]) -> _Opened:
    """A folder of numbered slices, in the order of their last number."""
    tifffile = _tifffile()
    counted: dict[int, Path] = {}
    for file in files:
        digits = re.findall(r"\d+", file.stem)
        if not digits:
            raise AnnulusError(f"{file}: has no number; expected numbered slices of one volume")
        if (n := int(digits[-1][-9:])) in counted:
            raise AnnulusError(f"{folder}: {counted[n].name} and {file.name} are both slice {n}; expected one volume")
        counted[n] = file
    order = sorted(counted)
    holes = [n for n in range(order[0], order[0] + len(order)) if n not in counted]
    if holes:
        raise AnnulusError(f"{folder}: slice {holes[0]} is missing between {order[0]} and {order[-1]}")
    try:
        with tifffile.TiffFile(counted[order[0]]) as tiff:
            size = tiff_size(tiff)
    except Exception as error:
        raise AnnulusError(f"{counted[order[0]]}: cannot be read as TIFF ({_why(error)})") from None

    def read(z: int) -> Any:
        with tifffile.TiffFile(counted[order[z]]) as tiff:
            tiff_size(tiff)
            return tiff_page(tiff.pages[0], size)

    return (len(order), *size), "TIFF slices", read, None


def _is_dicom(path: Path) -> bool:
    if path.suffix.lower() in (".json", ".tif", ".tiff", ".npy", ".csv", ".npz", ".md", ".txt"):
        return False
    with path.open("rb") as file:
        head = file.read(132)
    return head[128:] == b"DICM" or (path.suffix.lower() in DICOM[:3])


def _dicom(folder: Path, files: list[Path]) -> _Opened:
    need("pydicom")
    slices = []
    for file in files:
        try:
            slices.append((_head(dicom_tags(file)), file))
        except AnnulusError as error:
            raise AnnulusError(f"{file}: {error}") from None
        except Exception as error:
            raise AnnulusError(f"{file}: cannot be read as DICOM ({_why(error)})") from None
    series = sorted({head.series for head, _ in slices})
    if len(series) > 1:
        each = ", ".join(f"{sum(h.series == s for h, _ in slices)} of {shown(s)}" for s in series[:3])
        raise AnnulusError(f"{folder}: {len(series)} series mixed ({each}); expected one")
    first = slices[0][0]
    for head, file in slices:
        if head.size != first.size or not np.allclose(
            head.spacing + head.across, first.spacing + first.across, atol=1e-4
        ):
            raise AnnulusError(
                f"{file}: another size, pixel or orientation than {slices[0][1].name}; expected one series"
            )
    normal = np.cross(first.across[:3], first.across[3:])
    placed = sorted(((float(np.dot(head.place, normal)), head, file) for head, file in slices), key=lambda s: s[0])
    at = np.array([place for place, _, _ in placed])
    if len(at) < 2:
        raise AnnulusError(f"{folder}: one slice; expected a series")
    steps = np.diff(at)
    step = float(np.median(steps))
    for k in range(len(steps)):
        if steps[k] < 0.5 * step or step <= 0:
            raise AnnulusError(
                f"{folder}: {placed[k][2].name} and {placed[k + 1][2].name} lie at one place, {at[k]:g} mm"
            )
        if steps[k] > 1.5 * step:
            lost = round(steps[k] / step) - 1
            raise AnnulusError(
                f"{folder}: {lost} slices are missing between {at[k]:g} and {at[k + 1]:g} mm, {step:g} mm apart"
            )
    if np.abs(at - np.linspace(at[0], at[-1], len(at))).max() > max(EVEN * step, 1e-3):
        raise AnnulusError(f"{folder}: slices {steps.min():g} to {steps.max():g} mm apart; expected even ones")
    step = float((at[-1] - at[0]) / (len(at) - 1))

    def read(z: int) -> Any:
        _, head, file = placed[z]
        return dicom_pixels(file, head.size) * np.float32(head.slope) + np.float32(head.intercept)

    return (len(at), *first.size), "DICOM series", read, (step, *first.spacing)


@dataclass(frozen=True, slots=True)
class _Head:
    series: str
    size: tuple[int, int]
    spacing: tuple[float, float]  # of rows (along y), of columns (along x), mm
    across: tuple[float, ...]  # direction of a row, then of a column
    place: tuple[float, ...]
    slope: float
    intercept: float


def _head(tags: Any) -> _Head:
    def floats(name: str, count: int, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        value = tags.get(name, default)
        value = [value] if value is not None and count == 1 and not isinstance(value, tuple) else value
        if value is None or len(value) != count or not all(math.isfinite(float(v)) for v in value):
            raise AnnulusError(f"{name} is missing or no {count} numbers; expected a CT slice with its place")
        return tuple(float(v) for v in value)

    if int(tags.get("NumberOfFrames", 1) or 1) > 1:
        raise AnnulusError("several frames in one file; expected a series of single slices")
    if int(tags.get("SamplesPerPixel", 1)) != 1:
        raise AnnulusError("colour; expected grey")
    across = floats("ImageOrientationPatient", 6)
    if abs(np.dot(across[:3], across[3:])) > 1e-3 or not np.allclose(
        [np.linalg.norm(across[k : k + 3]) for k in (0, 3)], 1, atol=1e-3
    ):
        raise AnnulusError("ImageOrientationPatient: expected two unit vectors at right angles")
    spacing = floats("PixelSpacing", 2)
    return _Head(
        str(tags.get("SeriesInstanceUID", "")),
        (int(tags.Rows), int(tags.Columns)),
        (spacing[0], spacing[1]),
        across,
        floats("ImagePositionPatient", 3),
        *floats("RescaleSlope", 1, (1.0,)),
        *floats("RescaleIntercept", 1, (0.0,)),
    )
