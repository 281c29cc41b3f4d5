"""What `annulus bore detect` says of drawn logs: sewers, their kind, direction and odds, against their truth."""

import math
from pathlib import Path

import numpy as np

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.log_file import read_bore_log
from annulus_pipe.wings.crossbore.measure import (
    BORES,
    BoreDetections,
    BoreIndication,
    BoreKind,
    CapacitiveHead,
    Log,
    PipeGrid,
    detect,
    likely,
    on_grid,
)
from tools.bench.blind.others.bore_logs import Drawn, Sewer, draw, logged
from tools.bench.blind.others.tally import Case
from tools.bench.blind.score import Number

BESIDE_MM = 40.0  # of a sewer's stretch: what is listed there is it
APART_MM = 250.0  # from any sewer's middle: a bore listed there is made up
LEAST_FF, LEAST_SIGMA = 8.0, 7.0  # of the mean, and of its unevenness: what changes by less leaves no trace
ONE_SIDED = 0.5  # of its radius: a sewer that passes so far off has a direction
COUPLING_MM = 80.0


def measured(seed: int, folder: Path) -> Case:
    drawn = drawn_log(seed)
    tool = drawn.tool
    extras = [name for name, there in (("pose", tool.pose), ("loss", tool.loss)) if there]
    case = Case(
        seed,
        f"{drawn.soil}, air {tool.air_ff / 1000:.1f} pF, swing {tool.swing_ff:.0f} fF, "
        f"{' and '.join(extras) or 'neither pose nor loss'}",
    )
    try:
        grid, account = surveyed(drawn, folder)
    except AnnulusError as error:
        case.refused = str(error).replace(str(folder), "")
        return case
    score(case, drawn, grid, account)
    return case


def drawn_log(seed: int) -> Drawn:
    rng = np.random.default_rng([seed, 92])
    drawn = draw(rng)
    logged(drawn, rng)
    return drawn


def surveyed(drawn: Drawn, folder: Path) -> tuple[PipeGrid, BoreDetections]:
    """What is said of a drawn log when it is read from a file in `folder`."""
    names = list(drawn.columns)
    table = np.stack([drawn.columns[name] for name in names], axis=1)
    path = folder / "log.csv"
    np.savetxt(path, table, fmt="%.5f", delimiter=",", header=",".join(names), comments="")
    tool = drawn.tool
    head = CapacitiveHead(tool.air_ff, tool.sector_deg, tool.coupling_ff, tool.coupling_mm)
    grid = on_grid(Log(*read_bore_log(path)), head)
    return grid, detect(grid, head)


def score(case: Case, drawn: Drawn, grid: PipeGrid, account: BoreDetections) -> None:
    crossed = [one for one in drawn.sewers if one.kind]
    uneven = unevenness(drawn)
    for one in crossed:
        middle = drawn.odometer_mm(0.5 * sum(one.span_mm))
        half = max(100.0, 0.5 * (one.span_mm[1] - one.span_mm[0]) + BESIDE_MM)
        mine = [reported for reported in account.indications if abs(reported.odometer_mm - middle) < half]
        mine.sort(key=lambda reported: (reported.kind not in BORES, abs(reported.odometer_mm - middle)))
        seen = bool(grid.seen[np.abs(grid.z_mm - middle) < half].all())
        case.things.append((f"sewer, {one.kind}", state(one, mine, uneven, seen), describe(one, mine)))
        if mine and mine[0].kind in BORES:
            numbers(case, one, mine[0], middle)
    middles = [drawn.odometer_mm(0.5 * sum(one.span_mm)) for one in crossed]
    for reported in account.indications:
        real = [one.kind for one, at in zip(crossed, middles, strict=True) if abs(reported.odometer_mm - at) < APART_MM]
        if reported.kind in BORES and not real:
            near = [one for one in drawn.sewers if not one.kind and abs(one.at_mm - reported.odometer_mm) < APART_MM]
            case.false.append(
                f"{reported.kind} at {reported.odometer_mm:.0f} mm{', beside a near miss' if near else ''}, "
                f"{reported.change_ff.round(0)} fF, {reported.extent_mm:.0f} mm"
            )
        if reported.odds:
            fate = str(reported.kind) if reported.kind in BORES else "soil"
            right = fate in real if real else fate == "soil"
            case.odds.append((str(reported.kind), likely(reported), right))
    for at in map(drawn.odometer_mm, drawn.couplings):
        mine = [reported for reported in account.indications if abs(reported.odometer_mm - at) < COUPLING_MM]
        kinds = [reported.kind for reported in mine]
        found = (
            "found"
            if BoreKind.COUPLING in kinds
            else "misnamed"
            if set(kinds) & set(BORES)
            else ("not established" if BoreKind.UNKNOWN in kinds else "misnamed" if kinds else "missed")
        )
        case.things.append(("coupling", found, ", ".join(kinds)))


def state(one: Sewer, mine: list[BoreIndication], uneven: float, seen: bool) -> str:
    if not mine and not seen:
        return "not established"
    if not mine:
        return "below the limit" if abs(one.change_ff) < max(LEAST_FF, LEAST_SIGMA * uneven) else "missed"
    if mine[0].kind in BORES:
        return "found" if mine[0].kind == one.kind else "misnamed"
    return "not established" if mine[0].kind is BoreKind.UNKNOWN else "misnamed"


def describe(one: Sewer, mine: list[BoreIndication]) -> str:
    reported = ", ".join(str(indication.kind) for indication in mine) or "nothing"
    return (
        f"{reported}; radius {one.radius_mm:.0f}, {one.offset_mm:.0f} mm aside towards {one.phi_deg:.0f} deg, mean "
        f"{one.change_ff:+.0f} fF"
    )


def numbers(case: Case, one: Sewer, reported: BoreIndication, middle: float) -> None:
    case.numbers.append(Number("place, mm", one.kind, reported.odometer_mm, math.nan, middle))
    if math.isfinite(reported.phi_deg) and one.offset_mm > ONE_SIDED * one.radius_mm and reported.kind == one.kind:
        off = (reported.phi_deg - one.phi_deg + 180) % 360 - 180
        case.numbers.append(Number("direction, deg", one.kind, off, 2 * reported.phi_sigma_deg, 0.0))
    elif one.offset_mm > one.radius_mm:
        case.unsaid["direction, deg"] += 1


def unevenness(drawn: Drawn) -> float:
    """Of the sectors' mean over half a metre, fF, where no sewer is."""
    mean = 1000 * np.stack([drawn.columns[f"c{k}_pf"] for k in (1, 2, 3)]).mean(axis=0)
    rows = max(1, int(0.3 * drawn.tool.rate_hz))
    mean = np.convolve(mean, np.full(rows, 1 / rows), "valid")
    step = max(1, int(300 / drawn.tool.speed_mm_s * drawn.tool.rate_hz))
    bend = mean[2 * step :] - 2 * mean[step:-step] + mean[: -2 * step]
    return 1.4826 * float(np.median(np.abs(bend))) / math.sqrt(6)
