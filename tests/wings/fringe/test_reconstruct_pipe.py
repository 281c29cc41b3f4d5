"""A pipe under a slide of rings by the functions behind the commands: what is refused, and how windows become one."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bores import LENS, RADIUS_MM, SLIDE

from annulus_pipe.geometry.calibration import camera_to_dict
from annulus_pipe.report import ScanAccount, write
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wings.fringe import calibrate_pipe as calibrate
from annulus_pipe.wings.fringe import pipe as module
from annulus_pipe.wings.fringe.calibrate_pipe import calibrate_fringe_pipe
from annulus_pipe.wings.fringe.measure import CleanPipeFit, PipeMap, projector_to_dict
from annulus_pipe.wings.fringe.measure.bore import TERMS
from annulus_pipe.wings.fringe.measure.placement import PlacedHead
from annulus_pipe.wings.fringe.measure.projector import LAW
from annulus_pipe.wings.fringe.pipe import open_fringe_pipe, reconstruct_fringe_pipe

STEP = RADIUS_MM / 200
HEAD = {"id": 0, **camera_to_dict(LENS.camera), "rotation": LENS.rotation, "translation_mm": LENS.translation_mm}


def calibration(folder: Path, **changes: Any) -> Path:
    data = {
        "format": "annulus-calibration/2",
        "cameras": [HEAD],
        "transfer": {},
        "pipe": {"radius_mm": RADIUS_MM},
        "pattern": {"kind": "fringe", "projector": projector_to_dict(SLIDE)},
        **changes,
    }
    path = folder / "head.json"
    path.write_text(json.dumps({key: value for key, value in data.items() if value is not None}))
    return path


def scan(folder: Path, columns: str, rows: list[str], grey: int = 40, size: int = 360) -> Path:
    folder.mkdir(exist_ok=True)
    picture = np.full((size, size), grey, np.uint8)
    for k in range(len(rows)):
        cv2.imwrite(str(folder / f"{k}.png"), picture)
    lines = [f"{k},{k}.png,projector,{row}" for k, row in enumerate(rows)]
    (folder / "frames.csv").write_text(f"index,file,light,{columns}\n" + "\n".join(lines) + "\n")
    return folder


@pytest.mark.parametrize(
    ("rows", "text"),
    [(["0", "1"], "2 frames with the projector, expected at least 3"), (["5"] * 4, "the head did not move")],
)
def test_a_scan_that_shifts_no_phase_is_one_line(tmp_path: Path, rows: list[str], text: str) -> None:
    with pytest.raises(AnnulusError, match=text):
        open_fringe_pipe(scan(tmp_path / "scan", "z_mm", rows), calibration(tmp_path))


def test_darkness_a_glare_and_anothers_frames_are_one_line(tmp_path: Path) -> None:
    head = calibration(tmp_path)
    for grey, size, text in ((0, 360, "lit"), (255, 360, "saturated"), (40, 300, "camera 0 is 360x360 but")):
        job = open_fringe_pipe(scan(tmp_path / f"{grey}-{size}", "z_mm", ["0", "1", "2", "3"], grey, size), head)
        with pytest.raises(AnnulusError, match=text):
            reconstruct_fringe_pipe(job)


def test_a_calibration_that_is_none_for_it_is_one_line(tmp_path: Path) -> None:
    aside = scan(tmp_path / "aside", "z_mm,tx_mm,ty_mm", ["0,0,0", "0,3,0", "0,0,3"])
    plain = scan(tmp_path / "plain", "z_mm", ["0", "0", "0"])
    with pytest.raises(AnnulusError, match="frame 0 has no tx_mm, ty_mm"):
        calibrate_fringe_pipe(plain, calibration(tmp_path))
    with pytest.raises(AnnulusError, match=r'no "pipe\.radius_mm"'):
        calibrate_fringe_pipe(aside, calibration(tmp_path, pipe=None))
    with pytest.raises(AnnulusError, match="is no slide of rings"):
        calibrate_fringe_pipe(aside, calibration(tmp_path, pattern={"kind": "fringe"}))
    with pytest.raises(AnnulusError, match="0 frames: phase, DC and AC"):
        calibrate_fringe_pipe(aside, calibration(tmp_path, cameras=[HEAD, {**HEAD, "id": 1}]))
    with pytest.raises(AnnulusError, match="no slide of fringes and pipe"):
        open_fringe_pipe(aside, calibration(tmp_path, pattern={"kind": "fringe"}))


def test_slides_in_turn_need_slots_and_a_head_that_is_one(tmp_path: Path) -> None:
    slide = projector_to_dict(SLIDE)
    lamps = [{**slide, "cameras": [0], "slots": [0]}, {**slide, "cameras": [0], "slots": [2]}]
    head = calibration(tmp_path, pattern={"kind": "fringe", "projectors": lamps})
    with pytest.raises(AnnulusError, match="no frame says its slot in the lamp cycle"):
        open_fringe_pipe(scan(tmp_path / "plain", "z_mm", [f"{k}" for k in range(8)]), head)
    placed = scan(tmp_path / "told", "z_mm,slot", [f"{k},{k % 3 if k else ''}" for k in range(13)])
    job = open_fringe_pipe(placed, head)
    assert [eye for flash in job.flashes for eye, _ in flash] == [1, 0] * 4  # slots 0 and 2; 1 is no slide's
    assert [finding.kind for finding in job.findings] == ["slot"]
    for wrong, text in (
        ({"cameras": [3]}, "names 3, which is no camera"),
        ({"slots": ["x"]}, "expected a whole number"),
    ):
        bad = calibration(tmp_path, pattern={"kind": "fringe", "projectors": [{**lamps[0], **wrong}]})
        with pytest.raises(AnnulusError, match=text):
            open_fringe_pipe(placed, bad)
    both = calibration(tmp_path, pattern={"kind": "fringe", "projector": slide, "projectors": lamps})
    with pytest.raises(AnnulusError, match="expected one of them"):
        open_fringe_pipe(placed, both)


def test_a_pipe_whose_frames_do_not_fit_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A radius half as large leaves 0.42 of the swing in the ray-traced pipe, the right one 0.02."""
    aside = scan(tmp_path / "aside", "z_mm,tx_mm,ty_mm", ["0,0,0", "0,3,0", "0,0,3"])
    for misfit, wrong in ((8.0, True), (0.5, False)):
        found = CleanPipeFit(SLIDE, np.ones(LAW), np.eye(LAW), np.zeros(6), misfit, 3)
        monkeypatch.setattr(calibrate, "calibrate_pipe", lambda *_, found=found: found)
        if wrong:
            with pytest.raises(AnnulusError, match="do not show this slide in a pipe of 60 mm radius"):
                calibrate_fringe_pipe(aside, calibration(tmp_path))
        else:
            assert calibrate_fringe_pipe(aside, calibration(tmp_path)).found is found


@pytest.mark.deep(
    gate="tests/wings/fringe/test_reconstruct_pipe.py::test_darkness_a_glare_and_anothers_frames_are_one_line"
)
def test_windows_of_a_long_scan_are_one_wall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each sees 80 mm; the groove lies where two meet. What a window says where another is nearer is not taken."""
    held = []

    def measured(eyes: Any, shots: Any, z_mm: Any, radius_mm: float, roll_rad: Any = None) -> PipeMap:
        held.append(len(shots.images))
        rows = np.arange(np.ceil((z_mm.min() + 60) / STEP), np.floor((z_mm.max() + 90) / STEP)) * STEP
        phi = np.arange(0.0, 360.0, 0.5)
        shape = len(rows), len(phi)
        radius = np.full(shape, RADIUS_MM)
        radius[np.ix_(np.abs(rows - 108) < 3, np.abs(phi - 90) < 4)] += 0.5
        radius[:4] += 9.0  # its first rows, where the one before it is nearer
        if not z_mm.min():
            radius[:4] -= 9.0
        poses = np.zeros((len(z_mm), 6))
        poses[:, 5] = z_mm
        head = PlacedHead(tuple(eyes), poses, shots.eye, shots.flash, np.zeros((1, 3, TERMS)), RADIUS_MM)
        few, none = np.full(shape, 8), np.zeros(shape)
        return PipeMap(
            rows,
            phi,
            radius + np.random.default_rng(1).normal(0, 0.01, shape),
            none + 0.01,
            none.astype(np.uint8),
            none > 1,
            none + 50.0,
            none + 0.8,
            few,
            few * 0,
            head,
            (1.0, 0.0, 0.0),
            np.zeros(len(z_mm), bool),
        )

    monkeypatch.setattr(module, "measure_pipe", measured)
    folder = scan(tmp_path / "long", "z_mm", [f"{k}" for k in range(60)])
    found = reconstruct_fringe_pipe(open_fringe_pipe(folder, calibration(tmp_path)))
    assert max(held) == module.WINDOW
    assert len(found.map.head.poses) == 60
    assert (found.map.z_mm[0], found.map.z_mm[-1]) == pytest.approx((60.0, 149.0), abs=2 * STEP)
    assert np.allclose(np.diff(found.map.z_mm), STEP)
    assert np.abs(found.map.radius_mm - RADIUS_MM).max() < 1.0
    (loss,) = found.survey.defects
    assert loss.kind is Kind.LOSS
    assert loss.depth_mm == pytest.approx(0.5, abs=0.03)
    assert (loss.z_mm, loss.clock_deg) == pytest.approx((108.0, 180.0), abs=0.5)
    summary = write(found.survey, ScanAccount("here", {}, {}, {}), tmp_path / "out", depth={"z_mm": found.map.z_mm})
    assert summary["diameter_mm"]["mean"] == pytest.approx(2 * RADIUS_MM, abs=0.02)
    assert np.load(tmp_path / "out" / "depth.npz")["z_mm"].shape == found.map.z_mm.shape
