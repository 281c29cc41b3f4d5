"""`annulus unity`: a survey held against what excavations measured."""

import json
import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from annulus_pipe.cli.pulls import read_pull
from annulus_pipe.cli.show import Json
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.qualification.matching import SurveyPlace
    from annulus_pipe.qualification.unity import SurveyResults, ToolClaim
    from annulus_pipe.storage.results_folder import ListedPlace

EXAMPLE = "Example: annulus unity digs.csv results --tolerance-mm 0.3 -o unity"
TOLERANCE_MAX_MM = 1000.0


def unity(
    digs: Annotated[Path, typer.Argument(metavar="DIG.csv", help="What was dug: z_mm, clock_deg, depth_mm and more.")],
    results: Annotated[Path, typer.Argument(help="Folder that `annulus reconstruct` wrote.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for unity.json, its page and picture.")],
    tolerance_mm: Annotated[
        float | None,
        typer.Option(min=0.001, max=TOLERANCE_MAX_MM, help="Of depths, as claimed. [default: each its own k = 2]"),
    ] = None,
    pod: Annotated[
        Path | None, typer.Option(help="pod.json of `annulus pod fit`, whose tolerances are the claim.")
    ] = None,
    certainty: Annotated[
        float | None,
        typer.Option(min=0.5, max=0.999, help="Part of depths that keeps it. [default: 0.8; of k = 2: 0.95]"),
    ] = None,
    confidence: Annotated[float, typer.Option(min=0.5, max=0.999, help="Of every interval.")] = 0.95,
    shift_mm: Annotated[
        float, typer.Option(min=0.0, max=100_000.0, help="How far the digs' zero may lie from the survey's, mm.")
    ] = 300.0,
    as_json: Json = False,
) -> None:
    """Hold a survey against excavations: is its specification accepted, rejected or open, and where to dig next.

    Dug and listed places are matched one to one by place, never by depth. A depth is within tolerance when it differs
    from the dig's by no more than both may be off together. Also says what is missed and falsely called, bias and
    slope, and a tolerance of its own.
    """
    from annulus_pipe.qualification.digs import read_digs
    from annulus_pipe.qualification.unity import study
    from annulus_pipe.qualification.unity_file import FILE, to_dict
    from annulus_pipe.report.unity_page import draw_unity, unity_page
    from annulus_pipe.storage.whole import written_whole

    dug = read_digs(digs)
    claim, survey = _claim(tolerance_mm, pod, certainty), _results(results)
    found = study(survey, dug, str(digs), claim, shift_mm, confidence)
    if pod is not None:
        found = replace(found, remarks=(*found.remarks, *_not_of(pod, survey)))
    created = datetime.now(UTC).isoformat(timespec="seconds")
    content = {**to_dict(found), "created": created}
    picture = draw_unity(found)
    files = {
        FILE: (json.dumps(content, allow_nan=False, indent=1) + "\n").encode("utf-8"),
        "unity.html": unity_page(found, picture, created).encode("utf-8"),
        "unity.png": picture,
    }
    for name, data in files.items():
        try:
            out.mkdir(parents=True, exist_ok=True)
            with written_whole(out / name) as file:
                file.write(data)
        except OSError as error:
            raise AnnulusError(f"{out / name}: cannot be written ({error.strerror or error}).") from None
    if as_json:
        print(json.dumps(content, allow_nan=False))
        return
    for line in found.statement():
        print(line)
    print(f"page       {out / 'unity.html'}")


def _claim(tolerance_mm: float | None, pod: Path | None, certainty: float | None) -> "ToolClaim":
    from annulus_pipe.qualification.pod import read_pod
    from annulus_pipe.qualification.unity import OWN_CERTAINTY, ToolClaim
    from annulus_pipe.qualification.validation import CERTAINTY

    if tolerance_mm is not None and pod is not None:
        raise AnnulusError("--tolerance-mm and --pod are both a claim: give one of them")
    if tolerance_mm is not None:
        return ToolClaim(certainty or CERTAINTY, (("", tolerance_mm),), "as claimed")
    if pod is None:
        return ToolClaim(certainty or OWN_CERTAINTY, (), "as the survey states")
    sizing, wanted = read_pod(pod).sizing, certainty or CERTAINTY
    found = {kind: one.tolerance_mm for kind, its in sizing for one in its.tolerances if one.certainty == wanted}
    if not found:
        raise AnnulusError(
            f"{pod}: states no tolerance at {100 * wanted:.0f} % certainty. Expected --certainty 0.8 or 0.9."
        )
    return ToolClaim(wanted, tuple(found.items()), pod.name)


def _not_of(pod: Path, survey: "SurveyResults") -> list[str]:
    """Why what a study of detection states may not be claimed of this survey."""
    from annulus_pipe.qualification.applicability import HeadInUse
    from annulus_pipe.qualification.pod import read_pod

    pull = survey.pull
    use = HeadInUse(pull.head, software=pull.version, diameter_mm=2 * pull.bore_radius_mm)
    return [f"{pod.name}: {why}" for why in read_pod(pod).standing(use)[1]]


def _results(folder: Path) -> "SurveyResults":
    """Raises AnnulusError, one line, for a folder that is none of a pipe."""
    from annulus_pipe.qualification.unity import SurveyResults

    pull, defects, undecided, summary = read_pull(folder)
    listed = [_place(one, f"D{i}") for i, one in enumerate(defects, 1)]
    unsure = [_place(one, f"?{i}", True) for i, one in enumerate(undecided, 1)]
    wall = _wall_mm(summary.get("job"), 2 * pull.bore_radius_mm)
    return SurveyResults(replace(pull, name=str(folder)), (*listed, *unsure), wall)


def _place(one: "ListedPlace", name: str, undecided: bool = False) -> "SurveyPlace":
    from annulus_pipe.qualification.matching import SurveyPlace

    depth, k2 = (math.nan if value is None else value for value in (one.depth_mm, one.depth_k2_mm))
    return SurveyPlace(
        name, one.kind, one.z_mm, one.clock_deg, one.length_mm, one.arc_deg, depth, k2, not one.floor_seen, undecided
    )


def _wall_mm(job: Any, diameter_mm: float) -> float:
    """Of the job's SDR, which is outer diameter over wall; NaN where nobody stated it."""
    from annulus_pipe.job import JobSheet

    sdr = JobSheet.recorded(job).sdr
    return math.nan if sdr is None else diameter_mm / (sdr - 2.0)
