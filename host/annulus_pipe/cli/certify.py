"""`annulus certify`: a gauge study of a head on reference pieces of pipe, and its certificate."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from annulus_pipe.cli.pdf import PaperSize, on_paper
from annulus_pipe.cli.show import Json, print_fields, verbs
from annulus_pipe.numeric.rounding import two_digits_up
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.qualification.applicability import HeadInUse
    from annulus_pipe.qualification.certificate import Certificate
    from annulus_pipe.qualification.plan import ReferencePiece, StudyPlan, StudyRun
    from annulus_pipe.qualification.study import Conditions, GaugeReading

app = verbs()

STATIONS_LEAST = 3  # of a piece in a run: fewer are no mean of it (a station every 5 mm of a sleeve of 50 has ten)
SEEN_LEAST = 0.5  # of a station's circle: less, and its mean diameter is of a part of the wall
APART_K = 5.0  # of a run's own temperature and that of runs.csv: as far as a certificate reaches beyond its runs
RUNS = "runs.csv"

Plan = Annotated[Path, typer.Argument(help="plan.toml: pieces, operators, repeats.")]
Runs = Annotated[Path, typer.Option(help="runs.csv of `annulus certify plan`, filled in.")]


@app.command("plan", epilog="Example: annulus certify plan plan.toml -o study")
def plan_command(
    plan: Plan,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for runs.csv; made if need be.")],
    as_json: Json = False,
) -> None:
    """Write the runs of a study in an order drawn by lot, and say what it will be able to notice.

    Each run is a scan like any other, reconstructed into the folder that its row names. Fill in the temperature.
    """
    from annulus_pipe.qualification.plan import planned, read_plan, runs_csv
    from annulus_pipe.qualification.study import POWER, power

    study = read_plan(plan)
    runs, file = planned(study), out / RUNS
    if file.exists():
        raise AnnulusError(f"{file}: is there already. Expected a folder without one: what was filled in would be lost")
    _write(file, runs_csv(runs))
    alike, each = power(study)
    how_many = f"{100 * each:.0f}" if alike == each else f"{100 * alike:.0f} to {100 * each:.0f}"
    print_fields(
        {
            "runs": len(runs),
            "readings": len(study.pieces) * len(study.operators) * study.repeats,
            "refuses": f"a head that repeats twice as badly, in {how_many} of 100 checks of this size"
            + ("" if alike == each else ", as pieces of one pull err alike or not")
            + ("" if alike >= POWER else f"; {100 * POWER:.0f} need more repeats, or a scan a piece"),
            "written": str(file),
        },
        as_json,
    )


@app.command("key", epilog="Example: annulus certify key -o lab.key")
def key_command(
    out: Annotated[Path, typer.Option("-o", "--out", help="New file for the private key; the public one ends .pub.")],
    as_json: Json = False,
) -> None:
    """Make the key that certificates are signed with: one file to keep to yourself, one to give away."""
    import os

    from annulus_pipe.qualification.signature import make_key

    private, public = make_key()
    shared = out.with_name(f"{out.name}.pub")
    for there in (out, shared):
        if there.exists():
            raise AnnulusError(f"{there}: is there already, and a key is not written over. Choose another name.")
    try:
        with open(os.open(out, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(private)
        shared.write_bytes(public)
    except OSError as error:
        raise AnnulusError(f"{out}: cannot be written ({error.strerror}).") from None
    print_fields({"private": f"{out} (yours alone)", "public": str(shared)}, as_json)


@app.command(
    "issue", epilog="Example: annulus certify issue plan.toml --runs study/runs.csv --key lab.key -o certificate"
)
def issue_command(
    plan: Plan,
    runs: Runs,
    key: Annotated[Path, typer.Option(help="Private key of `annulus certify key`.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for certificate.json and its page.")],
    day: Annotated[
        str | None, typer.Option("--date", metavar="YYYY-MM-DD", help="Day of issue; today if not given.")
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Write certificate.pdf too; needs the extra pdf.")] = False,
    paper: Annotated[PaperSize, typer.Option(help="Of certificate.pdf.")] = PaperSize.A4,
    as_json: Json = False,
) -> None:
    """The certificate of a finished study: accuracy, repeatability, reproducibility, budget, validity."""
    from dataclasses import replace

    from annulus_pipe.qualification.certificate import FILE
    from annulus_pipe.qualification.plan import read_plan, read_runs
    from annulus_pipe.qualification.signature import sign
    from annulus_pipe.qualification.study import certified

    sheet = on_paper(pdf, paper)
    sign({}, key)  # a key that is none is noticed before all runs are read
    issued = _today() if day is None else _issued(day)
    study = read_plan(plan)
    readings, conditions = _readings(study, read_runs(runs, study), runs)
    made = certified(study, readings, conditions, issued)
    made = replace(made, signature=sign(made.content(), key))
    from annulus_pipe.report.certificate_page import certificate_page

    page = certificate_page(made)
    _write(out / "certificate.html", page)
    if sheet is not None:
        from annulus_pipe.report.pdf import to_pdf

        _write(out / "certificate.pdf", to_pdf(page, sheet))
    _write(out / FILE, json.dumps(made.to_dict(), indent=1, ensure_ascii=False) + "\n")
    accuracy = made.accuracy
    if as_json:
        print(json.dumps(made.to_dict()))
        return
    print_fields(
        {
            "certificate": made.number,
            "diameters": f"± {two_digits_up(accuracy.U)} % in 19 of 20 (bias {_signed(accuracy.bias.value)} % in it)",
            ".. as optics drift": f"± {two_digits_up(accuracy.U_drift)} % without a reference section in the scan",
            "repeatability": f"s_r {accuracy.s_r.value:.2g} % ({accuracy.s_r.low:.2g} to {accuracy.s_r.high:.2g})",
            "reproducibility": f"s_R {accuracy.s_R.value:.2g} % ({accuracy.s_R.low:.2g} to {accuracy.s_R.high:.2g})",
            "valid until": str(made.scope.until),
            "page": str(out / "certificate.html"),
        },
        False,
    )


@app.command("verify", epilog="Example: annulus certify verify certificate/certificate.json --results results")
def verify_command(
    certificate: Annotated[Path, typer.Argument(help="certificate.json.")],
    public: Annotated[
        Path | None, typer.Option(help="Public key of whoever should have signed it; any signature if not given.")
    ] = None,
    results: Annotated[Path | None, typer.Option(help="Folder of results: whether it speaks for that scan.")] = None,
    as_json: Json = False,
) -> None:
    """Whether a certificate is as it was signed, by whom, follows from its own readings, has not lapsed, and speaks for
    a scan. Status 1 where not. Anybody can sign: give the laboratory's own --public.
    """
    from annulus_pipe.qualification.applicability import Applicability, HeadInUse
    from annulus_pipe.qualification.certificate import read_certificate
    from annulus_pipe.qualification.signature import public_key
    from annulus_pipe.qualification.study import disagreements

    made = read_certificate(certificate)
    assert made.signature is not None
    if public is not None and public_key(public) != made.signature.public_key:
        raise AnnulusError(f"{certificate}: is signed by another key ({made.signature.fingerprint}) than {public}")
    wrong = disagreements(made)
    if wrong:
        more = f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""
        raise AnnulusError(f"{certificate}: does not follow from its own readings: {wrong[0]}{more}")
    today = _today()
    if results is None:
        scope = made.scope
        inside = HeadInUse(
            scope.head,
            scope.calibration,
            scope.firmware,
            scope.software,
            scope.diameter_mm[0],
            None if scope.temperature_c is None else scope.temperature_c[0],
            today,
        )
        standing, reasons = scope.standing(inside)
        reasons = tuple(one for one in reasons if "lapsed" in one or "after the day" in one)
        standing = Applicability.DOES_NOT if reasons else Applicability.APPLIES
    else:
        standing, reasons = made.scope.standing(in_use(_summary(results)))
    print_fields(
        {
            "certificate": made.number,
            "signed": f"as it is, by {made.signature.fingerprint}{'' if public else ', whoever that is'}",
            "numbers": f"follow from its {len(made.runs)} readings",
            "valid": f"{made.scope.issued} to {made.scope.until}",
            "standing": "not lapsed" if results is None and not reasons else str(standing),
            **{f"because {i}": one for i, one in enumerate(reasons, 1)},
        },
        as_json,
    )
    if standing is Applicability.DOES_NOT:
        raise typer.Exit(1)


@app.command("check", epilog="Example: annulus certify check certificate.json plan.toml --runs june/runs.csv")
def check_command(
    certificate: Annotated[Path, typer.Argument(help="certificate.json.")],
    plan: Plan,
    runs: Runs,
    as_json: Json = False,
) -> None:
    """Hold a head's certificate against later runs on reference pieces. Status 1 where they refuse it."""
    from annulus_pipe.qualification.certificate import read_certificate
    from annulus_pipe.qualification.plan import read_plan, read_runs
    from annulus_pipe.qualification.study import compared

    made, study = read_certificate(certificate), read_plan(plan)
    if made.scope.head != study.head:
        raise AnnulusError(f"{certificate}: is of head {made.scope.head}, and {plan} is of head {study.head}")
    readings, conditions = _readings(study, read_runs(runs, study), runs)
    if conditions.calibration and made.scope.calibration and conditions.calibration != made.scope.calibration:
        raise AnnulusError(
            f"{runs}: its runs have calibration {conditions.calibration}, and the certificate is of "
            f"{made.scope.calibration}. A head calibrated anew needs a study of its own"
        )
    _require_in_scope(made, readings, conditions, runs)
    check = compared(made, study, readings)
    print_fields(
        {
            "certificate": made.number,
            "valid": f"{made.scope.issued} to {made.scope.until}{', lapsed' * (made.scope.until < _today())}",
            "upheld": check.upheld if as_json else "yes" if check.upheld else "NO: it does not hold for this head",
            **{f"test {i}": one for i, one in enumerate(check.reasons, 1)},
        },
        as_json,
    )
    if not check.upheld:
        raise typer.Exit(1)


def _require_in_scope(
    made: "Certificate", readings: "Sequence[GaugeReading]", conditions: "Conditions", runs: Path
) -> None:
    """AnnulusError for runs that cannot speak for or against it: those it was made of bear it out whatever they are,
    and of another program, diameter or temperature it says nothing."""
    from annulus_pipe.qualification.applicability import Applicability, HeadInUse

    own = {one.results: one.number for one in made.runs}
    scope = made.scope
    for one in readings:
        run, warm = one.run.number, one.run.temperature_c
        if one.results in own:
            raise AnnulusError(
                f"{runs}: run {run} has the results of run {own[one.results]} of the certificate. Expected later runs"
            )
        used = HeadInUse(
            scope.head,
            conditions.calibration,
            conditions.firmware,
            conditions.software,
            one.piece.diameter_mm,
            None if math.isnan(warm) else warm,
        )
        standing, reasons = scope.standing(used)
        if standing is Applicability.DOES_NOT:
            raise AnnulusError(f"{runs}: the certificate says nothing of run {run}: {reasons[0]}")


def _readings(study: "StudyPlan", runs: "Sequence[StudyRun]", file: Path) -> "tuple[list[GaugeReading], Conditions]":
    """What every run read of every piece it shows, and what all runs have in common. Raises AnnulusError."""
    from annulus_pipe.job import scan_day
    from annulus_pipe.qualification.plan import ALL

    pieces = {piece.name: piece for piece in study.pieces}
    readings, common = list["GaugeReading"](), dict[str, tuple[str, int]]()
    points, days, begun = list[float](), list[date](), dict[str, int]()
    for run in runs:
        folder = file.parent / run.results
        summary = _summary(folder)
        where = f"{file}: run {run.number} ({folder})"
        digest = _digest(folder)
        _require_of_run(study, run, summary, where)
        _require_not_anchored(summary, where)
        for what, value in _stated(summary).items():
            first = common.setdefault(what, (value, run.number))
            if value != first[0]:
                own, before = (one or "not stated" for one in (value, first[0]))
                raise AnnulusError(
                    f"{where}: its {what} is {own}, that of run {first[1]} {before}. A certificate is of one "
                    "head as it is"
                )
        when, day = str(_section(summary, "origin").get("begun_utc") or ""), in_use(summary).day
        if scan_day("", when) is not None and begun.setdefault(when, run.number) != run.number:
            raise AnnulusError(f"{where}: is the scan of run {begun[when]}, begun {when}. Expected one of its own")
        days += [] if day is None else [day]
        frames = summary["frames"].get("projector") if isinstance(summary.get("frames"), Mapping) else None
        if isinstance(frames, int) and frames > 0 and isinstance(summary.get("points"), int):
            points.append(summary["points"] / frames)
        shown = study.pieces if run.piece == ALL else (pieces[run.piece],)
        readings += [_reading(run, piece, folder, summary, where, digest) for piece in shown]
    from annulus_pipe.qualification.study import Conditions, require_own_pieces

    require_own_pieces(study, readings, str(file))
    values = {what: value for what, (value, _) in common.items()}
    return readings, Conditions(
        **values, points_per_picture=min(points) if points else math.nan, days=(min(days), max(days)) if days else None
    )


def _reading(
    run: "StudyRun", piece: "ReferencePiece", folder: Path, summary: Mapping[str, Any], where: str, digest: str
) -> "GaugeReading":
    import numpy as np

    from annulus_pipe.qualification.study import GaugeReading
    from annulus_pipe.storage.results_folder import STATIONS, read_stations, unreadable

    try:
        columns = read_stations(folder, summary)
    except (OSError, ValueError) as error:
        raise unreadable(folder / STATIONS, error) from None
    first, last = piece.span_mm or (-math.inf, math.inf)
    z, mean = columns["z_mm"], columns["diameter_mean_mm"]
    inside = (z >= first) & (z <= last) & np.isfinite(mean) & (columns["valid_fraction"] >= SEEN_LEAST)
    if int(inside.sum()) < STATIONS_LEAST:
        raise AnnulusError(
            f"{where}: {int(inside.sum())} stations of piece {piece.name} were seen, expected {STATIONS_LEAST} or more"
            + (f" between {first:g} and {last:g} mm" if piece.span_mm else "")
        )
    read_mm = float(mean[inside].mean())
    ends = np.concatenate([columns[name][inside] for name in ("diameter_min_mm", "diameter_max_mm")])
    oval = columns["ovality_f1216_percent"][inside]
    return GaugeReading(
        run,
        piece,
        read_mm,
        float(np.nanmax(np.abs(100.0 * (ends / piece.diameter_mm - 1.0)))),
        float(np.nanmax(oval)) if np.isfinite(oval).any() else 0.0,
        int(inside.sum()),
        _drift_percent(summary),
        digest,
    )


def _digest(folder: Path) -> str:
    """What names a scan's results: of its stations, which are the same however often they are made of one scan."""
    from annulus_pipe.storage.results_folder import CSV_MAX, STATIONS, unreadable
    from annulus_pipe.untrusted import read_file

    try:
        return hashlib.sha256(read_file(folder / STATIONS, CSV_MAX)).hexdigest()[:12]
    except (OSError, ValueError) as error:
        raise unreadable(folder / STATIONS, error) from None


def _require_not_anchored(summary: Mapping[str, Any], where: str) -> None:
    """A piece that was named as the scan's reference section reads what it was named as: that shows nothing. With a
    section elsewhere nothing shows what the optics drift by, and a certificate speaks for scans without one too."""
    sections = _section(summary, "scale").get("references")
    if any(isinstance(one, Mapping) and one.get("used") for one in (sections if isinstance(sections, list) else ())):
        raise AnnulusError(
            f"{where}: its diameters are anchored by a reference section. Expected results without one, which know "
            "nothing of a piece and show what the optics drift by"
        )


def _drift_percent(summary: Mapping[str, Any]) -> float:
    """Standard uncertainty of all diameters alike, percent, as the scan states it; 0 where it states none."""
    scale = summary.get("scale")
    k2 = scale.get("common_k2_percent") if isinstance(scale, Mapping) else None
    return k2 / 2 if isinstance(k2, int | float) and 0.0 <= k2 < 100.0 else 0.0


def _require_of_run(study: "StudyPlan", run: "StudyRun", summary: Mapping[str, Any], where: str) -> None:
    """Where results say whose they are, they are this run's."""
    job = _section(summary, "job")
    others = {piece.name for piece in study.pieces} - {run.piece}
    for what, stated, expected in (
        ("head", job.get("head"), study.head),
        ("operator", job.get("operator"), run.operator),
    ):
        if stated and stated != expected:
            raise AnnulusError(f"{where}: is of {what} {stated}, expected {expected}")
    warm = job.get("temperature_c")
    if isinstance(warm, int | float) and abs(warm - run.temperature_c) > APART_K:  # never of one that is NaN
        raise AnnulusError(f"{where}: is of {warm:g} degC, and the file has {run.temperature_c:g}")
    if len(study.pieces) > 1 and job.get("pipe") in others and not study.one_pull:
        raise AnnulusError(f"{where}: is of piece {job['pipe']}, expected {run.piece}")


def _stated(summary: Mapping[str, Any]) -> dict[str, str]:
    """What a certificate is bound to, as results state it; "" where they do not."""
    origin, versions = _section(summary, "origin"), _section(summary, "versions")
    calibration, controller = _section(origin, "calibration"), _section(origin, "controller")
    camera = _section(calibration, "camera")
    lens = [str(camera[name])[:100] for name in ("by", "utc") if camera.get(name)]
    if isinstance(camera.get("rms_px"), int | float):
        lens.append(f"rms {camera['rms_px']:.3g} px")
    firmware = [str(controller[name])[:60] for name in ("version", "git") if controller.get(name)]
    return {
        "calibration": str(calibration.get("fingerprint") or "")[:64],
        "firmware": " ".join(firmware),
        "software": str(versions.get("annulus") or "")[:60],
        "lens": ", ".join(lens),
    }


def in_use(summary: Mapping[str, Any]) -> "HeadInUse":
    """What results state of the head that made them."""
    from annulus_pipe.job import scan_day
    from annulus_pipe.qualification.applicability import HeadInUse

    job, origin, stated = _section(summary, "job"), _section(summary, "origin"), _stated(summary)
    diameter, warm = _section(summary, "diameter_mm").get("mean"), job.get("temperature_c")
    return HeadInUse(
        str(job.get("head") or ""),
        stated["calibration"],
        stated["firmware"],
        stated["software"],
        diameter if isinstance(diameter, int | float) else None,
        warm if isinstance(warm, int | float) else None,
        scan_day(*(str(when or "") for when in (job.get("date"), origin.get("begun_utc")))),
    )


def _summary(folder: Path) -> Mapping[str, Any]:
    from annulus_pipe.storage.results_folder import SUMMARY, read_summary, unreadable

    try:
        return read_summary(folder)
    except (OSError, ValueError) as error:
        raise unreadable(folder / SUMMARY, error) from None


def _section(of: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = of.get(name)
    return found if isinstance(found, Mapping) else {}


def _today() -> date:
    return datetime.now(UTC).date()


def _issued(text: str) -> date:
    from annulus_pipe.qualification.certificate import CLOCKS_APART, YEARS

    try:
        day = date.fromisoformat(text)
    except ValueError:
        raise AnnulusError(f"--date {text}: expected a day, YYYY-MM-DD") from None
    if not YEARS[0] <= day.year <= YEARS[1]:
        raise AnnulusError(f"--date {text}: expected a year in {YEARS[0]}..{YEARS[1]}")
    if day > _today() + CLOCKS_APART:  # it would hold for longer than its plan says
        raise AnnulusError(f"--date {text}: lies in the future, expected today or before")
    return day


def _signed(value: float) -> str:
    return f"{value:+.2g}".replace("-", "−")


def _write(path: Path, content: str | bytes) -> None:
    from annulus_pipe.storage.whole import written_whole

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as file:
            file.write(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be written ({error.strerror}).") from None
