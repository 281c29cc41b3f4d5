"""From a CT volume on disk to the files of what it shows: a joint (`image_joint`), or one dogbone (`image_strip`)."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure import Parts, features, image, maps, strip, summary
from annulus_pipe.wings.joints.measure.image import Progress
from annulus_pipe.wings.joints.pictures import write_joint, write_strip
from annulus_pipe.wings.joints.volume_file import CtVolume, open_volume

DIAMETER_AGREES, WALL_AGREES = 0.03, 0.15  # of what ct.json says the pipe has

VoxelMm = tuple[float, float, float]  # z, y, x; in place of ct.json's


class ImagedJoint(NamedTuple):
    """figures, flaws : as features.json has them. files : written."""

    volume: CtVolume
    figures: dict[str, Any]
    flaws: list[dict[str, Any]]
    files: list[Path]


def image_joint(ct: Path, out: Path, voxel_mm: VoxelMm | None, parts: Parts, progress: Progress) -> ImagedJoint:
    """Features, maps and pictures of a joint into the folder. AnnulusError naming the volume where it shows none, or
    another pipe than its ct.json says."""
    volume = open_volume(ct, voxel_mm)
    with _named(ct):
        joint = image(volume, parts, progress)
    _require_alike(volume, volume.outer_diameter_mm, 2 * joint.found.radius_mm, "the pipe's outer diameter")
    _require_alike(volume, volume.wall_mm, joint.found.wall_mm, "the pipe's wall", WALL_AGREES)
    figures, named = summary(joint), features(joint)
    return ImagedJoint(volume, figures, named["found"], write_joint(out, named, maps(joint), figures))


def image_strip(ct: Path, out: Path, voxel_mm: VoxelMm | None, progress: Progress) -> tuple[dict[str, Any], list[Path]]:
    """W and T of a dogbone that was scanned alone: what strip.json says, and the files in the folder, that one first.
    AnnulusError as `image_joint`."""
    volume = open_volume(ct, voxel_mm)
    with _named(ct):
        found = strip(volume, progress=progress)
    _require_alike(volume, volume.wall_mm, found.wall_mm, "the wall", WALL_AGREES)
    content = {"ct": str(ct), "voxel_mm": list(volume.voxel_mm), **found.figures()}
    return content, write_strip(out, content, found.z_mm, found.across_mm, found.section)


@contextlib.contextmanager
def _named(ct: Path) -> Iterator[None]:
    """An AnnulusError from within names the volume."""
    try:
        yield
    except AnnulusError as error:
        raise AnnulusError(str(error) if str(ct) in str(error) else f"{ct}: {error}") from None


def _require_alike(
    volume: CtVolume, stated_mm: float | None, found_mm: float, what: str, part: float = DIAMETER_AGREES
) -> None:
    """AnnulusError where a length of the volume is further from what its ct.json says than that part of it."""
    if stated_mm is not None and abs(found_mm - stated_mm) > part * stated_mm:
        raise AnnulusError(
            f"{volume.path}: {what} is {found_mm:.2f} mm in the volume and {stated_mm:g} mm in ct.json; is the voxel "
            f"size of {' x '.join(f'{v:g}' for v in volume.voxel_mm)} mm right?"
        )
