"""Results of a pipe too long for one sheet of everything: each window's in a folder of its own, and of the whole what
can be held and read.

    OUT/report.html, summary.json, stations.csv, wall.npz, unwrapped.png, texture.png, centreline.json
    OUT/windows/0001/cloud.ply, mesh.ply, report.html ..      # as of a short scan, a metre or so of pipe in each

The whole's map is drawn in longer rows; its `wall.npz` has every row of every window, `stations.csv` every station.
"""

import json
import shutil
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.rounding import DISTANCE, MEASURE, quoted, span
from annulus_pipe.report import client
from annulus_pipe.report.account import ScanAccount
from annulus_pipe.report.pdf import Paper
from annulus_pipe.report.results import SUMMARY, WALL, staged, write, write_centreline, write_page, write_stations
from annulus_pipe.report.summary import summarize
from annulus_pipe.wall.joined import Joined
from annulus_pipe.wall.survey import Survey

ROWS = ("deviation_um", "sigma_um", "shadowed", "z_mm", "imu_roll_deg")  # of wall.npz, one entry or line a row
WINDOWS = "windows"


def window_folder(out: Path, number: int) -> Path:
    """Of one window's results, numbered from 0 along the pipe."""
    return out / WINDOWS / f"{number + 1:04d}"


def keep_windows(out: Path, numbers: Sequence[int] = ()) -> None:
    """Without windows of a scan before, but those that are this one's."""
    kept = {window_folder(out, number) for number in numbers}
    for folder in (out / WINDOWS).glob("*"):
        if folder not in kept:
            shutil.rmtree(folder, ignore_errors=True)
    if not kept:
        shutil.rmtree(out / WINDOWS, ignore_errors=True)


def write_window(survey: Survey, account: ScanAccount, out: Path, number: int) -> None:
    """One window's results, all that a short scan has. A summary of the whole that is there is of another scan, or of
    what the window was: it goes."""
    (out / SUMMARY).unlink(missing_ok=True)
    write(survey, account, window_folder(out, number))


def write_whole(
    pipe: Joined, account: ScanAccount, out: Path, numbers: Sequence[int], *, paper: Paper | None = None
) -> dict[str, Any]:
    """What all windows together say, beside their folders, which must be there; others go. Returns what summary.json
    says.

    Raises AnnulusError when `out` cannot be written.
    """
    from annulus_pipe.report import figures  # matplotlib, as `results.write`
    from annulus_pipe.report.page import render_page

    started = time.perf_counter()
    keep_windows(out, numbers)
    folders = [window_folder(out, number) for number in sorted(numbers)]
    with staged(out) as staging:
        pictures = figures.draw(pipe, account.origin.observations)
        (staging / "unwrapped.png").write_bytes(pictures.unwrapped)
        (staging / "texture.png").write_bytes(pictures.texture)
        write_stations(staging / "stations.csv", pipe.stations)
        _write_walls(staging / WALL, [folder / WALL for folder in folders])
        write_centreline(staging / "centreline.json", pipe)
        summary = summarize(pipe, account, 1e3 * (time.perf_counter() - started), pictures.beside)
        summary["windows"] = [_window_summary(folder) for folder in folders]
        more = client.values(pipe, account) | {"windows": [_row(one) for one in summary["windows"]]}
        write_page(staging, render_page(pipe, summary, pictures, **more), paper)
        text = json.dumps(summary, indent=1, ensure_ascii=False, allow_nan=False)
        (staging / SUMMARY).write_text(text + "\n", encoding="utf-8")
    return summary


def _window_summary(folder: Path) -> dict[str, Any]:
    """Of one window, for the summary of all."""
    own = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    scanned = own["scanned_mm"]
    return {
        "folder": f"{WINDOWS}/{folder.name}",
        "from_mm": scanned["from"],
        "to_mm": scanned["to"],
        "points": own["points"],
        "defects": len(own["defects"]),
        "features": len(own["features"]),
        "diameter_mean_mm": own["diameter_mm"]["mean"],
        "seen_percent": own["seen_percent"],
    }


def _row(one: Mapping[str, Any]) -> dict[str, Any]:
    mean = one["diameter_mean_mm"]
    return {
        "folder": one["folder"],
        "stretch": span(one["from_mm"], one["to_mm"], DISTANCE),
        "defects": one["defects"],
        "features": one["features"],
        "points": one["points"],
        "seen": f"{one['seen_percent']:.0f} %",
        "diameter": "" if mean is None else quoted(mean, MEASURE),
    }


def _write_walls(path: Path, windows: Sequence[Path]) -> None:
    """All windows' wall.npz as one, row after row; no more of them in memory than one. Rows that no window has, between
    two that have some, are written as not seen."""
    shapes = [_rows_of(one) for one in windows]
    step = max(step for _, _, step in shapes)
    first = shapes[0][0]
    rows = round((shapes[-1][1] - first) / step) + 1
    with np.load(windows[0], allow_pickle=False) as head:
        whole = {name: head[name] for name in head.files if name not in ROWS}
        lines = {name: head[name] for name in ROWS}
    whole["mean_radius_mm"] = np.float64(np.median([_member(one, "mean_radius_mm") for one in windows]))
    whole["z_step_mm"] = np.float64(step)
    unseen = {"deviation_um": -32768, "sigma_um": 65535, "shadowed": False, "imu_roll_deg": np.nan}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive:
        for name, value in whole.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, np.asanyarray(value), allow_pickle=False)
        for name in ROWS:
            kind, width = lines[name].dtype, lines[name].shape[1:]
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                about = {"descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": (rows, *width)}
                np.lib.format.write_array_header_1_0(file, about)
                for part in _laid(windows, shapes, name, kind, width, first, step, unseen.get(name, 0)):
                    file.write(np.ascontiguousarray(part).tobytes())


def _laid(
    windows: Sequence[Path],
    shapes: Sequence[tuple[float, float, float]],
    name: str,
    kind: "np.dtype[Any]",
    width: tuple[int, ...],
    first: float,
    step: float,
    empty: Any,
) -> Iterator[NDArray[Any]]:
    done = 0
    for window, (begin, _, _) in zip(windows, shapes, strict=True):
        at = round((begin - first) / step)
        if at > done:
            gap = first + step * np.arange(done, at) if name == "z_mm" else np.full((at - done, *width), empty, kind)
            yield gap.astype(kind)
        part = _member(window, name)
        yield part
        done = at + len(part)


def _rows_of(path: Path) -> tuple[float, float, float]:
    """First and last row, and the length of one, mm."""
    z, step = _member(path, "z_mm"), float(_member(path, "z_step_mm"))
    return float(z[0]), float(z[-1]), step


def _member(path: Path, name: str) -> NDArray[Any]:
    with np.load(path, allow_pickle=False) as archive:
        return np.asarray(archive[name])
