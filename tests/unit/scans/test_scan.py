import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.scans.scan import Scan, open_scan, read_image
from annulus_pipe.storage.calibration_file import load_calibration, save_calibration
from annulus_pipe.vocabulary import AnnulusError, Label

HEADER = "index,file,light,z_mm\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    scan = tmp_path / "scan"
    (scan / "frames").mkdir(parents=True)
    rng = np.random.default_rng(3)
    lines = [HEADER]
    for i, (light, kind) in enumerate([("projector", "jpg"), ("led", "png"), ("unknown", "jpg")]):
        image = cv2.GaussianBlur(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8), (0, 0), 2)
        cv2.imwrite(str(scan / f"frames/{i}.{kind}"), image)
        lines.append(f"{i},frames/{i}.{kind},{light},{2.5 * i}\n")
    (scan / "frames.csv").write_text("".join(lines))
    return scan


def test_a_scan_folder_opens_with_its_labels_and_places(folder: Path) -> None:
    scan: Scan = open_scan(folder)
    assert [frame.label for frame in scan.frames] == [Label.PROJECTOR, Label.LED, Label.UNKNOWN]
    assert [frame.z_mm for frame in scan.frames] == [0.0, 2.5, 5.0]
    assert scan.read(0).shape == scan.read(1).shape == (48, 64, 3)
    assert scan.calibration is None


def test_more_columns_and_a_byte_order_mark_do_no_harm(folder: Path) -> None:
    text = (folder / "frames.csv").read_text().replace("\n", ",x\n")
    (folder / "frames.csv").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert len(open_scan(folder).frames) == 3


def test_frames_of_one_flash_share_an_index(folder: Path) -> None:
    (folder / "frames.csv").write_text(
        "index,camera,file,light,z_mm\n0,0,frames/0.jpg,led,0\n0,7,frames/1.png,led,0\n1,,frames/2.jpg,led,1\n"
    )
    scan = open_scan(folder)
    assert [(frame.index, frame.camera) for frame in scan.frames] == [(0, 0), (0, 7), (1, 0)]
    assert scan.cameras == (0, 7)
    with pytest.raises(AnnulusError, match="has frames of cameras 0, 7, expected one"):
        scan.only()


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("0,7,frames/0.jpg,led,0", "line 3: index 0 of camera 7 was there before"),
        ("1,left,frames/0.jpg,led,0", 'line 3: camera is "left", expected a whole number'),
        ("1,256,frames/0.jpg,led,0", "line 3: camera is 256, expected an id in 0..255"),
    ],
)
def test_a_camera_that_is_none_is_named(folder: Path, row: str, says: str) -> None:
    (folder / "frames.csv").write_text(f"index,camera,file,light,z_mm\n0,7,frames/1.png,led,0\n{row}\n")
    with pytest.raises(AnnulusError) as error:
        open_scan(folder)
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("x,frames/0.jpg,projector,0", 'line 5: index is "x"'),
        ("-1,frames/0.jpg,projector,0", "line 5: index"),
        ("3,frames/0.jpg,laser,0", 'line 5: light is "laser", expected projector, led or unknown'),
        ("3,frames/0.jpg,projector,far", 'line 5: z_mm is "far"'),
        ("3,frames/0.jpg,projector,nan", "line 5: z_mm"),
        ("3,frames/0.jpg,projector,inf", "line 5: z_mm"),
        ("3,frames/0.jpg,projector", "line 5: 3 cells, expected 4 as line 1 has"),
        ("3,,projector,0", "line 5: file"),
        ("3,../../secret.jpg,projector,0", "line 5: file"),
        ("3,/etc/passwd,projector,0", "line 5: file"),
        ("3,frames/9.jpg,projector,0", "line 5: frames/9.jpg is not there"),
        ("2,frames/0.jpg,projector,0", "line 5: index 2 was there before"),
        ('3,"frames/0.jpg,projector,0', "line 5"),
    ],
)
def test_a_bad_row_is_named_by_its_line(folder: Path, row: str, says: str) -> None:
    with (folder / "frames.csv").open("a") as table:
        table.write(row + "\n")
    with pytest.raises(AnnulusError) as error:
        open_scan(folder)
    assert says in str(error.value) and "frames.csv" in str(error.value) and "\n" not in str(error.value)


def _empty(folder: Path) -> Path:
    (folder.parent / "nothing").mkdir()
    return folder.parent / "nothing"


def _no_table(folder: Path) -> Path:
    (folder / "frames.csv").unlink()
    return folder


def _header_only(folder: Path) -> Path:
    (folder / "frames.csv").write_text(HEADER)
    return folder


def _no_column(folder: Path) -> Path:
    (folder / "frames.csv").write_text("index,file,z_mm\n0,a,0\n")
    return folder


def _binary(folder: Path) -> Path:
    (folder / "frames.csv").write_bytes(b"\xff\xfe\x00index\x80")
    return folder


def _a_file(folder: Path) -> Path:
    return folder / "frames/0.jpg"


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda folder: folder / "missing", "no such scan"),
        (_empty, "the folder is empty"),
        (_no_table, "not a scan"),
        (_header_only, "lists no frames"),
        (_no_column, "line 1: no column light"),
        (_binary, "not a text file"),
        (_a_file, "not a scan"),
    ],
)
def test_what_is_no_scan_is_one_clear_line(folder: Path, make: Callable[[Path], Path], says: str) -> None:
    with pytest.raises(AnnulusError, match=says):
        open_scan(make(folder))


def test_an_unreadable_folder_is_one_clear_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_args: object, **_named: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("annulus_pipe.scans.scan.read_whole", refuse)
    with pytest.raises(AnnulusError, match="Permission denied"):
        open_scan(folder)


@pytest.mark.parametrize("name", ["0.jpg", "1.png"])
@pytest.mark.parametrize("part", [0.0, 0.02, 0.3, 0.7, 0.999])
def test_a_truncated_frame_is_never_filled_with_grey(folder: Path, name: str, part: float) -> None:
    path = folder / "frames" / name
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(AnnulusError, match=name):
        read_image(path)


def test_a_thumbnails_end_does_not_pass_for_the_images(folder: Path) -> None:
    path = folder / "frames/0.jpg"
    data = path.read_bytes()
    thumbnail = b"\xff\xe1" + (2 + len(data)).to_bytes(2, "big") + data
    whole = data[:2] + thumbnail + data[2:]
    path.write_bytes(whole)
    assert read_image(path).shape == (48, 64, 3)
    path.write_bytes(whole[:-200])
    with pytest.raises(AnnulusError, match="truncated"):
        read_image(path)


def test_a_png_with_a_flipped_bit_is_refused(folder: Path) -> None:
    path = folder / "frames/1.png"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(AnnulusError, match="damaged"):
        read_image(path)


CALIBRATION = Calibration(
    Camera("pinhole", 64, 48, 20.0, 20.0, 31.5, 23.5),
    "RGB",
    (Cone(0.3, (0.0, 0.0, 1.0), (0.0, 0.0, -50.0)), Cone(0.4, (0.0, 0.0, 1.0), (0.0, 0.0, -50.0))),
    76.2,
)


def test_a_calibration_survives_the_disk(tmp_path: Path) -> None:
    save_calibration(tmp_path / "c.json", CALIBRATION)
    again = load_calibration(tmp_path / "c.json")
    assert again.camera == CALIBRATION.camera and again.colours == "RGB"
    assert [c.half_angle for c in again.rings] == pytest.approx([0.3, 0.4])
    assert [path.name for path in tmp_path.iterdir()] == ["c.json"]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (None, "no such file"),
        (b"", "not JSON"),
        (b"{", "line 1"),
        (b"\xff\xd8\xff\xe0\x80", "not a text file"),
        (b"[]", "must be an object"),
        (b"{}", '"format"'),
        (json.dumps(CALIBRATION.to_dict() | {"pipe": {}}).encode(), "radius_mm"),
        (json.dumps(CALIBRATION.to_dict()).encode()[:-40], "not JSON"),
        (b"[" * 100_000, "c.json"),
    ],
)
def test_a_bad_calibration_is_one_clear_line(tmp_path: Path, content: bytes | None, says: str) -> None:
    path = tmp_path / "c.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(AnnulusError) as error:
        load_calibration(path)
    assert says in str(error.value) and "c.json" in str(error.value) and "\n" not in str(error.value)


def test_a_folder_is_no_calibration(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="is a folder"):
        load_calibration(tmp_path)
