"""What a certificate, a POD or a unity plot is given by mistake or on purpose: one line that says what was expected, or
a result that says what cannot be told."""

import csv
import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from drawn_study import HEAD, fill_in, listed, write_plan, write_results
from typer.testing import CliRunner, Result

from annulus_pipe.cli.app import app

SPOOL = [(200.0 + 80 * i, 36.0 * i % 360, round(0.3 + 0.03 * i, 2)) for i in range(60)]
HEADER = "name,kind,z_mm,clock_deg,depth_mm,length_mm,width_mm,pipe\n"
PLATE = json.dumps({"format": "annulus-summary/1", "height_mm": {}})


def typed(line: str) -> Result:
    return CliRunner().invoke(app, line.split())


def truths(path: Path, depth: Callable[[float], object] = lambda mm: mm, pipe: str = "spool 1") -> None:
    rows = [f"{i},loss,{z},{clock},{depth(mm)},20,20,{pipe}\n" for i, (z, clock, mm) in enumerate(SPOOL)]
    path.write_text(HEADER + "".join(rows))


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A certificate, a spool and its pull, digs and their survey: all as they should be."""
    folder = tmp_path_factory.mktemp("study")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write_plan(folder / "plan.toml")
        assert typed("certify plan plan.toml -o study").exit_code == 0
        fill_in(folder / "study/runs.csv")
        assert typed("certify key -o lab.key").exit_code == 0
        assert typed("certify issue plan.toml --runs study/runs.csv --key lab.key -o c").exit_code == 0
        truths(folder / "spool.csv")
        pull = [listed(z + 3, clock, mm) for z, clock, mm in SPOOL if mm > 0.8 or mm in (0.6, 0.69, 0.75)]
        write_results(folder / "pull", 152.4, {"pipe": "spool 1", "head": HEAD}, pull, stations=1000)
        assert typed("pod match spool.csv pull -o trials.json").exit_code == 0
        (folder / "digs.csv").write_text("z_mm,clock_deg,depth_mm\n2200,180,1.02\n2280,216,1.1\n2360,252,1.08\n")
    return folder


@pytest.fixture
def here(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    shutil.copytree(study, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def changed(path: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        content = (folder / path).read_text()
        assert old in content
        (folder / path).write_text(content.replace(old, new, 1))

    return change


def holds(path: str, content: bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / path).write_bytes(content) and None


def sparse(path: str) -> Callable[[Path], None]:
    """1 GB."""

    def change(folder: Path) -> None:
        with (folder / path).open("wb") as file:
            file.truncate(1 << 30)

    return change


def run_twice(folder: Path) -> None:
    with (folder / "study/runs.csv").open("a", newline="") as file:
        first = list(csv.reader((folder / "study/runs.csv").open(newline="")))[1]
        csv.writer(file, lineterminator="\n").writerow(first)


ISSUE = "certify issue plan.toml --runs study/runs.csv --key lab.key -o new"
VERIFY = "certify verify c/certificate.json"
MATCH = "pod match spool.csv pull -o trials.json"
UNITY = "unity digs.csv pull -o unity"
JUNK = bytes(range(256)) * 40
WRONG: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "one operator": (
        changed("plan.toml", '"maria", "jo"', '"maria"'),
        "certify plan plan.toml -o s",
        "list of 2 to 32",
    ),
    "a run twice": (run_twice, ISSUE, "is there twice"),
    "a temperature that is none": (changed("study/runs.csv", ",20,", ",nan,"), ISSUE, "temperature_c is 'nan'"),
    "runs that are empty": (holds("study/runs.csv", b""), ISSUE, "its columns are ''"),
    "runs of 1 GB": (sparse("study/runs.csv"), ISSUE, "larger than 1 MiB"),
    "a plan that is junk": (holds("plan.toml", JUNK), ISSUE, "plan.toml"),
    "a run before a plate": (holds("study/results/003/summary.json", PLATE.encode()), ISSUE, "results of a plate"),
    "a certificate edited": (
        changed("c/certificate.json", '"repeats": 2', '"repeats": 9'),
        VERIFY,
        "not as it was signed",
    ),
    "a certificate that is empty": (holds("c/certificate.json", b""), VERIFY, "not JSON"),
    "a certificate of 1 GB": (sparse("c/certificate.json"), VERIFY, "larger than 4 MiB"),
    "a certificate that is junk": (holds("c/certificate.json", JUNK), VERIFY, "not a text file"),
    "truths of another pipe": (lambda f: truths(f / "spool.csv", pipe="spool 9"), MATCH, "the truths are of spool 9"),
    "truths in inches": (lambda f: truths(f / "spool.csv", lambda mm: round(mm / 25.4, 4)), MATCH, "look like inches"),
    "depths without a unit": (changed("spool.csv", "depth_mm", "depth"), MATCH, "expected depth_mm"),
    "a depth that is none": (changed("spool.csv", ",0.3,", ",nan,"), MATCH, "depth_mm is nan"),
    "truths that are empty": (holds("spool.csv", b""), MATCH, "no column kind"),
    "truths of 1 GB": (sparse("spool.csv"), MATCH, "larger than 64 MiB"),
    "a pull before a plate": (holds("pull/summary.json", PLATE.encode()), MATCH, "results of a plate"),
    "trials that are junk": (holds("trials.json", JUNK), "pod fit trials.json -o pod", "not a text file"),
    "trials given twice": (lambda f: None, "pod fit trials.json trials.json -o pod", "twice"),
    "digs in metres": (
        holds("digs.csv", b"z_mm,clock_deg,depth_mm\n2.2,180,1.02\n2.28,216,1.1\n2.36,252,1.08\n"),
        UNITY,
        "metres",
    ),
    "digs of another pipe": (
        holds("digs.csv", b"z_mm,clock_deg,depth_mm\n9200,1,1\n9700,8,1\n"),
        UNITY,
        "Another pipe?",
    ),
    "digs without a unit": (changed("digs.csv", "depth_mm", "depth_in"), UNITY, "1 in is 25.4 mm"),
    "digs of 1 GB": (sparse("digs.csv"), UNITY, "larger than 1 MiB"),
    "a survey that is junk": (holds("pull/summary.json", JUNK), UNITY, "not a text file"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_one_line(case: str, here: Path) -> None:
    spoil, line, why = WRONG[case]
    spoil(here)
    done = typed(line)
    refusal = str(done.exception)
    assert done.exit_code == 1 and type(done.exception).__name__ == "AnnulusError", (done.output, refusal)
    assert why in refusal and "\n" not in refusal and len(refusal) < 400


def test_a_certificate_speaks_for_its_own_head_and_its_own_time(here: Path) -> None:
    write_results(here / "other", 152.4, {"head": "annulus-8", "temperature_c": 20.0})
    done = typed(f"{VERIFY} --results other")
    assert done.exit_code == 1 and "does not apply" in done.output and "it is of head annulus-7" in done.output
    assert "after the day of issue, 2020-01-01" in str(typed(f"{ISSUE} --date 2020-01-01").exception)
    for run in here.glob("study/results/*/summary.json"):
        run.write_text(re.sub(r'"begun_utc": "[0-9-]{10}', '"begun_utc": "2019-11-02', run.read_text()))
    assert typed(f"{ISSUE} --date 2020-01-01").exit_code == 0
    done = typed("certify verify new/certificate.json")
    assert done.exit_code == 1 and "it lapsed on 2020-11-02" in done.output


@pytest.mark.parametrize(("shallowest", "why"), [(0.0, "all were detected"), (9.0, "none was detected")])
def test_a_pod_of_all_or_nothing_says_what_cannot_be_told(shallowest: float, why: str, here: Path) -> None:
    found = [listed(z, clock, mm) for z, clock, mm in SPOOL if mm > shallowest]
    shutil.rmtree(here / "pull")
    write_results(here / "pull", 152.4, {"pipe": "spool 1"}, found, stations=1000)
    assert typed(MATCH).exit_code == 0
    done = typed("pod fit trials.json -o pod")
    assert done.exit_code == 0 and f"a90/95 not established (depth of wall loss): {why}" in done.output
