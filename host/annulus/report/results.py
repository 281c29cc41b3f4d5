"""All result files of one scan: cloud, mesh, maps, stations, summary, report."""

import csv
import json
import math
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus.geometry.calibration import Calibration
from annulus.report import figures
from annulus.report.page import render_page
from annulus.report.ply import write_ply
from annulus.report.summary import Summary, summarize
from annulus.report.surface import triangulate
from annulus.rings.diagnosis import Finding
from annulus.vocabulary import AnnulusError
from annulus.wall.consistency import without_inconsistent
from annulus.wall.defects import Defect, find_defects
from annulus.wall.grid import Wall, build_wall
from annulus.wall.profile import Profile
from annulus.wall.registration import register
from annulus.wall.shadow import shadowed
from annulus.wall.stations import Stations, measure_stations
from annulus.wall.texture import LedFrame, paint
from annulus.wall.vibration import without_vibration

__all__ = ["LedFrame", "Summary", "prepare_folder", "write_results"]

Truth = Mapping[str, Any] | Callable[[Sequence[Profile], Sequence[Defect]], Mapping[str, Any]]

CLOUD_NOTE = "annulus point cloud, pipe frame, mm: x right, y down, z along the pipe; sigma = of the radius, k = 1"
FILES = ("cloud.ply", "mesh.ply", "unwrapped.png", "texture.png", "stations.csv", "report.html", "summary.json")


def write_results(
    out: Path,
    calibration: Calibration,
    profiles: Sequence[Profile],
    led_frames: Iterable[LedFrame],
    *,
    frames: Mapping[str, int],
    drops: Mapping[str, int],
    timing_ms: Mapping[str, float],
    source: str,
    truth: Truth | None = None,
    findings: Sequence[Finding] = (),
    vibration: bool = False,
    fps: float | None = None,
) -> Summary:
    """Build the wall from the profiles and write every result file of ARCHITECTURE §7 into `out`.

    Parameters
    ----------
    profiles : of the projector frames, any order. led_frames : read once, one at a time.
    frames : how many by label. drops : everything that was lost, by kind. source : what was scanned, for people.
    truth : scores on the twin, or who gives them for the points and defects found; passed through, never looked at.
    findings : what is wrong with the frames, for people. vibration : take out what shakes periodically; fps names it.

    Raises
    ------
    AnnulusError when nothing was measured or `out` cannot be written.

    Notes
    -----
    Files are made in a folder beside the old ones and moved into place at the end, summary.json last: a crash leaves
    no half file, and a summary always belongs to the files beside it.
    """
    started = time.perf_counter()
    prepare_folder(out)
    profiles = without_inconsistent(register(profiles))
    shaken = None
    if vibration:
        profiles, shaken = without_vibration(profiles, fps)
    narrowest, widest = calibration.rings[0].half_angle, calibration.rings[-1].half_angle
    wall = build_wall(profiles, rise=math.tan(widest))
    places = find_defects(wall, shadow_ratio=1.0 / math.tan(narrowest), least_shadow_ratio=1.0 / math.tan(widest))
    scores = truth(profiles, places.defects) if callable(truth) else truth
    stations = measure_stations(wall)
    dark = shadowed(wall.radius_mm.astype(np.float64), wall.z_step_mm, math.tan(narrowest))
    texture = paint(wall, calibration, profiles, led_frames)
    if texture is not None:
        texture[dark] = 0  # the radius there is not known, so neither is what was seen of it
    timing = {**timing_ms, "results_wall": (time.perf_counter() - started) * 1e3}
    try:
        staging = Path(tempfile.mkdtemp(prefix=".annulus-", dir=out))
        try:
            points = _write_cloud(staging / "cloud.ply", profiles)
            pictures = figures.draw(wall, dark, places, stations, texture, 2 * calibration.pipe_radius_mm)
            _write_mesh(staging / "mesh.ply", wall, texture, pictures.deviation_rgb)
            (staging / "unwrapped.png").write_bytes(pictures.unwrapped)
            (staging / "texture.png").write_bytes(pictures.texture)
            _write_stations(staging / "stations.csv", stations)
            timing["results_total"] = (time.perf_counter() - started) * 1e3
            summary = summarize(
                wall,
                dark,
                places,
                stations,
                2 * calibration.pipe_radius_mm,
                profiles,
                points,
                frames,
                drops,
                timing,
                source,
                scores,
                tuple(findings),
                shaken,
            )
            (staging / "report.html").write_text(render_page(summary, places, pictures), encoding="utf-8")
            text = json.dumps(summary.to_dict(), indent=1, ensure_ascii=False, allow_nan=False)
            (staging / "summary.json").write_text(text + "\n", encoding="utf-8")
            (out / "summary.json").unlink(missing_ok=True)
            for name in FILES:
                (staging / name).replace(out / name)
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        raise AnnulusError(f"{out}: results cannot be written ({error.strerror or error}).") from None
    return summary


def prepare_folder(out: Path) -> None:
    """Make the results' folder. Raises AnnulusError when it is a file or cannot be written to."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except (FileExistsError, NotADirectoryError):
        raise AnnulusError(f"{out}: is a file, or lies below one. Expected a folder for the results.") from None
    except OSError as error:
        raise AnnulusError(
            f"{out}: cannot be written to ({error.strerror}). Expected a folder for the results."
        ) from None


def _write_cloud(path: Path, profiles: Sequence[Profile]) -> int:
    total = sum(len(profile.points_mm) for profile in profiles)
    records = np.empty(
        total,
        dtype=[
            ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("radius", "<f4"),
            ("frame", "<i4"), ("ring", "u1"), ("sigma", "<f4"),
        ],
    )  # fmt: skip
    at = 0
    for profile in sorted(profiles, key=lambda one: one.frame):
        part = records[at : at + len(profile.points_mm)]
        for axis, name in enumerate("xyz"):
            part[name] = profile.points_mm[:, axis]
        for channel, name in enumerate(("red", "green", "blue")):
            part[name] = profile.colour[:, channel]
        part["radius"] = np.hypot(profile.points_mm[:, 0], profile.points_mm[:, 1])
        part["sigma"], part["frame"], part["ring"] = profile.sigma_mm, profile.frame, profile.ring
        at += len(part)
    write_ply(path, records, note=CLOUD_NOTE)
    return total


def _write_mesh(path: Path, wall: Wall, texture: NDArray[np.uint8] | None, fallback: NDArray[np.uint8]) -> None:
    points, triangles, flat = triangulate(wall)
    colour = fallback
    if texture is not None:
        colour = np.where(texture[..., 3:] > 0, texture[..., :3], fallback)
    records = np.empty(
        len(points),
        dtype=[
            ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1"),
            ("quality", "<f4"),
        ],
    )  # fmt: skip
    for axis, name in enumerate("xyz"):
        records[name] = points[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        records[name] = colour.reshape(-1, 3)[flat, channel]
    records["quality"] = wall.deviation_mm().reshape(-1)[flat]
    write_ply(path, records, triangles, note="annulus wall, pipe frame, mm; quality = deviation of the radius, mm")


def _write_stations(path: Path, stations: Stations) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            [
                "z_mm", "diameter_min_mm", "diameter_max_mm", "diameter_mean_mm", "ovality_f1216_percent",
                "shape_ovality_f1216_percent", "valid_fraction", "diameter_k2_mm",
            ]
        )  # fmt: skip
        columns = zip(
            stations.z_mm, stations.diameter_min_mm, stations.diameter_max_mm, stations.diameter_mean_mm,
            stations.ovality_percent, stations.shape_ovality_percent, stations.valid_fraction, stations.diameter_k2_mm,
            strict=True,
        )  # fmt: skip
        for row in columns:
            writer.writerow([f"{value:.4f}" if math.isfinite(value) else "" for value in row])
