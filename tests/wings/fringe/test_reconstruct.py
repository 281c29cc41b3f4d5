"""Scan folders of a drawn plate through the functions behind `annulus calibrate fringe` and `reconstruct`."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from plates import DISTANCE_MM, LEFT, RIGHT, SLIDE, drawn

from annulus_pipe.cli import main
from annulus_pipe.geometry.calibration import Calibration, HeadCamera, camera_to_dict
from annulus_pipe.report import ScanAccount
from annulus_pipe.reprocess.job import open_job
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe import plate as module
from annulus_pipe.wings.fringe.calibrate_pipe import _design
from annulus_pipe.wings.fringe.calibrate_plate import calibrate_fringe, save_fringe
from annulus_pipe.wings.fringe.job import open_fringe
from annulus_pipe.wings.fringe.measure import projector_to_dict
from annulus_pipe.wings.fringe.measure.plate import Plate
from annulus_pipe.wings.fringe.plate import reconstruct_fringe
from annulus_pipe.wings.fringe.plate_page import write_plate
from annulus_pipe.wings.fringe.recognise import fringes_on

PLACES = (0.0, 1.0, 2.1, 3.0, 3.9, 5.2, 6.1, 7.0)


def calibration(folder: Path, **changes: Any) -> Path:
    heads = [
        {"id": one.id, **camera_to_dict(one.camera), "rotation": one.rotation, "translation_mm": one.translation_mm}
        for one in (LEFT, RIGHT)
    ]
    data = {
        "format": "annulus-calibration/2",
        "cameras": heads,
        "transfer": {},
        "distance_mm": DISTANCE_MM,
        "pattern": {"kind": "fringe", "projector": projector_to_dict(SLIDE)},
        **changes,
    }
    path = folder / "head.json"
    path.write_text(json.dumps({key: value for key, value in data.items() if value is not None}))
    return path


def slide(**changes: Any) -> dict[str, Any]:
    return {"pattern": {"kind": "fringe", "projector": {**projector_to_dict(SLIDE), **changes}}}


def scan(
    folder: Path,
    places: Sequence[float] = PLACES,
    heights: Sequence[float] | None = None,
    *,
    gain: float = 1.0,
    column: str = "x_mm",
    heads: Sequence[Any] = (LEFT, RIGHT),
    texture: float = 0.3,
    specks: float = 0.0,
) -> Path:
    folder.mkdir(exist_ok=True)
    rows = []
    for one in heads:
        images = [
            drawn(
                np.array([x]),
                1.0 if heights is None else heights[k],
                noise=1.0,
                texture=texture,
                specks=specks,
                head=one,
                seed=k,
            )[0]
            for k, x in enumerate(places)
        ]
        for k, (x, image) in enumerate(zip(places, images, strict=True)):
            name = f"{k:06d}-{one.id}.png"
            cv2.imwrite(str(folder / name), np.clip(gain * image, 0, 255).round().astype(np.uint8))
            row = {"index": k, "camera": one.id, "file": name, "light": "projector", column: x}
            rows.append(row if heights is None else {**row, "height_mm": heights[k]})
    with (folder / "frames.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return folder


@pytest.mark.deep(
    gate="tests/wings/fringe/test_reconstruct.py::test_a_plate_a_fringe_from_where_it_was_told_is_refused"
)
def test_a_plate_is_calibrated_and_measured(tmp_path: Path) -> None:
    reference = scan(tmp_path / "reference", (0.0,) * 4, (-4.0, 0.0, 3.0, 8.0), texture=0.0)
    result = calibrate_fringe(reference, calibration(tmp_path, pattern=None))
    out = tmp_path / "made.json"
    save_fringe(result, out)
    assert fringes_on(out, out) == "plate"
    assert result.to_dict()["sigma"]["across_mm"] < 0.1
    assert json.loads(out.read_text())["pattern"]["rms_rad"] == pytest.approx(result.found.rms_rad)
    plate = reconstruct_fringe(open_fringe(scan(tmp_path / "scan"), out))
    measured = np.isfinite(plate.height_mm)
    assert plate.completeness > 0.95
    assert np.nanmedian(plate.height_mm) == pytest.approx(1.0, abs=0.02)
    off = (plate.height_mm[measured] - 1.0) / plate.sigma_mm[measured]
    assert np.mean(np.abs(off) < 2) > 0.9
    summary = write_plate(plate, ScanAccount("a scan", {"projector": 16}, {}, plate.timing_ms), tmp_path / "out")
    assert summary["points"] == measured.sum()
    with np.load(tmp_path / "out" / "depth.npz") as depth:
        assert depth["height_mm"].shape == (len(depth["y_mm"]), len(depth["x_mm"])) == depth["sigma_mm"].shape
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    assert "://" not in page
    assert "counter(pages)" in page and "size:" not in page.replace("font-size:", "")


@pytest.mark.deep(gate="tests/wings/fringe/test_reconstruct.py::test_a_motion_told_too_long_is_said")
def test_a_long_scan_holds_one_window_of_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WINDOW", 6)
    held = []
    read = module._WindowFrames.of

    def counted(self: Any, one: Any) -> Any:
        out = read(self, one)
        held.append(len(self._held))
        return out

    monkeypatch.setattr(module._WindowFrames, "of", counted)
    places = tuple(np.arange(14) * 1.1)
    plate = reconstruct_fringe(open_fringe(scan(tmp_path / "scan", places, heads=(LEFT,)), calibration(tmp_path)))
    assert max(held) <= 6
    assert plate.completeness > 0.9
    np.testing.assert_allclose(plate.places_mm, places, atol=0.1)
    inner = plate.height_mm[:, (plate.x_mm > 0) & (plate.x_mm < 25)]
    assert np.nanmedian(np.abs(inner - 1.0)) < 0.1
    assert np.isfinite(inner).mean() > 0.95  # no seam between windows


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("places", "changes", "text"),
    [
        (PLACES[:2], {}, "2 flashes with the projector, expected at least 3"),
        ((1.0, 1.0, 1.0, 1.0), {}, "the head did not move"),
        ((0.0, 4.0, 8.0, 12.0), {}, "by whole periods"),
        (PLACES, {"distance_mm": None}, 'has no "distance_mm"'),
        (PLACES, {"pattern": {"kind": "fringe"}}, 'has no "pattern.projector"'),
        (PLACES, {"pattern": {"kind": "lines"}}, "expected fringe"),
        (PLACES, {"motion": [1.0, 1.0, 0.0]}, "no unit vector"),
        (PLACES, {"motion": [0.0, 1.0, 0.0]}, "expected a motion across the stripes"),
        ((0.0, 0.001, 0.002), {}, "expected a motion across the stripes"),
        (PLACES, slide(centre_mm=[20.0, 0.0, 200.0]), "does not shine on the plate at 100 mm"),
        (PLACES, slide(rotation=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), r"head\.json: .*mirror"),
        (PLACES, slide(period=0), r"head\.json: .*period"),
    ],
)
def test_bad_input_is_one_line(tmp_path: Path, places: tuple[float, ...], changes: dict[str, Any], text: str) -> None:
    folder = scan(tmp_path / "scan", places, heads=(LEFT,))
    with pytest.raises(AnnulusError, match=text) as caught:
        open_fringe(folder, calibration(tmp_path, **changes))
    assert "\n" not in str(caught.value)


def test_a_slide_that_cannot_be_read_names_its_file(tmp_path: Path) -> None:
    path = tmp_path / "slide.json"
    path.write_text(json.dumps(slide(period=0)))
    with pytest.raises(AnnulusError, match=r"slide\.json: .*period"):
        _design(path)


def test_a_plate_a_fringe_from_where_it_was_told_is_refused(tmp_path: Path) -> None:
    a_fringe = DISTANCE_MM * (1 - 1 / 1.2)  # 20 mm / (0.04 (100 - h)) is one more than 5
    folder = scan(tmp_path / "scan", PLACES[:4], (a_fringe,) * 4, texture=0.0, specks=0.2)
    with pytest.raises(AnnulusError, match=r'the plate stands about 83\.\d+ mm away, the calibration\'s "distance_mm"'):
        reconstruct_fringe(open_fringe(folder, calibration(tmp_path)))


@pytest.mark.deep(gate="tests/wings/fringe/test_reconstruct.py::test_another_slide_is_no_height")
def test_two_cameras_need_no_calibrated_slide(tmp_path: Path) -> None:
    """Phase a third of a wave off, period 3 %, the light 1 mm aside: no matter."""
    folder = scan(tmp_path / "scan", texture=0.0, specks=0.2)
    head = calibration(tmp_path, **slide(phase0=SLIDE.phase0 + 2.0, period=SLIDE.period * 1.03, centre_mm=[21.0, 0, 0]))
    plate = reconstruct_fringe(open_fringe(folder, head, "cameras"))
    assert plate.by == "cameras"
    assert plate.completeness > 0.9
    measured_mm = plate.height_mm[np.isfinite(plate.height_mm)]
    assert np.median(measured_mm) == pytest.approx(1.0, abs=0.02)
    off = (measured_mm - 1.0) / plate.sigma_mm[np.isfinite(plate.height_mm)]
    assert np.mean(np.abs(off) < 2) > 0.9
    summary = write_plate(plate, ScanAccount("a scan", {"projector": 16}, {}, plate.timing_ms), tmp_path / "out")
    assert summary["by"] == "cameras"
    assert "By two cameras" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.deep(gate="tests/wings/fringe/test_reconstruct.py::test_a_motion_told_too_long_is_said")
def test_by_cameras_a_long_scan_goes_in_windows_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WINDOW", 6)
    folder = scan(tmp_path / "scan", tuple(np.arange(14) * 1.1), texture=0.0, specks=0.2)
    plate = reconstruct_fringe(open_fringe(folder, calibration(tmp_path), "cameras"))
    inner = plate.height_mm[:, (plate.x_mm > 5) & (plate.x_mm < 35)]
    assert np.isfinite(inner).mean() > 0.9
    assert np.nanmedian(np.abs(inner - 1.0)) < 0.1


def test_by_cameras_a_wall_without_texture_is_refused(tmp_path: Path) -> None:
    folder = scan(tmp_path / "scan", PLACES[:4], texture=0.0)
    with pytest.raises(AnnulusError, match="its cameras see no texture in common between -5 and 5 mm"):
        reconstruct_fringe(open_fringe(folder, calibration(tmp_path), "cameras"))


def test_what_cannot_be_measured_by_cameras_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, path = scan(tmp_path / "scan", PLACES[:4]), calibration(tmp_path)
    data = json.loads(path.read_text())

    def refusal(**changes: Any) -> str:
        path.write_text(json.dumps({**data, **changes}))
        given = ["--calibration", str(path), "--by", "cameras", "-o", str(tmp_path / "out")]
        monkeypatch.setattr("sys.argv", ["annulus", "reconstruct", str(folder), *given])
        with pytest.raises(SystemExit) as left:
            main()
        printed = capsys.readouterr().err
        assert left.value.code == 1
        assert printed.count("\n") == 1
        return printed

    assert "has 1 camera, expected two" in refusal(cameras=data["cameras"][:1])
    assert 'no "pattern.projector", expected the slide as it was designed' in refusal(pattern={"kind": "fringe"})
    rings = {"kind": "rings", "centre_mm": [0, 0, 0], "rotation": np.eye(3).tolist(), "period_mm": 8}
    pipe = {"kind": "fringe", "projector": {**rings, "nominal_radius_mm": 100}}
    assert "its head lights a pipe, expected" in refusal(pattern=pipe)
    assert "its head projects no fringes, expected a head that projects fringes" in refusal(pattern={"kind": "lines"})
    monkeypatch.setattr("sys.argv", ["annulus", "reconstruct", str(folder), "--by", "cameras", "-o", "out"])
    with pytest.raises(SystemExit):
        main()
    assert "does not go without --calibration" in capsys.readouterr().err
    path.write_text(json.dumps(data))
    with pytest.raises(AnnulusError, match="fewer than 3 flashes have a frame of both cameras"):
        open_fringe(scan(tmp_path / "one", PLACES[:4], heads=(LEFT,)), path, "cameras")


def test_a_motion_told_too_long_is_said(tmp_path: Path) -> None:
    folder = scan(tmp_path / "scan", np.arange(10) * 1.3, texture=0.0, specks=0.2, heads=(LEFT,))
    text = (folder / "frames.csv").read_text().splitlines()
    rows = [line.rsplit(",", 1) for line in text[1:]]
    reported = [text[0], *(f"{head},{1.05 * float(x)}" for head, x in rows)]
    (folder / "frames.csv").write_text("\n".join(reported) + "\n")
    plate = reconstruct_fringe(open_fringe(folder, calibration(tmp_path)))
    remarks = [one.text for one in plate.findings if one.kind == "stretched"]
    assert len(remarks) == 1
    assert float(remarks[0].split("went about ")[1].split()[0]) == pytest.approx(1 / 1.05, abs=0.01)


def turned(one: HeadCamera, deg: float) -> list[dict[str, Any]]:
    """Sections of two cameras, the other one told turned about its y."""
    c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return [
        {
            "id": own.id,
            **camera_to_dict(own.camera),
            "rotation": (turn if own is one else np.eye(3)).tolist(),
            "translation_mm": (turn @ own.translation_mm if own is one else np.array(own.translation_mm)).tolist(),
        }
        for own in (LEFT, RIGHT)
    ]


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Plate]:
    """A scan, and its plate by a calibration that is right."""
    folder = tmp_path_factory.mktemp("right")
    path = scan(folder / "scan")
    return path, reconstruct_fringe(open_fringe(path, calibration(folder)))


def test_sigma_has_what_the_slides_own_calibration_left(right: tuple[Path, Plate], tmp_path: Path) -> None:
    path, known = right
    plate = reconstruct_fringe(
        open_fringe(path, calibration(tmp_path, pattern={**slide()["pattern"], "rms_rad": 0.05}))
    )
    grown = np.sqrt(plate.sigma_mm**2 - known.sigma_mm**2)
    rate_mm = 0.05 / grown[np.isfinite(grown) & (grown > 0)]  # radians a mm of height
    assert 0.2 < np.median(rate_mm) < 5.0
    assert np.percentile(rate_mm, 95) < 3.0 * np.percentile(rate_mm, 5)
    moved = np.abs(plate.height_mm - known.height_mm)  # of two cameras, as each is weighed
    assert np.nanmedian(moved) < 0.1 * np.nanmedian(plate.sigma_mm)


@pytest.mark.deep(gate="tests/wings/fringe/test_reconstruct.py::test_a_curve_that_nobody_told_is_found_by_the_wave")
def test_cameras_that_agree_are_not_accused(right: tuple[Path, Plate]) -> None:
    assert not [one for one in right[1].findings if one.kind == "cameras-apart"]


@pytest.mark.deep(gate="tests/wings/fringe/test_reconstruct.py::test_a_curve_that_nobody_told_is_found_by_the_wave")
@pytest.mark.parametrize(
    "changes", [slide(phase0=SLIDE.phase0 + 0.3), {"cameras": turned(RIGHT, 0.2)}], ids=["slide", "camera"]
)
def test_cameras_that_differ_are_said_and_sigma_has_it(
    right: tuple[Path, Plate], changes: dict[str, Any], tmp_path: Path
) -> None:
    path, true = right
    plate = reconstruct_fringe(open_fringe(path, calibration(tmp_path, **changes)))
    remarks = [one.text for one in plate.findings if one.kind == "cameras-apart"]
    assert len(remarks) == 1
    times = float(remarks[0].split("differ by ")[1].split()[0])
    assert times > 3
    assert np.nanmedian(plate.sigma_mm) > 0.9 * times * np.nanmedian(true.sigma_mm)
    off = np.abs(plate.height_mm - 1.0)[np.isfinite(plate.height_mm)]
    assert np.median(off) > 0.5  # wrong, by far more than the sigma of frames alone
    assert np.mean(off < 2 * plate.sigma_mm[np.isfinite(plate.height_mm)]) > 0.9


def test_another_slide_is_no_height(tmp_path: Path) -> None:
    other = {**projector_to_dict(SLIDE), "period": 0.05}
    job = open_fringe(
        scan(tmp_path / "scan", heads=(LEFT,)), calibration(tmp_path, pattern={"kind": "fringe", "projector": other})
    )
    with pytest.raises(AnnulusError, match="do not show the calibration's slide"):
        reconstruct_fringe(job)


@pytest.mark.deep(gate="tests/wings/fringe/test_reconstruct.py::test_a_curve_that_nobody_told_is_found_by_the_wave")
def test_saturated_frames_are_said_and_not_told(tmp_path: Path) -> None:
    plate = reconstruct_fringe(open_fringe(scan(tmp_path / "scan", gain=1.7), calibration(tmp_path)))
    assert any(finding.kind == "saturated" for finding in plate.findings)
    measured = np.isfinite(plate.height_mm)
    assert np.abs(np.median(plate.height_mm[measured]) - 1.0) < 0.1


def test_a_curve_that_nobody_told_is_found_by_the_wave(tmp_path: Path) -> None:
    folder = scan(tmp_path / "scan", heads=(LEFT,))
    for file in folder.glob("*.png"):
        share = cv2.imread(str(file)).astype(float) / 255
        srgb = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)
        cv2.imwrite(str(file), (255 * srgb).round().astype(np.uint8))
    job = open_fringe(folder, calibration(tmp_path, transfer={"another": {"sensor": "linear"}}))
    assert job.curve is None
    plate = reconstruct_fringe(job)
    assert any("taken as srgb" in one.text for one in plate.findings)
    assert np.nanmedian(plate.height_mm) == pytest.approx(1.0, abs=0.02)


def test_a_missing_camera_is_said(tmp_path: Path) -> None:
    job = open_fringe(scan(tmp_path / "scan", heads=(RIGHT,)), calibration(tmp_path))
    assert [one.text for one in job.findings] == ["camera 0 has no frame of 8 of 8 flashes: measured without it there"]
    assert reconstruct_fringe(job).points > 1000


@pytest.mark.deep(gate="tests/wings/fringe/test_reconstruct.py::test_a_curve_that_nobody_told_is_found_by_the_wave")
def test_scans_and_calibrations_that_do_not_belong_together(tmp_path: Path) -> None:
    path = calibration(tmp_path)
    with pytest.raises(AnnulusError, match="has no x_mm"):
        open_fringe(scan(tmp_path / "a", column="z_mm", heads=(LEFT,)), path)
    with pytest.raises(AnnulusError, match="no pipe's"):
        open_job(scan(tmp_path / "b", heads=(LEFT,)), path)
    with pytest.raises(AnnulusError, match="has no height_mm"):
        calibrate_fringe(scan(tmp_path / "c", heads=(LEFT,)), path)
    alone = json.loads(path.read_text())
    alone["cameras"] = alone["cameras"][:1]
    path.write_text(json.dumps(alone))
    with pytest.raises(AnnulusError, match="knows camera 0, not camera 1 of the scan"):
        open_fringe(scan(tmp_path / "d", heads=(RIGHT,)), path)


def test_a_pipes_fringes_are_still_a_calibration(tmp_path: Path) -> None:
    data = json.loads(calibration(tmp_path, pipe={"radius_mm": 101.6}).read_text())
    assert Calibration.from_dict(data).kind == "fringe"
