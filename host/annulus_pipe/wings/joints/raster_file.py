"""A probe's raster (.npz), and what `annulus joint image` left of a joint for it to be laid on."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.storage.arrays import require_plain_npz
from annulus_pipe.storage.numbers import read_bounded
from annulus_pipe.untrusted import mapping, parse_json, shown
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.strength_file import read_features

BYTES_MAX = 1 << 26
SIDE_MAX, SAMPLES_MAX = 4096, 1 << 20  # of a raster; the source's has 100 x 80
MAP_MAX = 1 << 25  # cells of a CT's map
CHANNELS = ("amplitude_mv", "phase_mv")
AXES = ("angle_deg", "z_mm")
MAPS = ("outer_mm", "bead_out_mm", "density")


def read_raster(path: Path) -> tuple[FloatArray, FloatArray, dict[str, FloatArray]]:
    """(n,) angle_deg, (Z,) z_mm and the channels there are of `CHANNELS`, each (Z, n), finite. In the file (n, Z)."""
    held = _arrays(path, (*AXES, *CHANNELS), AXES)
    angle, z = (_axis(path, held, name) for name in AXES)
    if max(len(angle), len(z)) > SIDE_MAX or len(angle) * len(z) > SAMPLES_MAX:
        raise AnnulusError(f"{path}: {len(angle)} angles and {len(z)} z, expected {SAMPLES_MAX} samples at most")
    channels = {}
    for name in CHANNELS:
        if name in held:
            _require_shape(path, name, held[name], (len(angle), len(z)), "angle_deg x z_mm")
            _require_finite(path, name, held[name])
            channels[name] = held[name].T
    if not channels:
        raise AnnulusError(f"{path}: no array {' or '.join(CHANNELS)}, expected one of them or both")
    return angle, z, channels


def read_joint(folder: Path) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """What features.json says, and of maps.npz z_mm (Z,), phi_deg (P,), even from 0, and `MAPS` (Z, P), finite."""
    path = folder / "features.json"
    try:
        features = dict(mapping(parse_json(read_bounded(path, BYTES_MAX), BYTES_MAX), "features"))
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}") from None
    path = folder / "maps.npz"
    held = _arrays(path, ("z_mm", "phi_deg", *MAPS), ("z_mm", "phi_deg", *MAPS))
    z, phi = (_axis(path, held, name) for name in ("z_mm", "phi_deg"))
    if len(z) * len(phi) > MAP_MAX or len(z) < 2 or len(phi) < 2 or not (np.diff(z) > 0).all():
        raise AnnulusError(f"{path}: z_mm of {len(z)} and phi_deg of {len(phi)}, expected z rising and {MAP_MAX} cells")
    if np.max(np.abs(phi - np.arange(len(phi)) * 360 / len(phi))) > 0.01:
        raise AnnulusError(f"{path}: phi_deg, expected one turn in even steps from 0")
    for name in MAPS:
        _require_shape(path, name, held[name], (len(z), len(phi)), "z_mm x phi_deg")
        _require_finite(path, name, held[name])
    return features, held


def read_walls(folder: Path) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of `annulus joint image`: z_mm (Z,), phi_deg (P,), wall (Z, P) mm, fusion plane (P,) mm."""
    path = folder / "maps.npz"
    held = _arrays(path, ("z_mm", "phi_deg", "outer_mm", "inner_mm"), ("z_mm", "phi_deg", "outer_mm", "inner_mm"))
    z, phi = (_axis(path, held, name) for name in ("z_mm", "phi_deg"))
    for name in ("outer_mm", "inner_mm"):
        _require_shape(path, name, held[name], (len(z), len(phi)), "z_mm x phi_deg")
    _, curves = read_features(folder / "features.json", ["zj"])
    _require_shape(path, "phi_deg", phi, curves["zj"].shape, "zj of features.json")
    return z, phi, held["outer_mm"] - held["inner_mm"], curves["zj"]


def _arrays(path: Path, wanted: tuple[str, ...], needed: tuple[str, ...]) -> dict[str, FloatArray]:
    content = io.BytesIO(read_bounded(path, BYTES_MAX))
    try:
        require_plain_npz(content)
        content.seek(0)
        with np.load(content, allow_pickle=False) as archive:
            missing = [name for name in needed if name not in archive.files]
            if missing:
                raise AnnulusError(f"{path}: no array {' and '.join(missing)} among {shown(','.join(archive.files))}")
            held = {name: archive[name] for name in wanted if name in archive.files}
    except (ValueError, EOFError, zipfile.BadZipFile, OSError) as error:
        raise AnnulusError(f"{path}: not a file of arrays (.npz): {error}") from None
    for name, one in held.items():
        if one.dtype.kind not in "iuf":
            raise AnnulusError(f"{path}: {name} is of {one.dtype.name}, expected numbers")
    return {name: one.astype(np.float64) for name, one in held.items()}


def _axis(path: Path, held: dict[str, FloatArray], name: str) -> FloatArray:
    if held[name].ndim != 1 or not len(held[name]):
        raise AnnulusError(f"{path}: {name} is of shape {held[name].shape}, expected a list of numbers")
    _require_finite(path, name, held[name])
    return held[name]


def _require_finite(path: Path, name: str, values: FloatArray) -> None:
    bad = int((~np.isfinite(values)).sum())
    if bad:
        raise AnnulusError(f"{path}: {bad} of {values.size} values of {name} are not finite numbers")


def _require_shape(path: Path, name: str, values: FloatArray, shape: tuple[int, ...], of: str) -> None:
    if values.shape != shape:
        sides, expected = (" x ".join(str(n) for n in one) or "one number" for one in (values.shape, shape))
        raise AnnulusError(f"{path}: {name} is of {sides}, expected {expected} as {of} is")
