"""Promises of a video made a scan folder: every frame at its place, what a decoder hides said, nothing half-written."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.scans.scan import open_scan
from annulus_pipe.scans.video import Chainage, Imported, import_video, read_chainage
from annulus_pipe.vocabulary import AnnulusError, Label

FRAMES, WIDTH, HEIGHT = 12, 64, 48


def picture(i: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> np.ndarray:
    """Smooth colours, and a bar as long as the frame's number."""
    noise = np.random.default_rng(i).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    image = cv2.GaussianBlur(noise, (0, 0), 3)
    image[:8] = (0, 0, 0)
    image[:8, : 4 * (i + 1)] = (255, 200, 90)
    return image


def made(path: Path, form: str = "FFV1", grey: bool = False) -> Path:
    code = cv2.VideoWriter.fourcc(*form)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, 25.0, (WIDTH, HEIGHT), isColor=not grey)
    for i in range(FRAMES):
        writer.write(picture(i)[..., 1] if grey else picture(i))
    writer.release()
    return path


def command(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    code = "from annulus_pipe.cli import main; main()"
    whole = [sys.executable, "-c", code, "record", "import", *arguments]
    return subprocess.run(whole, cwd=folder, capture_output=True, text=True)


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return made(tmp_path / "pull.mkv")


def test_a_video_becomes_a_scan_of_the_same_pictures(video: Path, tmp_path: Path) -> None:
    heard: list[tuple[str, int, int]] = []
    done = import_video(video, tmp_path / "scan", speed_mm_s=50.0, progress=lambda *bar: heard.append(bar))
    assert done == Imported(FRAMES, (0.0, 22.0), 0, 0)
    scan = open_scan(tmp_path / "scan")
    assert [frame.z_mm for frame in scan.frames] == [2.0 * i for i in range(FRAMES)]  # 50 mm/s at 25 a second
    assert {frame.label for frame in scan.frames} == {Label.PROJECTOR}
    for i in range(FRAMES):
        assert np.abs(scan.read(i).astype(int) - picture(i)).max() <= 4  # FFV1 loses nothing, YUV a little
    assert heard[-1][1:] == (FRAMES, FRAMES) and not list(tmp_path.glob(".*"))


def test_a_grey_video_is_kept_in_grey(tmp_path: Path) -> None:
    import_video(made(tmp_path / "grey.avi", grey=True), tmp_path / "scan", speed_mm_s=1.0)
    stored = cv2.imread(str(tmp_path / "scan/frames/000003.png"), cv2.IMREAD_UNCHANGED)
    assert stored.shape == (HEIGHT, WIDTH)
    assert np.abs(stored.astype(int) - picture(3)[..., 1]).max() <= 1


def test_a_range_and_a_stride_keep_the_frames_numbers(video: Path, tmp_path: Path) -> None:
    done = import_video(video, tmp_path / "scan", speed_mm_s=-50.0, fps=5.0, first=3, last=9, every=4)
    scan = open_scan(tmp_path / "scan")
    assert [(frame.index, frame.z_mm) for frame in scan.frames] == [(3, -30.0), (7, -70.0)] and done.frames == 2
    assert abs(scan.read(1).astype(int) - picture(7)).max() <= 4


@pytest.mark.parametrize(
    ("heading", "unit", "mm"),
    [
        ("chainage", "mm", 1),
        ("chainage_m", None, 1000),
        ("Chainage [ft]", "ft", 304.8),
        ("chainage", "in", 25.4),
        (" chainage (cm)", None, 10),
    ],
)
def test_places_come_from_a_table_even_between_its_rows(
    heading: str, unit: str | None, mm: float, video: Path, tmp_path: Path
) -> None:
    (tmp_path / "z.csv").write_text(f"\ufefftime,{heading},frame\n,1.5,2\n,2.5,4\n\n,2.0,8\n", encoding="utf-8")
    table = read_chainage(tmp_path / "z.csv", unit)
    done = import_video(video, tmp_path / "scan", chainage=table)
    places = {frame.index: frame.z_mm / mm for frame in open_scan(tmp_path / "scan").frames}
    assert places == pytest.approx({2: 1.5, 3: 2.0, 4: 2.5, 5: 2.375, 6: 2.25, 7: 2.125, 8: 2.0}, abs=1e-4)
    assert done.without_place == FRAMES - 7 and done.missing == 0  # none is placed beyond the table's ends


@pytest.mark.parametrize(
    ("text", "unit", "says"),
    [
        ("", None, "line 1 is ''"),
        ("frame,place\n1,2\n", None, "line 1 is 'frame,place', expected one column frame and one chainage"),
        ("frame,chainage,chainage_m\n1,2,3\n", None, "expected one column frame and one chainage"),
        ("frame,chainage_m\n1,2\n", "ft", "line 1: chainage_m is in m, but ft was asked for"),
        ("frame,chainage\n1,2\n", None, "line 1: chainage has no unit, expected one of mm, cm, m, in, ft"),
        ("frame,chainage\n", "m", "has no rows"),
        ("frame,chainage\n1,2\n1,3\n", "m", "line 3: frame 1 after 1, expected a rising order"),
        ("frame,chainage\n1.5,2\n", "m", "line 2: frame is '1.5', expected a whole number"),
        ("frame,chainage\n-1,2\n", "m", "line 2: frame is '-1', expected a whole number"),
        ("frame,chainage\n1,far\n", "m", "line 2: chainage is 'far', expected a number"),
        ("frame,chainage\n1,nan\n", "m", "line 2: chainage is 'nan'"),
        ("frame,chainage\n1,1e300\n", "m", "line 2: chainage is '1e300'"),
        ("frame,chainage\n1\n", "m", "line 2: 1 cell, expected 2 as line 1 has"),
        ('frame,chainage\n1,"2\n', "m", "line 2: unexpected end of data"),
        ("frame,chainage\n1,\udcff\n", "m", "not a text file"),
    ],
)
def test_a_table_that_is_none_is_one_line(text: str, unit: str | None, says: str, tmp_path: Path) -> None:
    (tmp_path / "z.csv").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(AnnulusError) as error:
        read_chainage(tmp_path / "z.csv", unit)
    assert says in str(error.value)


def test_a_table_of_other_frames_places_none(video: Path, tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match=f"reaches none of its {FRAMES} frames"):
        import_video(video, tmp_path / "scan", chainage=Chainage((100, 200), (0.0, 1.0)))
    assert not (tmp_path / "scan").exists()


@pytest.mark.parametrize("form", ["MJPG", "FFV1"])
def test_a_file_cut_short_gives_its_whole_frames_and_says_so(form: str, tmp_path: Path) -> None:
    whole = made(tmp_path / "whole.avi", form).read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: len(whole) * 8 // 10])
    done = import_video(tmp_path / "cut.avi", tmp_path / "scan", speed_mm_s=1.0)
    scan = open_scan(tmp_path / "scan")
    assert 3 <= done.frames == len(scan.frames) < FRAMES and done.missing > 0
    assert done.frames + done.missing == FRAMES - 1  # the last that was read may be half a picture, and is left out
    for i in range(done.frames):
        assert np.abs(scan.read(i)[20:].astype(int) - picture(i)[20:]).mean() < 6
    assert len(list((tmp_path / "scan/frames").iterdir())) == done.frames


def test_the_end_of_a_range_is_no_end_of_the_file(video: Path, tmp_path: Path) -> None:
    assert import_video(video, tmp_path / "scan", speed_mm_s=1.0, last=4) == Imported(5, (0.0, 0.16), 0, 0)


def test_pictures_of_another_size_are_not_scaled_in_silence(tmp_path: Path) -> None:
    sizes = [(64, 48)] * 3 + [(80, 60)] * 2
    frames = [cv2.imencode(".jpg", picture(i, size))[1].tobytes() for i, size in enumerate(sizes)]
    (tmp_path / "two.mjpeg").write_bytes(b"".join(frames))
    with pytest.raises(AnnulusError, match="frame 3 is 80x60, those before 64x48"):
        import_video(tmp_path / "two.mjpeg", tmp_path / "scan", speed_mm_s=1.0)
    (tmp_path / "one.mjpeg").write_bytes(b"".join(frames[:3]))
    assert import_video(tmp_path / "one.mjpeg", tmp_path / "scan", speed_mm_s=1.0).frames == 3


def test_what_is_no_video_is_one_line(video: Path, tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("no video at all\n" * 99)
    (tmp_path / "empty.avi").touch()
    cut = made(tmp_path / "whole.mp4", "mp4v").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(cut[: len(cut) // 2])  # an MP4 has its table of contents at the end
    os.mkfifo(tmp_path / "pipe.avi")
    bad = {
        "text.mp4": "not a video",
        "empty.avi": "not a video",
        "cut.mp4": "cut short",
        "pipe.avi": "not a file",
        "none.avi": "no such video",
        ".": "holds no pictures",
    }
    for name, says in bad.items():
        with pytest.raises(AnnulusError, match=says):
            import_video(tmp_path / name, tmp_path / "scan", speed_mm_s=1.0)
    with pytest.raises(AnnulusError, match=f"has {FRAMES} frames, expected some from frame 40 on"):
        import_video(video, tmp_path / "scan", speed_mm_s=1.0, first=40)
    assert not (tmp_path / "scan").exists() and not list(tmp_path.glob(".*"))
    ended = command("cut.mp4", "-o", "scan", "--speed", "1", folder=tmp_path)
    assert ended.returncode == 1
    assert (
        ended.stderr == "annulus: cut.mp4: not a video, or cut short before its table of contents.\n"
    )  # nobody else speaks


@pytest.mark.deep(gate="tests/unit/scans/test_video.py::test_what_is_no_video_is_one_line")
def test_the_command_says_what_it_made(tmp_path: Path) -> None:
    whole = made(tmp_path / "whole.avi", "MJPG").read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: len(whole) * 8 // 10])
    (tmp_path / "z.csv").write_text("frame,chainage\n0,0\n100,1\n")
    ended = command("cut.avi", "-o", "scan", "--chainage", "z.csv", "--unit", "m", "--json", folder=tmp_path)
    said = json.loads(ended.stdout)
    assert ended.returncode == 1 and said["z_mm"] == [0.0, 10.0 * (said["frames"] - 1)]
    assert f"cut.avi: ends {said['missing']} frames before it says" in ended.stderr
    for options in ([], ["--speed", "1", "--chainage", "z.csv"], ["--chainage", "z.csv", "--fps", "5"]):
        assert command("whole.avi", "-o", "other", *options, folder=tmp_path).returncode == 1
    assert not (tmp_path / "other").exists()


def test_a_video_without_a_frame_is_one_line(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(
        str(tmp_path / "none.avi"), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48)
    )
    writer.release()
    with pytest.raises(AnnulusError, match=r"none.avi: (not a video|has no frame)"):
        import_video(tmp_path / "none.avi", tmp_path / "scan", speed_mm_s=1.0)


def test_a_folder_that_holds_something_stays_as_it_was(video: Path, tmp_path: Path) -> None:
    (tmp_path / "scan").mkdir()
    (tmp_path / "scan/mine.txt").write_text("mine")
    with pytest.raises(AnnulusError, match="is not empty"):
        import_video(video, tmp_path / "scan", speed_mm_s=1.0)
    assert [path.name for path in (tmp_path / "scan").iterdir()] == ["mine.txt"]
    (tmp_path / "scan/mine.txt").unlink()
    assert import_video(video, tmp_path / "scan", speed_mm_s=1.0).frames == FRAMES


def test_places_must_be_known(video: Path, tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="either a table of chainage or a speed"):
        import_video(video, tmp_path / "scan")
    with pytest.raises(AnnulusError, match="frames 5 to 4 by 1, expected a range that rises"):
        import_video(video, tmp_path / "scan", speed_mm_s=1.0, first=5, last=4)
    with pytest.raises(AnnulusError, match="a speed of nan mm/s"):
        import_video(video, tmp_path / "scan", speed_mm_s=float("nan"))
