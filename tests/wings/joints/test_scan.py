"""A near-field scan of a joint on the twin's bench, in real time: the controller's own code, a stage, a meter."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.twin.emulated import open_board
from annulus_pipe.twin.real_time import serving
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.linear_stage import LinearStage
from annulus_pipe.wings.joints.probe import VisaProbe
from annulus_pipe.wings.joints.raster_file import read_raster
from annulus_pipe.wings.joints.raster_log import RasterLog
from annulus_pipe.wings.joints.scan import RasterPlan, log_of, scan
from annulus_pipe.wings.joints.simulated import NOISE_MV, QUERIES, GrblStage, NearFieldRig, joint_field

PLAN = RasterPlan(angles=5, first_mm=10.0, last_mm=30.0, step_mm=4.0, averages=2, settle_ms=0.0)
FEED = 60_000.0


@contextmanager
def rig_of(**kwargs: object) -> Iterator[tuple[NearFieldRig, LinearStage, VisaProbe]]:
    with ExitStack() as stack:
        rig = stack.enter_context(serving(NearFieldRig(open_board("native"), **kwargs)))  # type: ignore[arg-type]
        carried = stack.enter_context(LinearStage(rig.stage_url, feed_mm_min=FEED))
        probe = VisaProbe(rig.probe_name, {name: query for query, name in QUERIES.items()})
        stack.callback(probe.close)
        yield rig, carried, probe


def truth(plan: RasterPlan) -> np.ndarray:
    return np.array([[joint_field(a, z)["amplitude_mv"] for a in plan.angle_deg] for z in plan.z_mm])


def test_every_point_is_measured_where_the_raster_says(tmp_path: Path) -> None:
    out = tmp_path / "raster.npz"
    with rig_of() as (rig, stage, probe):
        done = scan(rig.port_url, stage, probe, PLAN, out)
        assert rig.steps == 0  # the turntable is back
    angle, z, channels = read_raster(out)
    np.testing.assert_allclose(angle, PLAN.angle_deg)
    np.testing.assert_allclose(z, PLAN.z_mm)
    assert np.abs(channels["amplitude_mv"] - truth(PLAN)).max() < 5 * NOISE_MV / np.sqrt(2) + 0.2  # its place: 0.02 mm
    assert (done.points, done.measured, done.retries) == (30, 30, 0)


def test_a_meter_that_misses_a_query_is_asked_again_and_one_that_is_gone_ends_it(tmp_path: Path) -> None:
    out, said = tmp_path / "raster.npz", []
    with rig_of() as (rig, stage, probe):
        rig.deaf = 1
        short = RasterPlan(angles=3, first_mm=10, last_mm=14, step_mm=4, averages=1, settle_ms=0)
        done = scan(rig.port_url, stage, probe, short, out, say=said.append)
        assert done.retries == 1 and len(said) == 1
        rig.deaf = 10**6
        with pytest.raises(AnnulusError, match=r"3 times at angle 0, z 10 mm.*0 of 6 points are in .*resumed"):
            scan(rig.port_url, stage, probe, short, tmp_path / "again.npz")


def test_a_stage_that_stands_still_or_goes_too_far_ends_it(tmp_path: Path) -> None:
    with (
        rig_of(stage=GrblStage(stuck_at=20.0)) as (rig, stage, probe),
        pytest.raises(AnnulusError, match="stands at 20 mm, expected 22 mm"),
    ):
        scan(rig.port_url, stage, probe, PLAN, tmp_path / "stuck.npz")
    assert len(RasterLog.resumed(log_of(tmp_path / "stuck.npz")).points) == 3
    with rig_of() as (rig, stage, probe):
        with pytest.raises(AnnulusError, match=r"ALARM|alarm"):
            scan(rig.port_url, stage, probe, RasterPlan(first_mm=290.0, last_mm=310.0), tmp_path / "far.npz")
        with pytest.raises(AnnulusError, match=r"alarm|error:9"):
            stage.move(10.0)
        stage.home()
        stage.move(10.0)
        assert stage.position() == pytest.approx(10.0, abs=0.01)


@pytest.mark.deep(
    gate="tests/wings/joints/test_scan.py::test_a_meter_that_misses_a_query_is_asked_again_and_one_that_is_gone_ends_it"
)
def test_killed_interrupted_and_resumed_nothing_is_lost_or_measured_twice(tmp_path: Path) -> None:
    out = tmp_path / "raster.npz"
    command = [
        str(Path(sys.executable).with_name("annulus")),
        "joint",
        "scan",
        "--twin",
        "--angles",
        "6",
        "--step-mm",
        "4",
        "--averages",
        "1",
        "--settle-ms",
        "300",
        "-o",
        str(out),
        "--resume",  # slow: it must not end first
    ]
    points = log_of(out)
    for how in (signal.SIGKILL, signal.SIGINT):
        before = points.read_bytes().count(b"\n") if points.exists() else 3
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        end = time.monotonic() + 60
        while time.monotonic() < end and (not points.exists() or points.read_bytes().count(b"\n") < before + 4):
            time.sleep(0.05)
        process.send_signal(how)
        _, err = process.communicate(timeout=120)
        assert process.returncode not in (0, None)
        assert not out.exists()
        assert b"Traceback" not in err
        if how is signal.SIGKILL:
            with points.open("ab") as file:
                file.write(b"5,9,31")  # a line that was being written
    ran = subprocess.run(command, capture_output=True, timeout=120, check=True)
    assert b"66 points" in ran.stdout
    lines = points.read_text().splitlines()[3:]
    places = [tuple(line.split(",")[:2]) for line in lines]
    assert len(places) == len(set(places)) == 66
    assert np.isfinite(read_raster(out)[2]["phase_mv"]).all()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is no log"),
        (b"angle,z\n1,2\n3,4\n", "is no log"),
        (b"# annulus near-field scan 1\n# {\n", "is no log"),
        (b"# annulus near-field scan 1\n# {\ni,j,amplitude_mv\n", "line 2"),
        (b"# annulus near-field scan 1\n# {}\ni,j,volts\n", "line 3"),
        (b"# annulus near-field scan 1\n# {}\ni,j,amplitude_mv\n0,0,nan\n", "line 4"),
        (b"# annulus near-field scan 1\n# {}\ni,j,amplitude_mv\n0,0,1.0\n0,x,1.0\n", "line 5"),
    ],
)
def test_a_log_that_is_none_is_refused_by_its_line(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "raster.npz.points.csv"
    path.write_bytes(content)
    with pytest.raises(AnnulusError, match=said):
        RasterLog.resumed(path)
    assert path.read_bytes() == content


def test_other_settings_another_boot_and_a_full_disk_are_one_line(tmp_path: Path) -> None:
    out = tmp_path / "raster.npz"
    with rig_of() as (rig, stage, probe):
        RasterLog(log_of(out), {**PLAN_FIELDS, "boot": 7}, ("amplitude_mv", "phase_mv")).close()
        with pytest.raises(AnnulusError, match="controller restarted"):
            scan(rig.port_url, stage, probe, PLAN, out, resume=True)
        other = RasterPlan(angles=6, first_mm=10.0, last_mm=30.0, step_mm=4.0, averages=2, settle_ms=0.0)
        with pytest.raises(AnnulusError, match="angles = 5, now 6"):
            scan(rig.port_url, stage, probe, other, out, resume=True, homed=True)
        with pytest.raises(AnnulusError, match="is there already"):
            scan(rig.port_url, stage, probe, PLAN, out)
    log = RasterLog.resumed(log_of(out))
    full = open("/dev/full", "wb", buffering=0)  # noqa: SIM115  closed with the log
    log._file = full
    with pytest.raises(AnnulusError, match="No space left"):
        log.add(0, 0, {"amplitude_mv": 1.0, "phase_mv": 2.0})
    assert (0, 0) not in log.points
    full.close()


PLAN_FIELDS = {
    "angles": 5,
    "first_mm": 10.0,
    "last_mm": 30.0,
    "step_mm": 4.0,
    "averages": 2,
    "settle_ms": 0.0,
    "steps_per_turn": 400,
    "step_us": 1000.0,
}


def test_the_command_wants_one_bench_and_sane_settings(tmp_path: Path) -> None:
    out = str(tmp_path / "raster.npz")
    run = CliRunner(env={**os.environ, "COLUMNS": "200"}).invoke
    for options, said in (
        ([], "--port, --linear-stage and --probe, or --twin alone"),
        (["--twin", "--port", "/dev/null"], "--twin alone"),
        (["--port", "/dev/null", "--linear-stage", "/dev/null", "--probe", "x"], "--amplitude, --phase or both"),
        (["--twin", "--from-mm", "5", "--to-mm", "5"], "expected two or more"),
        (["--twin", "--angles", "500"], "500 angles"),
        (["--port", "/dev/none", "--linear-stage", "/dev/none", "--probe", "x", "--phase", "q"], "/dev/none"),
    ):
        told = run(app, ["joint", "scan", *options, "-o", out])
        assert told.exit_code != 0
        assert said in f"{told.output}{told.exception}", options
    told = run(app, ["joint", "scan", "--twin", "--angles", "3", "--step-mm", "20", "-o", out, "--json"])
    assert told.exit_code == 0, told.output
    assert json.loads(told.stdout)["points"] == 9
