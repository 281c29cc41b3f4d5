import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, RADIUS_MM, SHADOW_RATIO, bump, oval, pocket, round_pipe, scan

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.defects import Defect, Detection, Kind, clock_face, find_defects
from annulus_pipe.wall.grid import Wall, build_wall
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.stations import f1216, measure_stations
from annulus_pipe.wall.texture import HeadPath, LedFrame, paint


def defects_of(wall: Wall) -> tuple[Defect, ...]:
    return find_defects(wall, shadow_ratio=SHADOW_RATIO).defects


def only(wall: Wall) -> Defect:
    found = defects_of(wall)
    assert len(found) == 1, found
    return found[0]


@pytest.fixture(scope="module")
def sound() -> Wall:
    return build_wall(scan(round_pipe, gross=0.001))


def test_a_sound_pipe_has_its_diameter_and_no_defects(sound: Wall) -> None:
    assert defects_of(sound) == ()
    stations = measure_stations(sound)
    assert np.nanmax(np.abs(stations.diameter_mean_mm - 2 * RADIUS_MM)) < 0.02
    assert np.nanmax(stations.ovality_percent) < 0.15
    assert np.nanmax(stations.shape_ovality_percent) < 0.015


def test_ovality_is_the_named_one_of_the_printed_diameters(sound: Wall) -> None:
    s = measure_stations(sound)
    departure = np.maximum(s.diameter_max_mm - s.diameter_mean_mm, s.diameter_mean_mm - s.diameter_min_mm)
    assert np.allclose(s.ovality_percent, 100 * departure / s.diameter_mean_mm)
    assert f1216(np.array([103.0]), np.array([98.0]), np.array([100.0])) == pytest.approx([3.0])


def test_what_nobody_saw_stays_unseen(sound: Wall) -> None:
    rod = np.abs(sound.clock_deg - 107.0) < 3.0
    assert not sound.seen[:, rod].any()
    assert sound.seen[:, ~rod].mean() > 0.9


def test_wild_points_neither_make_a_defect_nor_move_the_wall() -> None:
    wall = build_wall(scan(round_pipe, gross=0.02))
    assert defects_of(wall) == ()
    assert np.nanpercentile(np.abs(wall.residual_mm()), 99.9) < 0.6


def test_three_defects_at_once_come_out_where_they_are() -> None:
    pipe = pocket(bump(pocket(round_pipe, 90, 12, 130, 165, 5.0), 190, 150, 12.65, 4.0), 280, 55, 182, 192, 2.0)
    a, b, c = defects_of(build_wall(scan(pipe, gross=0.001)))
    for found, kind, z, clock, depth in (
        (a, Kind.LOSS, 147.5, 90, 5.0),
        (b, Kind.BUMP, 150, 190, 4.0),
        (c, Kind.LOSS, 187, 280, 2.0),
    ):
        assert found.kind is kind
        assert abs(found.z_mm - z) < 1.5 and abs(found.clock_deg - clock) < 4
        assert abs(found.depth_mm - depth) < 0.3
    assert abs(a.length_mm - 35) < 2.5, "the floor hidden behind the near rim belongs to the loss"


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("clock", "half", "z0", "z1", "depth"),
    [(0, 12, 150, 170, 1.5), (200, 5, 140, 147, 1.0), (45, 20, 150, 190, 0.6), (300, 80, 150, 175, 1.0)],
)
def test_a_pocket_of_any_size_and_place_is_one_loss(
    seed: int, clock: float, half: float, z0: float, z1: float, depth: float
) -> None:
    found = only(build_wall(scan(pocket(round_pipe, clock, half, z0, z1, depth), seed=seed)))
    assert found.kind is Kind.LOSS
    assert abs(found.z_mm - (z0 + z1) / 2) < 1.5
    assert abs((found.clock_deg - clock + 180) % 360 - 180) < 4
    assert found.depth_mm == pytest.approx(depth, abs=0.06)


def test_a_loss_cut_by_a_rods_shadow_is_one_loss() -> None:
    found = only(build_wall(scan(pocket(round_pipe, 107, 15, 150, 180, 2.0))))
    assert abs(found.clock_deg - 107) < 1.5 and abs(found.arc_deg - 30) < 2.5


@pytest.mark.deep(gate="tests/unit/wall/test_grid.py::test_two_bumps_whose_feet_touch_are_two_bumps")
def test_two_pockets_side_by_side_are_two_losses() -> None:
    pipe = pocket(pocket(round_pipe, 0, 8, 150, 170, 1.5), 25, 8, 150, 170, 3.0)
    found = sorted(defects_of(build_wall(scan(pipe))), key=lambda d: d.depth_mm)
    assert [d.kind for d in found] == [Kind.LOSS, Kind.LOSS]
    assert [d.depth_mm for d in found] == pytest.approx([1.5, 3.0], abs=0.05)


def test_two_bumps_whose_feet_touch_are_two_bumps() -> None:
    pipe = bump(bump(round_pipe, 180, 160, 14, 3.0), 200, 160, 14, 3.0)
    assert [d.kind for d in defects_of(build_wall(scan(pipe)))] == [Kind.BUMP, Kind.BUMP]


def test_a_groove_around_the_whole_pipe_is_a_loss_and_not_a_wider_pipe() -> None:
    found = only(build_wall(scan(pocket(round_pipe, 0, 181, 160, 180, 1.2))))
    assert found.kind is Kind.LOSS and found.arc_deg == 360 and found.clock_range == ("12:00", "12:00")
    assert found.depth_mm == pytest.approx(1.2, abs=0.045) and abs(found.z_mm - 170) < 1.5


def test_an_oval_pipe_is_one_ovality_and_hides_no_pocket() -> None:
    a, b = sorted(defects_of(build_wall(scan(pocket(oval(round_pipe, 30, 0.02), 200, 15, 150, 170, 1.0)))), key=str)
    loss, ovality = sorted((a, b), key=lambda d: d.kind)
    assert ovality.kind is Kind.OVALITY and loss.kind is Kind.LOSS
    assert ovality.depth_mm == pytest.approx(2 * 0.02 * RADIUS_MM, abs=0.01)
    assert ovality.clock_deg == pytest.approx(30, abs=0.06)
    assert loss.depth_mm == pytest.approx(1.0, abs=0.05)


def test_a_slightly_oval_pipe_is_not_listed() -> None:
    assert defects_of(build_wall(scan(oval(round_pipe, 30, 0.005)))) == ()


def test_an_oval_stretch_is_as_long_as_it_is() -> None:
    found = only(build_wall(scan(oval(round_pipe, 60, 0.03, 120, 220))))
    assert found.kind is Kind.OVALITY
    assert abs(found.z_mm - 170) < 1.5 and 75 < found.length_mm < 105


def test_noise_alone_lists_nothing_even_when_it_is_high() -> None:
    assert defects_of(build_wall(scan(round_pipe, noise=4.0))) == ()


def test_a_small_pocket_between_far_frames_is_found_by_the_rings_that_meet_it() -> None:
    found = only(build_wall(scan(pocket(round_pipe, 200, 8, 150, 158, 1.5), z_mm=[6.0 * i for i in range(20)])))
    assert found.kind is Kind.LOSS and abs(found.z_mm - 154) < 1.5 and abs(found.clock_deg - 200) < 1.5


def test_a_wall_is_known_less_well_where_only_the_noisiest_ring_looks(sound: Wall) -> None:
    alone, shared = sound.cell_noise_mm[-30:-10], sound.cell_noise_mm[100:160]
    assert np.median(alone[sound.seen[-30:-10]]) > 2 * np.median(shared)
    assert np.median(shared) < 0.04


def test_the_grid_does_not_depend_on_the_order_of_profiles() -> None:
    profiles = scan(round_pipe)
    one, other = build_wall(profiles), build_wall(profiles[::-1])
    assert np.array_equal(one.radius_mm, other.radius_mm, equal_nan=True)


def test_no_points_is_one_clear_line() -> None:
    none = np.zeros(0, np.uint8)
    nothing = Profile(0, 0.0, None, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), none, none.astype("u2"))
    for profiles in ([], [nothing]):
        with pytest.raises(AnnulusError, match="no wall"):
            build_wall(profiles)


def test_one_frame_alone_is_still_a_wall() -> None:
    wall = build_wall(scan(round_pipe, z_mm=[100.0]))
    assert defects_of(wall) == ()
    assert np.nanmax(np.abs(measure_stations(wall).diameter_mean_mm - 2 * RADIUS_MM)) < 0.1


@pytest.mark.parametrize(
    ("angle", "face"),
    [(0, "12:00"), (90, "3:00"), (359.9, "12:00"), (15, "12:30"), (285, "9:30"), (2.5, "12:05"), (-90, "9:00")],
)
def test_clock_positions_read_like_a_clock(angle: float, face: str) -> None:
    assert clock_face(angle) == face


def test_labels_point_at_the_defects_they_number() -> None:
    wall = build_wall(scan(pocket(pocket(round_pipe, 60, 10, 110, 130, 2.0), 200, 10, 180, 200, 2.0)))
    findings: Detection = find_defects(wall, shadow_ratio=SHADOW_RATIO)
    assert len(findings.defects) == 2
    for number, defect in enumerate(findings.defects, start=1):
        rows, columns = np.nonzero(findings.label == number)
        assert wall.z_mm[rows].mean() == pytest.approx(defect.z_mm, abs=0.15)
        assert wall.clock_deg[columns].mean() == pytest.approx(defect.clock_deg, abs=0.5)


def test_led_pose_lies_between_its_neighbours() -> None:
    profiles = scan(round_pipe, z_mm=[0.0, 10.0])
    moved = [Profile(p.frame, p.z_mm, Pose(tx=p.z_mm), p.points_mm, p.colour, p.ring, p.direction) for p in profiles]
    middle = HeadPath(moved).at(4.0)
    assert middle is not None and middle.tx == pytest.approx(4.0)
    assert HeadPath([]).at(4.0) is None


def test_texture_shows_a_stain_where_it_is(sound: Wall) -> None:
    camera = CALIBRATION.camera
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays(np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
    frames = []
    for index, z in enumerate([20.0, 60.0, 100.0]):
        rho = np.hypot(rays[:, 0], rays[:, 1])
        ahead = RADIUS_MM / np.maximum(rho, 1e-9) * rays[:, 2]
        clock = np.degrees(np.arctan2(rays[:, 0], -rays[:, 1])) % 360
        stain = (np.abs(clock - 250) < 12) & (np.abs(z + ahead - 170) < 12)
        light = 220 * np.clip(60 / np.maximum(ahead, 1), 0, 1) ** 1.5
        image = light[:, None] * np.where(stain[:, None], [0.1, 0.2, 1.0], [0.9, 0.9, 0.9])
        frames.append(LedFrame(index, z, image.reshape(camera.height, camera.width, 3).astype(np.uint8)))
    texture = paint(sound, Centreline([Piece(0.0, 76.2)]), CALIBRATION, scan(round_pipe, z_mm=[0.0, 110.0]), frames)
    assert texture is not None
    red = (texture[..., 0].astype(int) - texture[..., 2] > 60) & (texture[..., 3] > 0)
    rows, columns = np.nonzero(red)
    assert abs(sound.z_mm[rows].mean() - 170) < 0.07 and abs(sound.clock_deg[columns].mean() - 250) < 0.05
    plain = texture[(texture[..., 3] > 0) & ~red][:, :3]
    assert np.percentile(plain, 5) > 0.8 * np.percentile(plain, 95), "the light's fall-off along the pipe is evened out"
    assert paint(sound, Centreline([Piece(0.0, 76.2)]), CALIBRATION, [], frames) is None
