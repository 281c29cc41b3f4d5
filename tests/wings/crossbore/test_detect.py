"""Cross bores in logs the twin draws: found where they are, none made up, no near miss or coupling taken for one."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.ground import Bore, Drawn, Ground, log, some_ground, write
from annulus_pipe.wings.crossbore.log_file import read_bore_log
from annulus_pipe.wings.crossbore.measure import BoreDetections, BoreIndication, BoreKind, Log, detect, on_grid

PLAIN = Ground(6000.0)


def found(ground: Ground, seed: int = 1) -> BoreDetections:
    return detect(on_grid(log(ground, seed).rows()))


def only(ground: Ground, seed: int = 1) -> BoreIndication:
    (one,) = found(ground, seed).indications
    return one


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", range(8))
def test_pipe_a_is_found_with_air_pipe_b_with_its_side_and_pipe_c_never(seed: int) -> None:
    """The three pipes of Figure 10.6: an 8-inch sewer that a pipe passes through, half into, and beside."""
    phi = 90.0 + 30.0 * (seed - 4)  # straight up it would be a sewer half full
    through = only(replace(PLAIN, bores=(Bore(3000.0, 101.0),)), seed)
    assert through.kind is BoreKind.AIR and np.isnan(through.phi_deg)
    assert through.odometer_mm == pytest.approx(3006, abs=15) and through.extent_mm == pytest.approx(200, abs=40)
    half = only(replace(PLAIN, bores=(Bore(3000.0, 101.0, 101.0, phi),)), seed)
    assert half.kind is BoreKind.AIR and half.odometer_mm == pytest.approx(3006, abs=20)
    assert abs((half.phi_deg - phi + 180) % 360 - 180) < 25
    for clear in (10.0, 50.0):
        assert not found(replace(PLAIN, bores=(Bore(3000.0, 101.0, 145.5 + clear, phi),)), seed).bores


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("eps", [4.0, 9.0, 15.0, 24.0])
@pytest.mark.parametrize("pose", [False, True])
def test_a_coupling_is_called_one_in_any_soil(eps: float, pose: bool) -> None:
    one = only(replace(PLAIN, soils=(eps,), couplings_mm=(3000.0,), pose=pose), 3)
    assert one.kind is BoreKind.COUPLING and one.odometer_mm == pytest.approx(3006, abs=15)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", range(6))
def test_a_couplings_transient_says_how_fast_the_head_was(seed: int) -> None:
    """Its length is known: the transient says the same of a head whose odometer counts a fifth too much."""
    drawn = log(replace(PLAIN, couplings_mm=(3000.0,)), seed)
    rows = drawn.rows()
    at = np.abs(rows.odometer_mm - drawn.odometer_mm(3000.0)) < 100
    true = float(np.ptp(rows.odometer_mm[at]) / np.ptp(rows.t_s[at]))
    for scale in (1.0, 1.2):
        grid = on_grid(replace(rows, odometer_mm=scale * rows.odometer_mm))
        (one,) = (i for i in detect(grid, joints_mm=[scale * 3006]).indications if i.kind is BoreKind.COUPLING)
        transient, odometer = one.speed_mm_s
        assert transient == pytest.approx(true, rel=0.25) and odometer == pytest.approx(scale * true, rel=0.1)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", range(4))
def test_a_head_that_wanders_by_millimetres_gives_a_coupling_no_side_and_nothing_odds(seed: int) -> None:
    """1 mm off the axis adds 85 fF to one sector: by itself that is a sewer on one side. Nobody counted odds so."""
    ground = replace(PLAIN, couplings_mm=(3000.0,), wander_mm=1.2)
    account = found(ground, seed)
    assert not account.bores and not any(one.odds for one in account.indications)
    sewer = found(replace(PLAIN, bores=(Bore(3000.0, 101.0),), wander_mm=1.2), seed)
    assert [round(one.odometer_mm, -2) for one in sewer.bores] == [3000]
    assert found(replace(ground, pose=True), seed).indications[0].odds  # with the pose it does not wander


def test_a_bore_at_the_end_of_a_log_is_not_judged_and_that_is_said() -> None:
    account = found(replace(PLAIN, bores=(Bore(120.0, 101.0), Bore(3000.0, 101.0))))
    assert [round(one.odometer_mm, -2) for one in account.bores] == [3000]
    assert 120 < account.ends_mm < 400


def test_hollows_and_beads_have_their_names() -> None:
    ground = replace(PLAIN, voids=((2000.0, 25.0, 100.0),), beads_mm=(4000.0,))
    kinds = [(one.kind, round(one.odometer_mm, -2)) for one in found(ground, 2).indications]
    assert kinds == [(BoreKind.VOID, 2000), (BoreKind.BEAD, 4000)]


def test_water_is_told_in_dry_soil_or_by_its_loss_and_where_it_cannot_be_that_is_said() -> None:
    bore = (Bore(3000.0, 76.0, fill="water"),)
    assert only(replace(PLAIN, soils=(4.0,), bores=bore)).kind is BoreKind.WATER
    wet = replace(PLAIN, soils=(28.0,), bores=bore)
    blind, told = found(replace(wet, uneven=0.1)), found(replace(wet, loss=True))
    assert blind.water_told_mm == 0 and not any(one.kind is BoreKind.AIR for one in blind.bores)
    assert [one.kind for one in told.bores] == [BoreKind.WATER] and told.water_told_mm > 5900


def test_over_many_pipes_most_are_found_none_is_made_up_and_no_near_miss_reported() -> None:
    missed, count, false, off = 0, 0, 0, []
    for seed in range(100, 112):
        drawn = log(some_ground(20_000.0, seed, soils=(15.0, 22.0), pose=seed % 2 == 0), seed)
        truth, account = drawn.truth(), detect(on_grid(drawn.rows()))
        places = [0.5 * (bore["odo0_mm"] + bore["odo1_mm"]) for bore in truth["bores"]]
        for bore, place in zip(truth["bores"], places, strict=True):
            near = [one for one in account.bores if abs(one.odometer_mm - place) < 150]
            if bore["kind"] == "air":
                count += 1
                missed += not near
                off += [one.odometer_mm - place for one in near]
        false += sum(all(abs(one.odometer_mm - place) > 250 for place in places) for one in account.bores)
    assert count > 12 and missed <= 1 and false == 0
    assert np.sqrt(np.mean(np.square(off))) < 15


def test_lift_off_comes_out_by_the_pose_and_a_hole_in_the_log_stays_one() -> None:
    drawn = log(replace(PLAIN, wander_mm=0.6, pose=True), 4)
    with_pose = on_grid(drawn.rows())
    without = on_grid(replace(drawn.rows(), offset_mm=None))
    assert with_pose.lift_ff_mm == pytest.approx(375 / 4.43, rel=0.15)
    assert np.std(with_pose.c_ff, axis=0).max() < 0.4 * np.std(without.c_ff, axis=0).max()
    drawn = log(replace(PLAIN, bores=(Bore(3000.0, 101.0),)), 5)
    gone = np.abs(drawn.columns["odometer_mm"] - 3006) < 250
    drawn = Drawn(drawn.ground, {name: c[~gone] for name, c in drawn.columns.items()}, drawn._course)
    account = detect(on_grid(drawn.rows()))
    assert account.unseen_mm == pytest.approx(450, abs=60) and not account.bores


def test_the_commands_make_a_log_and_find_what_was_put_in(tmp_path: Path) -> None:
    log_path, out = tmp_path / "pipe.csv.gz", tmp_path / "found.json"
    run = CliRunner().invoke(
        app, ["bore", "simulate", str(log_path), "--length-m", "20", "--seed", "7", "--pose", "--loss"]
    )
    assert run.exit_code == 0, run.output
    truth = json.loads((tmp_path / "pipe.truth.json").read_text())
    ran = CliRunner().invoke(app, ["bore", "detect", str(log_path), "-o", str(out)])
    assert ran.exit_code == 0, ran.output
    said = json.loads(out.read_text())
    air = [bore for bore in truth["bores"] if bore["kind"] == "air"]
    assert air and all(
        any(abs(one["odometer_mm"] - 0.5 * (b["odo0_mm"] + b["odo1_mm"])) < 100 for one in said) for b in air
    )
    assert (tmp_path / "found.png").stat().st_size > 20_000 and "mm long" in ran.output


HEAD = "t_s,odometer_mm,c1_pf,c2_pf,c3_pf,cref_pf,roll_deg\n"
ROW = "0.1,10,4.8,4.8,4.8,4.7,0\n"


@pytest.mark.deep(but="t_s,odometer_mm,c1_pf,c2_pf,c3_pf,cref_pf,roll_deg\\n-no rows")
@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "no column t_s and odometer_mm"),
        (HEAD, "no rows"),
        (HEAD.replace("cref_pf,", ""), "no column cref_pf"),
        (HEAD + "0.1,ten,4.8,4.8,4.8,4.7,0\n", "line 2: odometer_mm is 'ten', expected a number"),
        (HEAD + ROW + "0.0,10,4.8,4.8,4.8,4.7,0\n", "t_s goes back from 0.1 to 0 s"),
        (HEAD + ROW.replace("4.8", "4800"), "c1_pf is 4800 in the middle, expected pF"),
        (HEAD + "0.1,10,inf,4.8,4.8,4.7,0\n", "c1_pf is 'inf'"),
        (HEAD + ROW * 3, "3 rows, expected at least"),
        (HEAD + ROW * 300, "the odometer covers 0 mm"),
        (HEAD + ROW * 300 + ROW.replace("10", "1e11"), "the odometer covers"),
        (HEAD + "0.1,10,,,,4.7,0\n" * 9, "100 % of the rows have an empty cell"),
        (HEAD.replace("c2_pf", "c1_pf") + ROW, "no column c2_pf"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    command = [str(Path(sys.executable).with_name("annulus")), "bore", "detect", str(path)]
    if text:  # one of them as a user would see it; the rest without a start of Python each
        with pytest.raises(AnnulusError) as error:
            on_grid(Log(*read_bore_log(path)))
        assert word in str(error.value) and "\n" not in str(error.value)
        return
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ran.returncode != 0 and word in ran.stderr and "Traceback" not in ran.stderr
    assert ran.stderr.strip().count("\n") == 0


def test_a_gzip_cut_short_and_a_missing_file_are_one_line(tmp_path: Path) -> None:
    write(log(PLAIN, 1), tmp_path / "log.csv.gz")
    whole = (tmp_path / "log.csv.gz").read_bytes()
    (tmp_path / "cut.csv.gz").write_bytes(whole[: len(whole) // 2])
    for name in ("cut.csv.gz", "none.csv"):
        with pytest.raises(AnnulusError, match="cannot be read"):
            read_bore_log(tmp_path / name)
