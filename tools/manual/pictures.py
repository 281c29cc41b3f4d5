"""The gallery's pictures, made by the code they show when the manual is built, and again when that code has changed."""

import tempfile
from pathlib import Path

import cv2

from annulus_pipe.numeric.arrays import Image

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "build/manual-pictures"
MADE_OF = ("twin", "rings", "wall", "report", "reprocess", "geometry", "storage", "record", "scans")
WIDTH = 832


def make() -> None:
    """FOLDER, whole."""
    newest = max(file.stat().st_mtime for room in MADE_OF for file in (ROOT / "host/annulus_pipe" / room).rglob("*.py"))
    stamp = FOLDER / ".made"
    if not stamp.exists() or stamp.stat().st_mtime < newest:
        FOLDER.mkdir(parents=True, exist_ok=True)
        _frames()
        _results()
        stamp.touch()


def _frames() -> None:
    """What cameras see: one frame by each light, in three worlds."""
    from annulus_pipe.record.codec import to_bgr
    from annulus_pipe.twin.render import Renderer
    from annulus_pipe.twin.scan import world_named

    for name, z_mm in (("demo", 130.0), ("stereo", 60.0), ("mirror-3inch", 30.0), ("fringe-mirror", 30.0)):
        world = world_named(name, 7).scaled(WIDTH)
        renderer, pose = Renderer(world), world.pose(z_mm)
        lights = (("projector", 1.0, 0.0), ("led", 0.0, 1.0)) if name == "demo" else (("projector", 1.0, 0.0),)
        for light, projector, led in lights:
            image = to_bgr(renderer.render(pose, z_mm, projector, led, seed=1), "bayer_rggb8")
            _save(f"{name}-{light}", image)


def _results() -> None:
    """What comes out of the sample recording."""
    from annulus_pipe.report import ScanAccount, write
    from annulus_pipe.reprocess.engine import reprocess
    from annulus_pipe.reprocess.executors import Processes
    from annulus_pipe.reprocess.job import open_job
    from tools.sample.__main__ import write as write_sample

    with tempfile.TemporaryDirectory() as folder:
        write_sample(Path(folder))
        done = reprocess(open_job(Path(folder) / "scan.mcap"), Processes(None))
        write(
            done.survey(),
            ScanAccount("the sample", done.frames, done.drops, done.timing_ms, done.findings),
            Path(folder),
        )
        for name in ("unwrapped", "texture"):
            image = cv2.imread(str(Path(folder) / f"{name}.png"), cv2.IMREAD_COLOR)
            assert image is not None
            scale = min(1.0, 1400 / image.shape[1])
            _save(name, cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _save(name: str, image: Image) -> None:
    cv2.imwrite(str(FOLDER / f"{name}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 82])
