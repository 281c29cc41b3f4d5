"""A gauge study's plan, its runs and its certificate, made wrong. What is under a signature is looked at without it."""

from datetime import date
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from annulus_pipe.qualification.applicability import HeadInUse
from annulus_pipe.qualification.certificate import FILE, Certificate, parse_certificate
from annulus_pipe.qualification.plan import plan_from, planned, read_plan, read_runs, runs_csv
from annulus_pipe.qualification.quoting import Qualification
from annulus_pipe.qualification.study import Conditions, GaugeReading, certified
from annulus_pipe.report.certificate_page import certificate_page
from annulus_pipe.untrusted import parse_json, parse_toml
from tools.bench.fuzz.mutate import HOSTILE, as_json, of_bytes, of_rows, of_toml, of_values

PLAN = """title = "two sleeves"
head = "7"
laboratory = "Pipe Laboratory"
operators = ["Ames", "Bose"]
repeats = 2
months = 12
one_pull = true

[[piece]]
name = "A"
diameter_mm = 151.8
u_mm = 0.02
from_mm = 90
to_mm = 140

[[piece]]
name = "B"
diameter_mm = 153.2
u_mm = 0.02
from_mm = 160
to_mm = 210
measured_by = "bore gauge"
"""
STUDY = plan_from(parse_toml(PLAN.encode()))
PLAN_FILE, RUNS_FILE = "plan.toml", "runs.csv"
USE = HeadInUse("7", "ab", "1.4.0", "0.1.0", 152.0, 12.0, date(2026, 12, 1))


def certificate_case(rng: Random) -> bytes:
    kind = rng.randrange(4)
    if kind == 0:
        return PLAN_FILE.encode() + b"\0" + of_toml(rng, PLAN).encode("utf-8", "surrogatepass")
    if kind == 1:
        runs = runs_csv(planned(STUDY))
        wrong = (
            of_bytes(rng, runs.encode()) if rng.random() < 0.5 else of_rows(rng, runs).encode("utf-8", "surrogatepass")
        )
        return RUNS_FILE.encode() + b"\0" + wrong
    return FILE.encode() + b"\0" + as_json(rng, of_values(rng, _sample(), HOSTILE))


def certificate_read(data: bytes, folder: Path) -> None:
    name, _, content = data.partition(b"\0")
    path = folder / name.decode()
    path.write_bytes(content)
    if path.name == PLAN_FILE:
        runs_csv(planned(read_plan(path)))
    elif path.name == RUNS_FILE:
        read_runs(path, STUDY)
    else:
        unsigned = Certificate.from_dict(parse_json(content, 1 << 22))
        certificate_page(unsigned).encode()
        for anchored in (True, False):
            Qualification(unsigned).quoted(USE, anchored=anchored).accuracy.line.encode()
        parse_certificate(content)


@cache
def _sample() -> dict[str, Any]:
    readings = [
        GaugeReading(run, piece, piece.diameter_mm + 0.01 * i, 0.1, 0.01, 20, 0.1, f"{i:012x}")
        for i, run in enumerate(planned(STUDY))
        for piece in STUDY.pieces
    ]
    return certified(STUDY, readings, Conditions("ab", "1.4.0", "0.1.0", "", 1500.0), date(2026, 11, 29)).to_dict()
