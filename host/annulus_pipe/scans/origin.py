"""Where a scan came from, as far as it was written down: in a recording's identity, beside a scan folder, and in the
calibration."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from annulus_pipe.job import JobSheet, Origin, parse_job, provenance, read_job, recorded_provenance
from annulus_pipe.record.frames import IDENTITY
from annulus_pipe.record.recording import Recording
from annulus_pipe.scans.marks import observations_of
from annulus_pipe.scans.scan import Scan
from annulus_pipe.storage.calibration_file import load_sections
from annulus_pipe.storage.place import Where, read_whole
from annulus_pipe.untrusted import TOML_MAX, printable
from annulus_pipe.vocabulary import AnnulusError

JOB_TOPIC = "/job"
JOBS_MAX = 1000  # sheets of one scan that are read; an operator types a dozen
JOB_FILE = "job.toml"  # of a scan folder, beside frames.csv
UTC_MAX = 40  # characters of a time


def origin_of(scan: Scan, calibration: Path | None = None, job: JobSheet | None = None) -> Origin:
    """What is known of a scan's origin. Raises AnnulusError where a scan folder's job.toml, or `calibration`, is none.

    calibration : the file in place of the recording's own. job : goes over what the scan says.
    """
    over = job or JobSheet()
    made = {} if calibration is None else provenance(load_sections(calibration))
    recording = scan.recording
    if recording is None:
        own = _job_beside(scan.path)
        return Origin(own.under(over), calibration=made, calibration_file=_name(calibration))
    who = [one for one in recording.notes(IDENTITY) if isinstance(one, dict)]
    first: Mapping[str, Any] = who[0] if who else {}
    last: Mapping[str, Any] = who[-1] if who else {}
    configuration = recording.configuration or {}
    observations, left_out = observations_of(scan)
    if calibration is None:
        made = provenance(recording.calibration) or recorded_provenance(configuration)
    return Origin(
        job_told(recording).under(over),
        (_time(first.get("utc")), _time(last.get("utc"))),
        _texts(last.get("controller")),
        made,
        "the recording's own" if calibration is None else _name(calibration),
        _texts(first.get("versions")),
        observations,
        left_out,
    )


def _job_beside(folder: Where) -> JobSheet:
    beside = folder / JOB_FILE
    if isinstance(beside, Path):
        return read_job(beside) if beside.is_file() else JobSheet()
    try:
        return parse_job(read_whole(beside, TOML_MAX), beside)
    except FileNotFoundError:
        return JobSheet()
    except (OSError, ValueError) as error:
        raise AnnulusError(f"{beside}: cannot be read ({error}). Expected a job.toml.") from None


def job_told(recording: Recording) -> JobSheet:
    """The job as the scan's operators knew it in the end, field by field: what was configured, over it what the
    recorder said of itself, over that what was told during the scan (`/job`), the last word counting."""
    sheet = JobSheet.recorded((recording.configuration or {}).get("job"))
    who = [one for one in recording.notes(IDENTITY) if isinstance(one, dict)]
    sheet = sheet.under(JobSheet.recorded(who[-1].get("job") if who else None))
    for note, _ in zip(recording.notes(JOB_TOPIC), range(JOBS_MAX), strict=False):
        sheet = sheet.over_told(note)
    return sheet


def _name(calibration: Path | None) -> str:
    return "" if calibration is None else printable(calibration.name)


def _time(value: object) -> str:
    return printable(value) if isinstance(value, str) and len(value) <= UTC_MAX else ""


def _texts(value: object) -> dict[str, str]:
    """Of a mapping its short values, as texts."""
    return {
        key: printable(str(one))
        for key, one in (value.items() if isinstance(value, Mapping) else ())
        if isinstance(key, str) and isinstance(one, str | int | float) and len(str(one)) <= UTC_MAX
    }
