"""Where a sensor gives the head's roll, clock positions are the pipe's and not the head's."""

from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.reprocess.job import roll_filled
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.score import score_cloud
from annulus_pipe.twin.worlds import World, WorldFeature, clean_world
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.registration import register
from annulus_pipe.wall.texture import HeadPath


def test_a_head_turned_clockwise_sees_three_o_clock_where_its_own_up_is():
    up_in_the_image = np.array([[0.0, -50.0, 100.0]])
    there = Pose(roll=np.radians(90)).to_pipe(up_in_the_image)
    assert np.allclose(there, [[50.0, 0.0, 100.0]])  # x right: 3 o'clock


def test_a_pose_with_roll_goes_there_and_back():
    pose = Pose(0.1, -0.05, 3.0, -2.0, 0.7)
    points = np.random.default_rng(1).normal(0, 50, (20, 3))
    assert np.allclose(pose.to_pipe(pose.to_camera(points, 40.0), 40.0), points)


@pytest.fixture(scope="module")
def pocketed() -> World:
    world = clean_world(travel_mm=40.0).scaled(832)
    pocket = WorldFeature("pocket", z_mm=130.0, length_mm=90.0, depth_mm=3.0, clock_deg=80.0, arc_deg=30.0)
    return replace(world, features=(pocket,), roll_deg=25.0)


@pytest.fixture(scope="module")
def profiles(pocketed: World) -> list[Profile]:
    renderer, reconstructor = Renderer(pocketed), Reconstructor(pocketed.calibration())
    out = []
    for i, z in enumerate(np.linspace(0.0, 40.0, 5)):
        pose = pocketed.pose(z)
        assert pose.roll is not None
        image = to_bgr(renderer.render(pose, z, 1.0, seed=i), "bayer_rggb8")
        out.append(reconstructor.profile(image, frame=i, z_mm=z, roll_deg=float(np.degrees(pose.roll))))
    return out


@pytest.mark.deep(
    gate="tests/unit/rings/test_roll.py::test_a_head_turned_clockwise_sees_three_o_clock_where_its_own_up_is"
)
def test_a_pocket_is_at_its_own_clock_position_however_the_head_is_turned(pocketed, profiles):
    assert np.ptp([p.pose.roll for p in profiles]) > np.radians(20)
    for profile in profiles:
        score = score_cloud(pocketed, profile.points_mm, profile.ring)
        assert score.points > 3000 and score.rms_mm < 0.5 and score.gross_percent < 1.0
    as_if_unknown = replace(profiles[-1], points_mm=Pose(roll=-profiles[-1].pose.roll).to_pipe(profiles[-1].points_mm))
    assert score_cloud(pocketed, as_if_unknown.points_mm).gross_percent > 2.0


def test_registration_moves_a_rolled_head_the_right_way(profiles):
    lean, shift = np.radians(0.4), 0.6
    p = profiles[3]
    wrong = replace(p.pose, rx=p.pose.rx + lean, tx=p.pose.tx + shift)
    points = wrong.to_pipe(p.pose.to_camera(p.points_mm.astype(float), p.z_mm), p.z_mm)
    leaning = replace(p, pose=wrong, points_mm=points.astype(np.float32))
    mended = register([*profiles[:3], leaning, profiles[4]])[3].pose
    assert abs(mended.rx - p.pose.rx) < 0.25 * lean and abs(mended.tx - p.pose.tx) < 0.12 * shift
    assert mended.roll == p.pose.roll


def test_roll_travels_with_the_profile_and_the_texture(profiles):
    again = Profile.from_dict(profiles[2].to_dict())
    assert again.pose == profiles[2].pose and again.lean_sigma_deg == profiles[2].lean_sigma_deg
    between = HeadPath(profiles).at(5.0).roll
    assert profiles[0].pose.roll < between < profiles[1].pose.roll
    assert HeadPath([replace(p, pose=replace(p.pose, roll=None)) for p in profiles]).at(5.0).roll is None


def test_a_scan_folder_may_carry_the_roll(tmp_path):
    (tmp_path / "a.png").write_bytes(b"")
    table = tmp_path / "frames.csv"
    table.write_text(
        "index,file,light,z_mm,roll_deg\n0,a.png,projector,0,350\n1,a.png,led,1,\n2,a.png,projector,2,14\n"
    )
    scan = open_scan(tmp_path)
    assert [f.roll_deg for f in scan.frames] == [350.0, None, 14.0]
    assert [f.roll_deg for f in roll_filled(scan).frames] == pytest.approx([350.0, 362.0, 374.0])
    table.write_text("index,file,light,z_mm,roll_deg\n0,a.png,projector,0,steep\n")
    with pytest.raises(AnnulusError, match='line 2: roll_deg is "steep"'):
        open_scan(tmp_path)
    table.write_text("index,file,light,z_mm\n0,a.png,projector,0\n")
    assert roll_filled(open_scan(tmp_path)).frames[0].roll_deg is None
