"""From an opened scan to its result files: a plate's heights, or a pipe's survey and the fine map behind it."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from annulus_pipe.hooks import WingContext, WingResults
from annulus_pipe.numeric.rounding import MEASURE, SHARE, off, quoted, span
from annulus_pipe.report import Paper, ScanAccount, write
from annulus_pipe.reprocess.executors import Executor
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.wall.conformity import judge
from annulus_pipe.wings.fringe.job import FringeJob
from annulus_pipe.wings.fringe.measure.plate import Plate
from annulus_pipe.wings.fringe.pipe import FringePipeJob, MeasuredPipe, Progress, reconstruct_fringe_pipe
from annulus_pipe.wings.fringe.plate import reconstruct_fringe
from annulus_pipe.wings.fringe.plate_page import write_plate

BY = {
    "slide": "the slide: its calibrated phase says the height",
    "cameras": "the cameras: the height at which both see one phase; the slide's own calibration is not used",
}


def measured(
    job: FringeJob | FringePipeJob,
    executor: Executor,
    place: StoragePath,
    out: Path,
    context: WingContext,
    *,
    progress: Progress,
    paper: Paper | None,
    keep: bool,
) -> WingResults:
    """All result files, into `out`. place, keep : windows are kept there, and found again."""
    kept = place if keep else None
    if isinstance(job, FringePipeJob):
        return _of_pipe(reconstruct_fringe_pipe(job, progress, executor, kept), job, context, out, paper)
    return _of_plate(reconstruct_fringe(job, progress, executor, kept), job, context, out, paper)


def _of_pipe(
    measured: MeasuredPipe, job: FringePipeJob, context: WingContext, out: Path, paper: Paper | None
) -> WingResults:
    counts = job.scan.counts()
    drops = {**job.scan.lost(), "frames_unknown": counts["unknown"]}
    verdict = None if context.limits is None else judge(measured.survey, context.limits)
    rows = ScanAccount(
        context.source, counts, drops, measured.timing_ms, measured.findings, origin=context.origin, verdict=verdict
    )
    seen = measured.map
    depth = {
        "phi_deg": seen.phi_deg,
        "z_mm": seen.z_mm,
        "radius_mm": seen.radius_mm,
        "sigma_mm": seen.sigma_mm,
        "at_least": seen.at_least,
        "light": seen.dc,
        "modulation": seen.modulation,
    }
    return WingResults(
        write(measured.survey, rows, out, depth=depth, paper=paper), None, measured.windows, measured.made
    )


def _of_plate(plate: Plate, job: FringeJob, context: WingContext, out: Path, paper: Paper | None) -> WingResults:
    counts = job.scan.counts()
    drops = {**job.scan.lost(), "frames_unknown": counts["unknown"]}
    summary = write_plate(plate, ScanAccount(context.source, counts, drops, plate.timing_ms), out, paper=paper)
    return WingResults(summary, tuple(_lines(summary, counts, plate.by)), plate.windows, plate.made)


def _lines(summary: Mapping[str, Any], counts: Mapping[str, int], by: str) -> Iterator[str]:
    yield f"by         {BY[by]}"
    height, sigma, places = (summary[key] for key in ("height_mm", "sigma_mm", "places"))
    yield f"frames     {', '.join(f'{n} {label}' for label, n in counts.items())}"
    yield (
        f"motion     {quoted(places['length_mm'], MEASURE)} in {places['flashes']} flashes; x_mm up to "
        f"{quoted(places['off_odometer_mm'], MEASURE)} off what the frames say"
    )
    yield f"points     {summary['points']}, {quoted(100 * summary['completeness'], SHARE)} of what the slide lit"
    if height["median"] is None:
        yield "height     not measured: of no place could a height be told"
    else:
        yield f"height     {span(height['min'], height['max'], MEASURE)}, median {quoted(height['median'], MEASURE)}"
        median, worst = (off(2 * sigma[name], MEASURE) for name in ("p50", "p95"))
        yield f"known to   ± {median} (k=2, median), ± {worst} in the worst twentieth"
    for reason, cells in summary["untold"].items():
        yield f"not told   {cells} places: {reason}"
    for warning in summary["warnings"]:
        yield f"warning    {warning['text']}"
