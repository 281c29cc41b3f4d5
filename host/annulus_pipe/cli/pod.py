"""`annulus pod`: what a head detects, from defects that are known: planned, matched with surveys, fitted."""

import json
import math
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from annulus_pipe.cli.pulls import read_pull
from annulus_pipe.cli.show import Json, print_fields, verbs
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.qualification.trials import Pull, Reported, Trials
    from annulus_pipe.storage.results_folder import ListedPlace

app = verbs()

ZERO_MAX_MM = 1e7  # 10 km, as far as a place may lie


class LaidKind(StrEnum):
    LOSS = "loss"
    BUMP = "bump"


class FitAxis(StrEnum):
    LIKELIER = "likelier"
    LINEAR = "linear"
    LOG = "log"


@app.command("plan", epilog="Example: annulus pod plan --want 1.2 --a90 0.9 --a50 0.6 -o plan")
def plan_command(
    want: Annotated[float, typer.Option(min=0.01, max=1000.0, metavar="MM", help="The a90/95 that is wanted.")],
    a90: Annotated[float, typer.Option(min=0.01, max=1000.0, metavar="MM", help="Depth assumed to have POD 90 %.")],
    a50: Annotated[float, typer.Option(min=0.01, max=1000.0, metavar="MM", help="Depth assumed to have POD 50 %.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for spool-1.csv and on; made if need be.")],
    kind: Annotated[LaidKind, typer.Option(help="What is machined.")] = LaidKind.LOSS,
    length: Annotated[float, typer.Option(min=1.0, max=1000.0, metavar="MM", help="Of each, along the pipe.")] = 20.0,
    width: Annotated[float, typer.Option(min=1.0, max=1000.0, metavar="MM", help="Of each, round it.")] = 20.0,
    deepest: Annotated[
        float, typer.Option(min=0.01, max=1000.0, metavar="MM", help="The deepest that the wall allows.")
    ] = 1000.0,
    spool: Annotated[float, typer.Option(min=300.0, max=1e5, metavar="MM", help="Length of a piece of pipe.")] = 6000.0,
    diameter: Annotated[
        float,
        typer.Option(min=0.0, max=10_000.0, metavar="MM", help="Its inner diameter: defects lie side by side then."),
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Draws clocks and order.")] = 1,
    as_json: Json = False,
) -> None:
    """How many defects of which depths to machine for a wanted a90/95, and where along the pipe: a file for each spool.

    a50 and a90 are guesses of what the head does. The answer says in how many of 100 such studies what is wanted is
    reached, if they are right. Each row is also a truth for `annulus pod match`: measure what was machined, and write
    what it came to.
    """
    from annulus_pipe.qualification.sizes import in_words, plan_sizes, spools
    from annulus_pipe.qualification.trial_files import truths_csv

    plan = plan_sizes(want, a50, a90, deepest_mm=deepest, seed=seed)
    laid = spools(plan, str(kind), length, width, spool_mm=spool, bore_mm=diameter, seed=seed)
    files = [out / f"spool-{number}.csv" for number in range(1, len(laid) + 1)]
    for file, its in zip(files, laid, strict=True):
        _write(file, truths_csv(its))
    print_fields(
        {
            "defects": len(plan.depths_mm),
            "from_mm": round(plan.depths_mm[0], 3),
            "to_mm": round(plan.depths_mm[-1], 3),
            "probability": plan.reached,
            "plan": in_words(plan, laid),
            "written": ", ".join(map(str, files)),
        },
        as_json,
    )


@app.command("match", epilog="Example: annulus pod match plan/spool-1.csv results-1 results-2 -o trials.json")
def match_command(
    truths: Annotated[
        Path, typer.Argument(help="Defects that are known: a .csv or .json, as `annulus pod plan` has it.")
    ],
    results: Annotated[
        list[Path], typer.Argument(help="Folders of results of one pull each; or one .csv or .json of a list.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="trials.json: what became of each defect.")],
    zero: Annotated[
        float,
        typer.Option("--zero-mm", min=-1e7, max=1e7, metavar="MM", help="Where in the scan the truths' zero lies."),
    ] = 0.0,
    scanned: Annotated[
        tuple[float, float] | None, typer.Option(metavar="MM MM", help="Of a list: what was scanned, from and to.")
    ] = None,
    diameter: Annotated[float, typer.Option(metavar="MM", help="Of a list: the pipe's inner diameter.")] = math.nan,
    limit: Annotated[
        float, typer.Option("--depth-limit", metavar="MM", help="Of a list: the least depth that it has.")
    ] = math.nan,
    as_json: Json = False,
) -> None:
    """Which of the known defects were detected, one to one, and which reports are none of them.

    A pair lies within 25 mm, and half of the longer, along the pipe and round it. What lies in a hole of the survey is
    left out, and counted.
    """
    from annulus_pipe.qualification.trial_files import pull_of_list, read_reports, read_truths, trials_json
    from annulus_pipe.qualification.trials import match

    known = read_truths(truths)
    if not -ZERO_MAX_MM <= zero <= ZERO_MAX_MM:
        raise AnnulusError(f"--zero-mm is {zero:g}, expected -{ZERO_MAX_MM:g}..{ZERO_MAX_MM:g}")
    found: Trials | None = None
    for path in results:
        if path.suffix.lower() in (".csv", ".json"):
            if scanned is None or math.isnan(diameter):
                raise AnnulusError(f"{path}: a list alone needs --scanned FROM TO and --diameter, in mm")
            pull = pull_of_list(path.stem, scanned, diameter, limit)
            reported: Sequence[Reported] = read_reports(path)
        else:
            pull, reported = _results(path)
        one = match(known, reported, pull, zero_mm=zero)
        found = one if found is None else found.joined(one)
    assert found is not None
    _write(out, trials_json(found))
    states = [one.state for one in found.trials]
    print_fields(
        {
            "pulls": len(found.pulls),
            **{str(state).replace(" ", "_"): states.count(state) for state in dict.fromkeys(_all_states())},
            "false_calls": len(found.false_calls),
            "undecided_elsewhere": found.undecided_elsewhere,
            "written": str(out),
        },
        as_json,
    )


@app.command("fit", epilog="Example: annulus pod fit trials.json -o pod")
def fit_command(
    trials: Annotated[
        list[Path], typer.Argument(help="trials.json of `annulus pod match`, or a .csv of hits and misses.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for pod.json, pod.html and pictures.")],
    axis: Annotated[FitAxis, typer.Option(help="POD against depth, or against its logarithm.")] = FitAxis.LIKELIER,
    claim: Annotated[
        float | None, typer.Option(metavar="MM", min=1e-3, max=1e4, help="Tolerance of depths that is claimed, mm.")
    ] = None,
    certainty: Annotated[
        float | None, typer.Option(min=0.5, max=0.99, help="Part of depths that --claim is of; 0.8 if not given.")
    ] = None,
    as_json: Json = False,
) -> None:
    """POD against size with a90/95, false calls, names and sizes of what was detected: pod.json and a page of it."""
    from annulus_pipe.qualification.hit_miss import SizeAxis
    from annulus_pipe.qualification.pod import detectability, pod_json
    from annulus_pipe.qualification.trial_files import read_trials
    from annulus_pipe.qualification.validation import CERTAINTY
    from annulus_pipe.report.pod_page import pictures, pod_page

    if claim is None and certainty is not None:
        raise AnnulusError(f"--certainty {certainty:g} goes with --claim, a tolerance of depths in mm")
    joined = read_trials(trials[0])
    for path in trials[1:]:
        joined = joined.joined(read_trials(path))
    fixed = {FitAxis.LIKELIER: None, FitAxis.LINEAR: SizeAxis.LINEAR, FitAxis.LOG: SizeAxis.LOG}[axis]
    found = detectability(joined, fixed, None if claim is None else (claim, certainty or CERTAINTY))
    drawn = pictures(found, joined)
    _write(out / "pod.json", pod_json(found))
    for name, picture in drawn.items():
        _write(out / f"{name}.png", picture)
    _write(out / "pod.html", pod_page(found, drawn))
    if as_json:
        print(json.dumps(found.to_dict(), allow_nan=False))
        return
    for kind in found.kinds:
        for line in found.statement(kind):
            print(line)
    print(found.false_calls.statement())
    print(f"written  {out / 'pod.json'}, {out / 'pod.html'}")


def _all_states() -> Sequence[Any]:
    from annulus_pipe.qualification.trials import TrialState

    return list(TrialState)


def _results(folder: Path) -> "tuple[Pull, list[Reported]]":
    """A pull and its list, from a folder of results."""
    pull, defects, undecided, _ = read_pull(folder)
    return pull, [*_reported(defects, True), *_reported(undecided, False)]


def _reported(places: "Sequence[ListedPlace]", listed: bool) -> "list[Reported]":
    from annulus_pipe.qualification.trials import Reported

    return [
        Reported(
            one.kind,
            one.z_mm,
            one.clock_deg,
            math.nan if one.depth_mm is None else one.depth_mm,
            math.nan if one.depth_k2_mm is None else one.depth_k2_mm,
            one.length_mm,
            one.arc_deg,
            not one.floor_seen,
            listed,
        )
        for one in places
    ]


def _write(path: Path, data: str | bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data if isinstance(data, bytes) else data.encode("utf-8"))
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be written ({error.strerror or error})") from None
