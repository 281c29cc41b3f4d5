"""imu.csv beside frames.csv: what it may say, what is not known, and one line for what is wrong."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from annulus_pipe.reprocess.job import turns_of
from annulus_pipe.scans.imu import Motion, read_motion
from annulus_pipe.scans.scan import Scan, open_scan
from annulus_pipe.vocabulary import AnnulusError

HEADER = "index,ax_g,ay_g,az_g,dtheta_x_deg,dtheta_y_deg,dtheta_z_deg\n"


def said(folder: Path, text: str, listed: range | list[int]) -> dict[int, Motion]:
    (folder / "imu.csv").write_text(text)
    return dict(read_motion(folder, listed))


def test_a_scan_carries_what_it_says_frame_by_frame(tmp_path: Path) -> None:
    (tmp_path / "0.png").write_bytes(b"")
    (tmp_path / "frames.csv").write_text("index,file,light,z_mm\n0,0.png,projector,0\n1,0.png,led,5\n2,0.png,led,9\n")
    assert [frame.motion for frame in open_scan(tmp_path).frames] == [None, None, None]
    (tmp_path / "imu.csv").write_text(HEADER + "0,0,-1,0,0,0,0\n1,0.02,-0.99,0.01,0.1,2.2,-0.3\n")
    scan: Scan = open_scan(tmp_path)
    assert scan.frames[1].motion == Motion(pytest.approx((0.1, 2.2, -0.3)), (0.02, -0.99, 0.01))
    assert scan.frames[2].motion == Motion()
    turns = turns_of(scan)
    assert turns[1] == pytest.approx((0.1, 2.2, -0.3))
    assert np.isnan(turns[2]).all()


def test_without_the_file_nothing_is_known(tmp_path: Path) -> None:
    assert read_motion(tmp_path, [0, 1]) == {}


def test_rows_of_frames_that_are_not_listed_count_towards_the_next(tmp_path: Path) -> None:
    found = said(tmp_path, "index,dtheta_x_deg,dtheta_y_deg,dtheta_z_deg\n0,0,0,0\n1,30,0,0\n2,0,40,0\n", [0, 2])
    both = Rotation.from_rotvec([30, 0, 0], degrees=True) * Rotation.from_rotvec([0, 40, 0], degrees=True)
    assert found[2].turned_deg == pytest.approx(tuple(both.as_rotvec(degrees=True)))
    assert found[2].gravity_g is None


def test_a_frame_without_a_row_or_with_empty_fields_is_not_known_and_the_next_one_is(tmp_path: Path) -> None:
    found = said(tmp_path, HEADER + "0,,,,0,0,0\n1,0,-1,0,1,,1\n3,0,-1,,0,2,0\n5,,,,0,3,0\n", [0, 1, 2, 3, 5])
    assert found[1] == Motion(None, (0.0, -1.0, 0.0))
    assert found[2] == Motion()
    assert found[3].turned_deg == pytest.approx((0.0, 2.0, 0.0))  # since frame 2, for there is one
    assert found[3].gravity_g is None
    assert found[5].turned_deg == pytest.approx((0.0, 3.0, 0.0))


def test_a_row_between_that_does_not_know_leaves_the_listed_one_unknown(tmp_path: Path) -> None:
    found = said(tmp_path, HEADER + "0,,,,0,0,0\n1,,,,,,\n2,,,,0,2,0\n", [0, 2])
    assert found[2].turned_deg is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "line 1: no column index, dtheta_x_deg"),
        ("index,dtheta_x_deg,dtheta_y_deg\n", "line 1: no column dtheta_z_deg"),
        (HEADER.replace("ax_g", "index"), "line 1: a column is there twice"),
        (HEADER + "0,0,0,0,0,0,0,0\n", "line 2: 8 cells, expected 7 as line 1 has"),
        (HEADER + "x,0,0,0,0,0,0\n", 'line 2: index is "x", expected a whole number'),
        (HEADER + "1,0,0,0,0,0,0\n1,0,0,0,0,0,0\n", "line 3: index 1 comes after 1, expected rising ones"),
        (HEADER + "0,0,0,0,0,far,0\n", 'line 2: dtheta_y_deg is "far", expected degrees within 180'),
        (HEADER + "0,0,0,0,0,nan,0\n", "line 2: dtheta_y_deg"),
        (HEADER + "0,0,0,0,0,181,0\n", "line 2: dtheta_y_deg"),
        (HEADER + "0,0,0,inf,0,0,0\n", 'line 2: az_g is "inf", expected g within 100'),
    ],
)
def test_bad_input_is_one_line_that_names_it(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(AnnulusError) as error:
        said(tmp_path, text, [0])
    assert f"imu.csv: {says}" in str(error.value)
    assert "\n" not in str(error.value)


def test_what_is_no_text_is_said(tmp_path: Path) -> None:
    (tmp_path / "imu.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(AnnulusError, match=r"imu\.csv: not a text file"):
        read_motion(tmp_path, [0])
