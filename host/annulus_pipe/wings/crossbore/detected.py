"""A log on disk to what was detected in it: a summary for programs; where asked for, bores and a picture as files."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.log_file import read_bore_log
from annulus_pipe.wings.crossbore.measure import (
    BoreDetections,
    BoreIndication,
    CapacitiveHead,
    Log,
    PipeGrid,
    detect,
    on_grid,
)
from annulus_pipe.wings.crossbore.picture import write_bores


class LogDetections(NamedTuple):
    """summary : for programs. has_loss : whether the log has the sectors' loss. files : written."""

    account: BoreDetections
    grid: PipeGrid
    has_loss: bool
    summary: dict[str, Any]
    files: list[Path]


def detect_in_log(
    log: Path, out: Path | None, air_pf: float | None, coupling_ff: float | None, joints_mm: Sequence[float]
) -> LogDetections:
    """air_pf, coupling_ff : of this head, in place of the usual one's. AnnulusError naming the log."""
    head = CapacitiveHead()
    if air_pf is not None:
        head = replace(head, air_ff=1000 * air_pf)
    if coupling_ff is not None:
        head = replace(head, coupling_ff=coupling_ff)
    rows = Log(*read_bore_log(log))
    try:
        grid = on_grid(rows, head)
        account = detect(grid, head, joints_mm=joints_mm)
    except AnnulusError as error:
        raise AnnulusError(f"{log}: {error}") from None
    bores = [_detection(one) for one in account.bores]
    others = [_detection(one) for one in account.indications if one not in account.bores]
    files = write_bores(out, bores, others, grid.z_mm, grid.c_ff, grid.seen) if out is not None else []
    summary = {
        "log": str(log),
        "length_mm": account.length_mm,
        "unseen_mm": account.unseen_mm,
        "ends_mm": account.ends_mm,
        "water_told_mm": account.water_told_mm,
        "wanders": account.wanders,
        "rows_without_reading": grid.unread,
        "spikes": grid.spikes,
        "gaps": [
            {"sectors": list(gap.sectors), "from_mm": gap.from_mm, "to_mm": gap.to_mm, "why": str(gap.why)}
            for gap in account.gaps
        ],
        "lift_off_ff_per_mm": grid.lift_ff_mm,
        "bores": bores,
        "others": others,
        "files": [str(f) for f in files],
    }
    return LogDetections(account, grid, rows.loss_ff is not None, summary, files)


def _detection(one: BoreIndication) -> dict[str, Any]:
    content: dict[str, Any] = {
        "odometer_mm": round(one.odometer_mm, 1),
        "kind": str(one.kind),
        "extent_mm": round(one.extent_mm, 1),
        "change_ff": [round(float(v), 1) for v in one.change_ff],
    }
    if math.isfinite(one.phi_deg):
        content |= {"phi_deg": round(one.phi_deg, 1), "phi_sigma_deg": round(one.phi_sigma_deg, 1)}
    if math.isfinite(one.speed_mm_s[0]):
        content["speed_mm_s"] = {"transient": round(one.speed_mm_s[0], 1), "odometer": round(one.speed_mm_s[1], 1)}
    if one.odds:
        content["odds"] = {fate: round(value, 4) for fate, value in one.odds.items()}
    if math.isfinite(one.loss_ff):
        content["loss_ff"] = round(one.loss_ff, 1)
    return content
