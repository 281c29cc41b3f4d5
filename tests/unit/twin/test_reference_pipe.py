"""Reference pipes and spools of the simulated head: what the same head, as it is calibrated, reads of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.drift import drifted, seen_with
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.twin.reference_pipe import PE_PER_K, at_temperature, of_diameter, optics_at, with_spool
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World, clean_world, every_world
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.scale import find_scale
from annulus_pipe.wall.survey import Survey, survey

HEAD_MM = 152.4
CLEAN = clean_world().scaled(832)
KNOWN = CLEAN.calibration()
HEADER = "name,kind,z_mm,clock_deg,depth_mm,length_mm,width_mm\n"
POCKET = "A1,loss,200,90,3,30,25\n"


def surveyed(world: World, stations: np.ndarray, known: Calibration = KNOWN) -> Survey:
    renderer, reconstructor = Renderer(world), Reconstructor(known)
    profiles, last = [], None
    for i, z in enumerate(stations):
        image = np.ascontiguousarray(to_bgr(renderer.render(world.pose(z), float(z), 1.0, seed=i), "bayer_rggb8"))
        profiles.append(reconstructor.profile(image, frame=i, z_mm=float(z), seed=last))
        last = profiles[-1].pose
    return survey(profiles, known, scale=find_scale(profiles, known))


def diameter(seen: Survey) -> tuple[float, float]:
    """mm: median over the stations, and k = 2."""
    return float(np.nanmedian(seen.stations.diameter_mean_mm)), float(np.nanmedian(seen.stations.diameter_k2_mm))


def spool(folder: Path, *rows: str, header: str = HEADER) -> Path:
    path = folder / "spool.csv"
    path.write_text(header + "".join(row + "\n" * (not row.endswith("\n")) for row in rows), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "mm", [153.2, pytest.param(138.0, marks=pytest.mark.deep), pytest.param(167.0, marks=pytest.mark.deep)]
)
def test_a_pipe_of_another_diameter_reads_its_own(mm: float) -> None:
    read, k2 = diameter(surveyed(of_diameter(CLEAN, mm), np.arange(0.0, 60.0, 6.0)))
    assert abs(read - mm) < 0.08 < k2  # mm; a camera of half the pixels is 0.046 off at most


@pytest.mark.parametrize("celsius", [40.0, pytest.param(-5.0, marks=pytest.mark.deep)])
def test_warmth_does_to_a_reading_what_the_drift_of_optics_predicts(celsius: float) -> None:
    """Points of a head that has drifted, on the calibration of before, and the pipe's own growth, 0.5 mm at 20 K."""
    warm = at_temperature(CLEAN, celsius)
    grown = HEAD_MM * PE_PER_K * (celsius - 20.0)
    assert 2 * warm.radius_mm - HEAD_MM == pytest.approx(grown, rel=1e-9)
    tube = float(np.linalg.norm(KNOWN.rings[0].vertex_mm))
    around = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    ring = np.repeat(np.arange(5), len(around))
    ahead = np.array([warm.radius_mm / np.tan(c.half_angle) + c.vertex_mm[2] for c in KNOWN.rings])[ring]
    circle = warm.radius_mm * np.tile([np.sin(around), -np.cos(around)], 5)
    now = drifted(KNOWN, optics_at(celsius, tube))
    off = np.hypot(*seen_with(np.column_stack([*circle, ahead]), ring, now, KNOWN)[:, :2].T) - warm.radius_mm
    by_ring = [2 * float(np.median(off[ring == k])) for k in range(5)]
    read, k2 = diameter(surveyed(warm, np.arange(0.0, 60.0, 6.0)))
    assert min(by_ring) - 0.03 < read - 2 * warm.radius_mm < max(by_ring) + 0.03
    assert abs(read - 2 * warm.radius_mm) < k2


def test_a_pocket_of_a_spool_comes_out_as_it_was_machined(tmp_path: Path) -> None:
    world = with_spool(CLEAN, spool(tmp_path, POCKET), 40)
    (loss,) = (one for one in surveyed(world, np.arange(20.0, 132.0, 8.0)).defects if one.kind == "loss")
    assert abs(loss.depth_mm - 3.0) < loss.depth_k2_mm < 0.5
    assert abs(loss.z_mm - 200) < 4 and abs(loss.clock_deg - 90) < 2
    assert abs(np.radians(loss.arc_deg) * HEAD_MM / 2 - 25) < 8 and abs(loss.length_mm - 30) < 10


def test_a_head_that_is_warmed_by_nothing_is_the_same(tmp_path: Path) -> None:
    same = at_temperature(CLEAN, 20.0)
    assert same.radius_mm == CLEAN.radius_mm and same.camera == CLEAN.camera
    angles = [[c.half_angle for c in one.calibration().rings] for one in (same, CLEAN)]
    assert angles[0] == pytest.approx(angles[1], abs=1e-12)


def test_the_truth_of_a_spool_is_its_file(tmp_path: Path) -> None:
    path = spool(tmp_path, POCKET, '"B, round",bump,260,200,2,16,16', "A2,loss,200,180,1.5,20,40")
    truth = with_spool(replace(clean_world(), texture=True), path, 60).truth()
    rows = [(d["kind"], d["z_mm"], d["clock_deg"], d["depth_mm"], d["length_mm"]) for d in truth["defects"]]
    assert rows == [("loss", 200, 90, 3, 30), ("bump", 260, 200, 2, 16), ("loss", 200, 180, 1.5, 20)]
    assert np.radians([d["arc_deg"] for d in truth["defects"]]) * HEAD_MM / 2 == pytest.approx([25, 16, 40])
    assert truth["travel_mm"] == pytest.approx(268 + 20 - 84, abs=1)  # the outermost ring lands 84 mm ahead


@pytest.mark.parametrize(
    ("rows", "header", "why"),
    [
        ((), HEADER, "0 defects, expected 1 to 1000"),
        ((POCKET,), HEADER.replace("depth_mm", "depth"), "'depth' is no column of it: expected depth_mm"),
        ((POCKET,), HEADER.replace("depth_mm", "depth_in"), "'depth_in' is no column of it: expected depth_mm"),
        ((POCKET, "A2,loss,300,90,3,30,"), HEADER, "'A2': width_mm is not stated, expected a number in 1..6000"),
        ((POCKET, "A2,hole,300,90,3,30,25"), HEADER, "line 3: kind is 'hole', expected loss or bump"),
        (("A1,loss,200,90,11,30,25",), HEADER, "'A1': depth_mm is 11, expected a number in 0.01..10"),
        (("A1,loss,200,90,nan,30,25",), HEADER, "line 2: depth_mm is nan, expected a number"),
        (("A1,loss,9000,90,3,30,25",), HEADER, "'A1': z_mm is 9000, expected a number in 0..6000"),
        (("A1,bump,200,90,3,30,25",), HEADER, "a bump 30 mm long, 25 wide and 3 high, expected a round one"),
        (("A1,loss,170,90,3,30,25",), HEADER, "'A1' begins at 155 mm, expected 166 or beyond"),
        ((POCKET, "A2,loss,229,91,1,30,25"), HEADER, "'A1' and 'A2' overlap"),
        ((POCKET, "A2,loss,500,91,1,30,25"), HEADER, "40 frames; at least 58 do"),
    ],
)
def test_a_spool_that_cannot_be_drawn_is_one_line(tmp_path: Path, rows: tuple[str, ...], header: str, why: str) -> None:
    with pytest.raises(AnnulusError) as refused:
        with_spool(CLEAN, spool(tmp_path, *rows, header=header), 40)
    assert why in str(refused.value) and "spool.csv" in str(refused.value) and "\n" not in str(refused.value)


def test_what_no_reference_pipe_is_drawn_for_is_refused() -> None:
    with pytest.raises(AnnulusError, match=r"90 mm inside: expected 137\.2 to 167\.6, this head's is 152\.4"):
        of_diameter(CLEAN, 90.0)
    for celsius in (61.0, float("nan")):
        with pytest.raises(AnnulusError, match="expected -20 to 60"):
            at_temperature(CLEAN, celsius)
    for name in ("mirror-3inch", "stereo", "butt", "fringe"):
        with pytest.raises(AnnulusError, match="demo or clean"):
            at_temperature(every_world()[name](1), 30.0)
