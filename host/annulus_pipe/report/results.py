"""All result files of one scan: cloud, mesh, maps, stations, summary, report."""

import contextlib
import csv
import json
import math
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.report import client
from annulus_pipe.report.account import ScanAccount
from annulus_pipe.report.pdf import Paper, to_pdf
from annulus_pipe.report.ply import write_ply
from annulus_pipe.report.summary import summarize
from annulus_pipe.untrusted import require_replaceable
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wall.stations import Stations
from annulus_pipe.wall.survey import Survey

CLOUD_NOTE = "annulus point cloud, mm: x right, y down, z along the first straight pipe; sigma = of the radius, k = 1"
MESH_NOTE = "annulus wall, mm, in the frame of the cloud; quality = deviation of the radius, mm"
FILES = (
    "cloud.ply",
    "mesh.ply",
    "unwrapped.png",
    "texture.png",
    "stations.csv",
    "wall.npz",
    "centreline.json",
    "report.html",
    "summary.json",
)
WALL_FORMAT = "annulus-wall/1"
NOT_SEEN_UM, UNKNOWN_UM = -32768, 65535  # of a deviation, of its sigma
LINE_STEP_MM = 10.0  # between points of the line in centreline.json
SUMMARY, WALL = "summary.json", "wall.npz"
DEPTH, PDF = "depth.npz", "report.pdf"  # of methods whose map is finer than the report's; where it is asked for


def write(
    survey: Survey,
    account: ScanAccount,
    out: Path,
    *,
    depth: Mapping[str, NDArray[Any]] | None = None,
    paper: Paper | None = None,
) -> dict[str, Any]:
    """Write every result file of a survey into the folder `out`. Returns what summary.json says.

    depth : arrays of a finer map of the wall, for depth.npz; none without. paper : of report.pdf; none without.

    Raises
    ------
    AnnulusError when `out` cannot be written.

    """
    from annulus_pipe.report import figures  # matplotlib: not by whom refuses, or only asks what is in a folder
    from annulus_pipe.report.page import render_page

    started = time.perf_counter()
    with staged(out) as staging:
        _write_cloud(staging / "cloud.ply", survey)
        pictures = figures.draw(survey, account.origin.observations)
        _write_mesh(staging / "mesh.ply", survey, pictures.deviation_rgb)
        (staging / "unwrapped.png").write_bytes(pictures.unwrapped)
        (staging / "texture.png").write_bytes(pictures.texture)
        write_stations(staging / "stations.csv", survey.stations)
        _write_wall(staging / WALL, survey)
        write_centreline(staging / "centreline.json", survey)
        if depth is not None:
            np.savez(staging / DEPTH, **dict[str, Any](depth))
        summary = summarize(survey, account, 1e3 * (time.perf_counter() - started), pictures.beside)
        page = render_page(survey, summary, pictures, **client.values(survey, account), windows=[])
        write_page(staging, page, paper)
        text = json.dumps(summary, indent=1, ensure_ascii=False, allow_nan=False)
        (staging / SUMMARY).write_text(text + "\n", encoding="utf-8")
    return summary


def write_page(folder: Path, page: str, paper: Paper | None) -> None:
    """report.html, and report.pdf where a paper is named."""
    (folder / "report.html").write_text(page, encoding="utf-8")
    if paper is not None:
        (folder / PDF).write_bytes(to_pdf(page, paper))


@contextlib.contextmanager
def staged(out: Path) -> Iterator[Path]:
    """A folder for result files, which are moved into `out` when all are made, summary.json last: a crash leaves no
    half file, and a summary always belongs to the files beside it. AnnulusError when `out` cannot be written."""
    prepare_folder(out)
    try:
        staging = Path(tempfile.mkdtemp(prefix=".annulus-", dir=out))
        try:
            yield staging
            for file in staging.iterdir():
                _require_replaceable(out / file.name)
            (out / SUMMARY).unlink(missing_ok=True)
            for name in (DEPTH, PDF):  # of a scan before
                (out / name).unlink(missing_ok=True)
            for file in sorted(staging.iterdir(), key=lambda file: file.name == SUMMARY):
                file.replace(out / file.name)
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        raise AnnulusError(f"{out}: results cannot be written ({error.strerror or error}).") from None


def _require_replaceable(path: Path) -> None:
    try:
        require_replaceable(path)
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None


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


def _write_cloud(path: Path, survey: Survey) -> None:
    records = np.empty(
        survey.points,
        dtype=[
            ("x", "<f4"),
            ("y", "<f4"),
            ("z", "<f4"),
            ("red", "u1"),
            ("green", "u1"),
            ("blue", "u1"),
            ("radius", "<f4"),
            ("frame", "<i4"),
            ("ring", "u1"),
            ("sigma", "<f4"),
            ("camera", "u1"),
        ],
    )
    at, line = 0, survey.centreline
    for profile in sorted(survey.profiles, key=lambda one: one.frame):
        part = records[at : at + len(profile.points_mm)]
        space = profile.points_mm if line.is_straight else line.to_space(profile.points_mm.astype(np.float64))
        for axis, name in enumerate("xyz"):
            part[name] = space[:, axis]
        for channel, name in enumerate(("red", "green", "blue")):
            part[name] = profile.colour[:, channel]
        part["radius"] = np.hypot(profile.points_mm[:, 0], profile.points_mm[:, 1])
        part["sigma"], part["frame"], part["ring"] = profile.sigma_mm, profile.frame, profile.ring
        part["camera"] = profile.seen_by
        at += len(part)
    write_ply(path, records, note=CLOUD_NOTE)


def _write_mesh(path: Path, survey: Survey, fallback: NDArray[np.uint8]) -> None:
    mesh, texture = survey.mesh(), survey.texture
    colour = fallback
    if texture is not None:
        colour = np.where(texture[..., 3:] > 0, texture[..., :3], fallback)
    records = np.empty(
        len(mesh.points_mm),
        dtype=[
            ("x", "<f4"),
            ("y", "<f4"),
            ("z", "<f4"),
            ("red", "u1"),
            ("green", "u1"),
            ("blue", "u1"),
            ("quality", "<f4"),
        ],
    )
    for axis, name in enumerate("xyz"):
        records[name] = mesh.points_mm[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        records[name] = colour.reshape(-1, 3)[mesh.cell, channel]
    records["quality"] = survey.wall.deviation_mm().reshape(-1)[mesh.cell]
    write_ply(path, records, mesh.triangles, note=MESH_NOTE)


def write_stations(path: Path, stations: Stations) -> None:
    """stations.csv, one line a station; an empty field where nothing could be measured."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            [
                "z_mm",
                "diameter_min_mm",
                "diameter_max_mm",
                "diameter_mean_mm",
                "ovality_f1216_percent",
                "shape_ovality_f1216_percent",
                "valid_fraction",
                "diameter_k2_mm",
                "diameter_x_mm",
                "diameter_y_mm",
                "circumference_mm",
                "circumference_k2_mm",
                "area_mm2",
                "area_k2_mm2",
                "diameter_min_k2_mm",
                "diameter_max_k2_mm",
            ]
        )
        columns = zip(
            stations.z_mm,
            stations.diameter_min_mm,
            stations.diameter_max_mm,
            stations.diameter_mean_mm,
            stations.ovality_percent,
            stations.shape_ovality_percent,
            stations.valid_fraction,
            stations.diameter_k2_mm,
            stations.diameter_x_mm,
            stations.diameter_y_mm,
            stations.circumference_mm,
            stations.circumference_k2_mm,
            stations.area_mm2,
            stations.area_k2_mm2,
            stations.diameter_min_k2_mm,
            stations.diameter_max_k2_mm,
            strict=True,
        )
        for row in columns:
            writer.writerow([f"{value:.4f}" if math.isfinite(value) else "" for value in row])


def write_centreline(path: Path, survey: Survey) -> None:
    """centreline.json: pieces of the line, bends, the line as points, the camera's path; mm and degrees.

    Space is the frame of the first straight: x right, y down, z forward. An offset or turn is against the end of the
    piece before, right and down; `plane_deg` is atan2(down, right) of where a bend turns to.
    """
    line = survey.centreline
    start, end = survey.scanned_mm
    chainage = np.unique(np.append(np.arange(start, end, LINE_STEP_MM), end))
    points = line.to_space(np.column_stack([np.zeros((len(chainage), 2)), chainage]))
    outcome = {
        "format": "annulus-centreline/1",
        "frame": "x right, y down, z forward along the first straight, mm",
        "pipe_radius_mm": round(survey.wall.mean_radius_mm, 4),
        "straight": line.is_straight,
        "pieces": [
            {
                "start_mm": round(piece.start_mm, 3),
                "radius_mm": round(piece.radius_mm, 4),
                "taper_mm_per_mm": round(piece.taper, 6),
                "offset_mm": [round(v, 4) for v in piece.offset_mm],
                "turn_deg": [round(math.degrees(v), 4) for v in piece.turn],
                "curvature_per_m": [round(1e3 * v, 6) for v in piece.curvature],
            }
            for piece in (line.pieces if not line.is_straight else ())
        ],
        "bends": [
            {one.name: round(one.value, 4) for one in bend.measures}
            | {one.k2_name: round(one.k2, 4) for one in bend.measures}
            for bend in survey.features
            if bend.kind is FeatureKind.BEND
        ],
        "line_mm": [[round(float(v), 3) for v in (s, *p)] for s, p in zip(chainage, points, strict=True)],
        "camera_path": [[frame, *(round(float(v), 3) for v in place)] for frame, place in _camera_path(survey)],
    }
    path.write_text(json.dumps(outcome, indent=1) + "\n", encoding="utf-8")


def _camera_path(survey: Survey) -> list[tuple[int, np.ndarray[Any, Any]]]:
    """Frame and place in space of every projector frame with a pose, mm."""
    out = []
    for profile in sorted(survey.profiles, key=lambda one: one.frame):
        if profile.pose is not None:
            local = profile.pose.to_pipe(np.zeros((1, 3)))
            in_pipe = survey.centreline.from_head(local, profile.z_mm)
            out.append((profile.frame, survey.centreline.to_space(in_pipe)[0]))
    return out


def _write_wall(path: Path, survey: Survey) -> None:
    """The wall map as plain arrays, rows along the pipe, columns clockwise from 12 o'clock looking forward.

    deviation_um [z, clock] int16: the wall's distance from the pipe's axis less `radius_mm`, the nominal radius, by
    which surveys of two years compare; -32768 where not seen, -32767 and 32767 for that or more. sigma_um [z, clock]
    uint16: its standard deviation (k = 1), what a point may be off and the noise of the cell; 65535 where nobody knows.
    scale_part, oval_part: of the radius, what all of them, and the long one's excess, may be off alike (k = 1) besides.
    shadowed [z, clock] bool: a step keeps the light from there. imu_roll_deg [z]: how far 12 o'clock is still turned:
    0 where the head's roll was measured, and so taken out, NaN where no sensor gave it.
    """
    wall = survey.wall
    nominal = survey.nominal_diameter_mm / 2
    seen = np.isfinite(wall.radius_mm)
    away = np.clip(np.rint(1e3 * (wall.radius_mm.astype(np.float64) - nominal)), NOT_SEEN_UM + 1, -NOT_SEEN_UM - 1)
    sigma = 1e3 * np.hypot(wall.sigma_mm.astype(np.float64), wall.cell_noise_mm)
    sigma = np.where(seen & np.isfinite(sigma), np.clip(np.ceil(sigma), 0, UNKNOWN_UM - 1), UNKNOWN_UM)
    arrays: dict[str, Any] = {
        "format": WALL_FORMAT,
        "deviation_um": np.where(seen, away, NOT_SEEN_UM).astype(np.int16),
        "sigma_um": sigma.astype(np.uint16),
        "shadowed": survey.shadowed,
        "z_mm": wall.z_mm,
        "z_step_mm": wall.z_step_mm,
        "clock_deg": wall.clock_deg,
        "scale_part": np.nan if survey.scale is None else wall.scale_part,
        "oval_part": np.nan if survey.scale is None else wall.oval_part,
        "radius_mm": nominal,
        "radius_of": "nominal",
        "mean_radius_mm": wall.mean_radius_mm,
        "imu_roll_deg": np.full(len(wall.z_mm), np.nan if survey.roll_range_deg is None else 0.0, np.float32),
    }
    np.savez_compressed(path, **arrays)
