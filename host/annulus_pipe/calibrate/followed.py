"""The frames of a tube in which the rings can be followed, and why the others cannot be used."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from annulus_pipe.calibrate.sample import Progress, Sampled
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.numeric.arrays import FloatArray, Image
from annulus_pipe.rings.calibration.contours import Contours, Look, close_grid, read_colours, wide_grid
from annulus_pipe.rings.diagnosis import LOST_MOST
from annulus_pipe.vocabulary import AnnulusError

SEEN_LEAST = 0.25  # of all rings in all directions: less is no frame to calibrate with; test_pipe


def decode_frames(
    frames: Sequence[Sampled], camera: Camera, look: Look, scan: Path, report: Progress
) -> tuple[dict[int, Contours], list[int], dict[int, str]]:
    """Contours of the frames that can be used, which those are, and why the others cannot."""
    left_out = {
        frame.index: f"dark, nothing brighter than {frame.exposure.bright:.0f} of 255: lens cap on, or projector off"
        for frame in frames
        if frame.exposure.dark and look.colours
    }
    lit = [i for i, frame in enumerate(frames) if not (frame.exposure.dark and look.colours)]
    if not lit:
        raise AnnulusError(
            f"{scan}: all {len(frames)} projector frames are dark (nothing brighter than "
            f"{max(frame.exposure.bright for frame in frames):.0f} of 255): lens cap on, or projector off."
        )
    enough = SEEN_LEAST * look.rings

    def fair(contour: Contours, grid_lines: int) -> bool:
        return len(contour.ring) >= enough * grid_lines

    grid = wide_grid(camera, np.array([camera.cx, camera.cy]))
    lines = len(grid.cosine)
    contours: dict[int, Contours] = {}
    for done, i in enumerate(lit):
        contours[i] = look.follow(frames[i].image, grid)
        if not fair(contours[i], lines):  # the pattern may lie beside the camera's axis
            other = look.follow(frames[i].image, wide_grid(camera, _light_centre(frames[i].image)))
            contours[i] = max(contours[i], other, key=lambda contour: len(contour.ring))
        report("find rings", done + 1, 2 * len(lit))
    kept = [i for i in lit if fair(contours[i], lines)]
    if kept:
        grid = close_grid(camera, [contours[i] for i in kept])
        for done, i in enumerate(lit):
            contours[i] = look.follow(frames[i].image, grid)
            report("find rings", len(lit) + done + 1, 2 * len(lit))
        kept = [i for i in lit if fair(contours[i], lines)]
    for i in lit:
        if i not in kept:
            exposure = frames[i].exposure
            left_out[frames[i].index] = (
                f"over-exposed, {100 * exposure.lost:.0f} % of the stripes have lost their colour"
                if exposure.lost > LOST_MOST and look.colours
                else f"{look.what} not found in it ({contours[i].slits} {look.marks} seen)"
            )
    if len(kept) < 2:
        raise AnnulusError(f"{scan}: {_why_none(frames, contours, kept, lit, look, camera)}.")
    missing = [k + 1 for k in range(look.rings) if all(np.isnan(contours[i].reach[k, 1]) for i in kept)]
    if missing:
        rings = f"ring{'s' if len(missing) > 1 else ''} {', '.join(map(str, missing))}"
        if not look.colours:
            raise AnnulusError(f"{scan}: {rings} of {look.rings} bright lines, from the innermost, seen in no frame.")
        read = read_colours(frames[kept[0]].image, grid)
        raise AnnulusError(
            f"{scan}: {rings} of the pattern {look.colours} "
            f"(counted from the innermost) seen in no frame; the stripes read {read}. Check pattern.colours."
        )
    if look.colours:  # a laser's line may be at full scale
        contours = {i: contours[i].whole() for i in lit}
    return contours, kept, left_out


def over_exposed(contours: Iterable[Contours]) -> tuple[int, ...]:
    """Rings, from 1, most of whose slits lie beside stripes at full scale."""
    ring, clipped = (np.concatenate(part) for part in zip(*((one.ring, one.clipped) for one in contours), strict=True))
    return tuple(int(k) + 1 for k in np.unique(ring) if clipped[ring == k].mean() > 0.5)


def _why_none(
    frames: Sequence[Sampled],
    contours: dict[int, Contours],
    kept: Sequence[int],
    lit: Sequence[int],
    look: Look,
    camera: Camera,
) -> str:
    if len(frames) == 1:
        return "one projector frame, expected at least two, the head leaning to opposite sides (better four and more)"
    over = [i for i in lit if look.colours and i not in kept and frames[i].exposure.lost > LOST_MOST]
    if over:
        worst = max(frames[i].exposure.lost for i in over)
        return (
            f"{len(over)} of {len(frames)} projector frames over-exposed (up to {100 * worst:.0f} % of the stripes "
            "have lost their colour): shorten the projector's flash or lower the gain"
        )
    i = max(lit, key=lambda i: contours[i].slits)
    grid = wide_grid(camera, np.array([camera.cx, camera.cy]))
    if look.colours and contours[i].slits > len(grid.cosine):
        return (
            f"slits are seen but not in the order of pattern.colours {look.colours}; the stripes read "
            f"{read_colours(frames[i].image, grid)} from the innermost. Check pattern.colours"
        )
    dark = len(frames) - len(lit)
    return (
        f"the {look.what} are found in {len(kept)} of {len(frames)} projector frames"
        + (f", {dark} are dark" if dark else "")
        + "; two and more are needed. Is this a scan of a clean pipe, with the projector on?"
    )


def _light_centre(image: Image) -> FloatArray:
    top = image[::8, ::8].max(axis=2).astype(float)
    top = np.where(top > 0.3 * np.percentile(top, 99), 1.0, 0.0)
    y, x = np.indices(top.shape)
    return np.array([8 * np.average(x, weights=top), 8 * np.average(y, weights=top)])
