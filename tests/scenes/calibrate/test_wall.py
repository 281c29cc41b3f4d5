"""A drawn pipe of known radius says how far light goes on in its wall; the calibration then reads such walls right."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.calibrate.sample import sample
from annulus_pipe.calibrate.wall import measure_wall
from annulus_pipe.cli.app import app
from annulus_pipe.geometry.translucency import slit_shift_mm
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage.calibration_file import load_calibration, save_calibration
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.scan import write_scan
from annulus_pipe.twin.worlds import World, clean_world, translucent
from annulus_pipe.vocabulary import AnnulusError

R = 76.2
OPAQUE = clean_world(seed=5).scaled(832)
WORLD = translucent(OPAQUE)


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Callable[[World], Path]:
    drawn: dict[int, Path] = {}

    def drawn_scan(world: World) -> Path:
        if id(world) not in drawn:
            drawn[id(world)] = tmp_path_factory.mktemp("pipe") / "scan"
            write_scan(world, drawn[id(world)], 6)
        return drawn[id(world)]

    return drawn_scan


def _calibrate(scan: Path, calibration: Path, *more: str) -> tuple[int, str]:
    out = calibration.with_name("colour.json")
    run = CliRunner().invoke(
        app, ["calibrate", "colour", str(scan), "--calibration", str(calibration), *more, "-o", str(out)]
    )
    assert run.exception is None or isinstance(run.exception, SystemExit)
    assert out.is_file()  # colours were learnt whatever is known of the wall
    return run.exit_code, run.output


def _radius(world: World, calibration: Path) -> float:
    image = to_bgr(Renderer(world).render(world.pose(33.0), 33.0, 1.0, seed=99), "bayer_rggb8")
    profile = Reconstructor(load_calibration(calibration)).profile(image, frame=0, z_mm=33.0)
    return float(np.median(np.hypot(*profile.points_mm[:, :2].T)))


def test_what_was_measured_is_written_once_and_reads_another_frame_right(
    scan: Callable[[World], Path], tmp_path: Path
) -> None:
    path = tmp_path / "head.json"
    save_calibration(path, WORLD.calibration())
    assert _radius(WORLD, path) > R + 0.2
    code, said = _calibrate(scan(WORLD), path, "--reference-u", "0.02")
    assert code == 0 and "light leaves it red 0." in said and "section wall of" in said
    first = load_calibration(path)
    assert abs(_radius(WORLD, path) - R) < 0.03
    assert _calibrate(scan(WORLD), path, "--reference-u", "0.02")[0] == 0  # a wall that is known already does not count
    assert load_calibration(path) == first
    assert first.translucency_sigma_mm is not None and max(first.translucency_sigma_mm) < 0.05
    assert json.loads(path.read_text())["provenance"]["wall"]["by"] == "annulus calibrate colour"


def test_it_says_why_nothing_was_measured(scan: Callable[[World], Path], tmp_path: Path) -> None:
    path = tmp_path / "head.json"
    save_calibration(path, WORLD.calibration())
    before = path.read_bytes()
    code, said = _calibrate(scan(WORLD), path)
    assert code == 0 and "not measured: needs a pipe whose diameter is known, and --reference-u" in said
    assert path.read_bytes() == before


def test_an_opaque_wall_is_one_and_a_narrower_one_is_none(scan: Callable[[World], Path], tmp_path: Path) -> None:
    path = tmp_path / "head.json"
    save_calibration(path, OPAQUE.calibration())
    assert _calibrate(scan(OPAQUE), path, "--reference-u", "0.02")[0] == 0
    known = load_calibration(path)
    assert known.translucency_sigma_mm is not None
    assert max(known.translucency_mm) < 0.03 and max(known.translucency_sigma_mm) < 0.03
    data = json.loads(path.read_text())
    path.write_text(json.dumps({**data, "pipe": {"radius_mm": R + 0.3}}))
    before = path.read_bytes()
    code, said = _calibrate(scan(OPAQUE), path, "--reference-u", "0.02")
    assert code == 1 and "light would leave the wall -0.2" in said and "the optics drifted" in said
    assert path.read_bytes() == before


def test_the_references_own_uncertainty_is_in_it(scan: Callable[[World], Path]) -> None:
    """A diameter within 0.4 mm leaves 0.07 mm of each colour open: R m / d is what a radius reads wider."""
    known = WORLD.calibration()
    frames = list(sample(open_scan(scan(WORLD)), known.camera, 4))
    fine, coarse = (measure_wall(frames, known, u) for u in (0.0, 0.4))
    assert fine.shift_mm == coarse.shift_mm
    more = np.sqrt(np.square(coarse.sigma_mm) - np.square(fine.sigma_mm))
    assert more == pytest.approx(0.1 * 55.5 / R, rel=0.05)


def test_three_rings(scan: Callable[[World], Path]) -> None:
    """Rings that do not tell colours apart say their mean, and that each is known less well than that."""
    known = WORLD.calibration()
    frames = list(sample(open_scan(scan(WORLD)), known.camera, 4))
    every = measure_wall(frames, known, 0.0)
    frames = frames[:3]
    dark = [type(frame)(frame.index, frame.z_mm, frame.exposure, _without_inner(frame.image)) for frame in frames]
    some = measure_wall(dark, known, 0.0)
    slits = [slit_shift_mm(np.array(wall.shift_mm), known.colours)[3:] for wall in (every, some)]
    assert slits[0] == pytest.approx(slits[1], abs=0.03)
    assert max(some.sigma_mm) > 0.02


def _without_inner(image: np.ndarray) -> np.ndarray:
    out, (y, x) = image.copy(), np.indices(image.shape[:2])
    out[np.hypot(x - 415.5, y - 307.5) < 148] = 0
    return out


def test_one_frame_is_too_few(scan: Callable[[World], Path]) -> None:
    known = WORLD.calibration()
    frames = list(sample(open_scan(scan(WORLD)), known.camera, 2))
    with pytest.raises(AnnulusError, match="no ring was seen in 3 frames or more"):
        measure_wall(frames, known, 0.02)
