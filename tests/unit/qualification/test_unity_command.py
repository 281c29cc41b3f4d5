"""`annulus unity` as a user gives it: files, words, and one line for what is wrong."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.qualification.pod import detectability, pod_json
from annulus_pipe.qualification.trials import Pull, Trial, Trials, TrialState, TrueDefect
from annulus_pipe.qualification.unity_file import read_unity
from annulus_pipe.qualification.validation import Outcome
from annulus_pipe.vocabulary import AnnulusError

HEAD = "name,kind,z_mm,clock_deg,depth_mm,depth_u_mm,length_mm,width_mm\n"


def listed(kind: str, z: float, depth: float | None, **more: Any) -> dict[str, Any]:
    return {
        "kind": kind,
        "z_mm": z,
        "clock_deg": 90.0,
        "length_mm": 20.0,
        "arc_deg": 30.0,
        "depth_mm": depth,
        "depth_k2_mm": 0.1,
        "floor_seen": True,
        **more,
    }


SUMMARY: dict[str, Any] = {
    "format": "annulus-summary/1",
    "job": {"sdr": 11.0},
    "scanned_mm": {"from": 0.0, "to": 3000.0},
    "diameter_mm": {"mean": 90.0},
    "limits": {"depth_mm": 0.2},
    "defects": [listed("loss", 400.0, 1.5), listed("bump", 900.0, 2.0), listed("loss", 1600.0, 0.8, floor_seen=False)],
    "undecided": [listed("loss", 2200.0, 0.4)],
    "not_seen": [{"z_from_mm": 2600.0, "z_to_mm": 2800.0, "clock_deg": 90.0, "arc_deg": 60.0}],
}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps(SUMMARY))
    return folder


def run(results: Path, rows: str, *words: str) -> Result:
    digs = results.parent / "digs.csv"
    digs.write_text(HEAD + rows)
    return CliRunner().invoke(app, ["unity", str(digs), str(results), "-o", str(results.parent / "unity"), *words])


def test_a_study_is_written_as_a_file_a_page_and_a_picture(results: Path) -> None:
    rows = "D1,loss,380,92,1.45,0.1,,\nD2,bump,881,88,2.05,0.1,,\n,loss,2680,90,1.0,0.1,,\n,loss,2181,95,0.4,0.1,,\n"
    printed = run(results, rows, "--tolerance-mm", "0.2", "--json")
    assert printed.exit_code == 0, printed.output
    out = results.parent / "unity"
    found, content = read_unity(out / "unity.json"), json.loads(printed.stdout)
    assert content == json.loads((out / "unity.json").read_text()) and content["format"] == "annulus-unity/1"
    assert [row.outcome.value for row in found.rows] == ["found", "found", "not seen", "undecided"]
    assert found.shift_mm == pytest.approx(19.5) and found.shift_basis == "names"
    assert found.judgement.outcome is Outcome.OPEN and (found.judgement.within, found.judgement.n) == (2, 2)
    page = (out / "unity.html").read_text()
    for words in ("The specification is open", "2 of 2", "Next dig", "D3", "+20 mm were added", "level 1"):
        assert words in page, words
    assert (out / "unity.png").read_bytes().startswith(b"\x89PNG") and page.count("data:image/png") == 1


def test_what_is_printed_says_the_result_first(results: Path) -> None:
    printed = run(results, "D1,loss,400,92,1.45,0.1,,\n")
    lines = printed.stdout.splitlines()
    assert lines[0].startswith("1 of 1 within tolerance") and "is open" in lines[0]
    assert "each its own k = 2" in lines[1] and lines[-1].startswith("page ")


def write_pod(path: Path, bore_mm: float) -> None:
    """Of 20 losses, each 0.1 mm too deep or too shallow."""
    truths = [TrueDefect(f"T{i}", "loss", 100.0 * i, 0.0, 1.0 + 0.1 * i) for i in range(20)]
    trials = [
        Trial(one, "spool", TrialState.DETECTED, "loss", one.depth_mm + 0.1 * (-1) ** i, 0.1)
        for i, one in enumerate(truths)
    ]
    pull = Pull("spool", "", 0.0, 2000.0, bore_mm / 2)
    path.write_text(pod_json(detectability(Trials(tuple(trials), (pull,)))))


def test_a_study_of_detection_states_what_is_claimed_and_of_which_head(results: Path) -> None:
    pod = results.parent / "pod.json"
    write_pod(pod, 200.0)
    rows = "A,loss,400,90,1.55,0.02,,\nB,bump,900,90,2.0,0.02,,\n"
    lines = run(results, rows, "--pod", str(pod)).stdout.splitlines()
    assert lines[0].startswith("1 of 1 within tolerance")  # of bumps it states nothing
    assert "80 % of depths within loss ± 0.10 mm" in lines[1] and "(pod.json)" in lines[1]
    assert any("and the diameter is 90 mm" in line for line in lines)


def test_two_claims_and_a_certainty_that_nobody_states_get_one_line(results: Path) -> None:
    pod = results.parent / "pod.json"
    write_pod(pod, 90.0)
    for words, why in (
        (("--pod", str(pod), "--tolerance-mm", "1"), "--tolerance-mm and --pod are both a claim"),
        (("--pod", str(pod), "--certainty", "0.7"), "states no tolerance at 70 % certainty"),
        (("--pod", str(results / "summary.json")), "expected annulus-pod/1"),
    ):
        error = run(results, "A,loss,400,90,1.5,,,\n", *words).exception
        assert isinstance(error, AnnulusError) and why in str(error) and "\n" not in str(error)


@pytest.mark.parametrize(
    ("rows", "words", "why"),
    [
        ("", (), "has no digs"),
        ("A,loss,400,90,deep,,,\n", (), "line 2: depth_mm is 'deep'"),
        ("A,loss,90400,90,1,,,\n", (), "none of them in the 0 to 3000 mm"),
        ("A,loss,0.4,90,1.5,,,\nB,bump,0.9,90,2,,,\n", (), "if z_mm is in metres, not mm"),
        ("A,loss,400,90,15,,,\n", (), "depth_mm is 15, more than the wall of 10 mm"),
    ],
)
def test_wrong_digs_get_one_line(results: Path, rows: str, words: tuple[str, ...], why: str) -> None:
    error = run(results, rows, *words).exception
    assert isinstance(error, AnnulusError) and why in str(error) and "\n" not in str(error)
    assert not (results.parent / "unity").exists()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"format": "annulus-summary/9"}, "its format is 'annulus-summary/9'"),
        ({"not_seen": [{"z_from_mm": "a"}]}, "not_seen[0].z_from_mm is 'a', expected a number"),
        ({"diameter_mm": {}}, "diameter_mm.mean is None, expected a number"),
        ({"defects": {}}, "defects must be a list"),
        ({"not_seen": None}, "does not list what was not seen"),
    ],
)
def test_results_that_are_none_get_one_line(results: Path, change: dict[str, Any], why: str) -> None:
    (results / "summary.json").write_text(json.dumps(SUMMARY | change))
    error = run(results, "A,loss,400,90,1.5,,,\n").exception
    assert isinstance(error, AnnulusError) and why in str(error) and "\n" not in str(error)


def test_a_file_in_the_folders_place_gets_one_line(results: Path) -> None:
    (results.parent / "unity").write_text("")
    error = run(results, "A,loss,400,90,1.5,,,\n").exception
    assert isinstance(error, AnnulusError) and "cannot be written" in str(error)


def test_a_study_is_quoted_without_scipy(results: Path) -> None:
    run(results, "A,loss,400,90,1.5,,,\n")
    script = (
        "import sys; from pathlib import Path; from annulus_pipe.qualification.unity_file import read_unity; "
        "print(*read_unity(Path(sys.argv[1])).statement()); "
        "assert not {'scipy.stats', 'scipy.optimize', 'statsmodels'} & sys.modules.keys()"
    )
    path = str(results.parent / "unity" / "unity.json")
    done = subprocess.run([sys.executable, "-c", script, path], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "within tolerance" in done.stdout, done.stderr
