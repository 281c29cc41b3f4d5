"""How a recording keeps its pictures: bytes, processor and what each way does to what is measured.

    python -m tools.bench speed codecs

Frames of the twin at 1664x1232, a mosaic of 2 MB each, four of the projector to one of the LED. What is measured in
them is held against the twin's own wall; where the ray-traced scene pipe-a is there, so is that: its frames are JPEGs
in colour, recorded as they are and as the mosaic that a sensor would have had of them.
"""

import functools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np
import zstandard
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import CompressionType
from mcap_protobuf.writer import Writer as McapWriter
from numpy.typing import NDArray

from annulus_pipe.daemon.recorder import RecorderJob
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.container import ZSTD_LEVEL
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.viewers import preview
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.report import ScanAccount, write
from annulus_pipe.reprocess.engine import reprocess
from annulus_pipe.reprocess.executors import Processes
from annulus_pipe.reprocess.job import open_job
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.score import score_cloud, score_defects
from annulus_pipe.twin.worlds import World, WorldFeature, clean_world
from annulus_pipe.vocabulary import Label
from tools.bench.table import SCENES, Row

FRAMES, FPS = 30, 25.0
CPU_MS = {Codec.RAW: 2.0, Codec.ZSTD: 5.0, Codec.JPEG: 20.0}  # a frame, on one core; at 25 fps there are 40
SHARE = {Codec.RAW: 5.0, Codec.ZSTD: 15.0, Codec.JPEG: 50.0}  # percent of a core, of the recorder, with its previews
OF_MCAP = 0.6  # of the processor of mcap's own writer at the same level; measured 0.52
WORSE_MM = 0.005  # of radius RMS, than what the same frames give as they are
MCAP_LEVEL = 3  # of zstd, which mcap's writer takes
PIPE_A = SCENES / "pipe-a"

Image = NDArray[np.uint8]
NOTE = (
    "CPU: of the recorder, writing to the file included, previews not. The radius error is of points away from "
    "edges; defects found of those that are there, and by how much the worst depth is off."
)


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame of a scan."""

    index: int
    label: Label
    z_mm: float
    image: Image
    encoding: str


def rows() -> list[Row]:
    world = _world()
    shots = list(_twin(world))
    out = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        errors: dict[Codec, float] = {}
        for codec in Codec:
            path = folder / f"{codec}.mcap"
            cost_ms, size = _record(path, shots, world.calibration().to_dict(), codec)
            done = reprocess(open_job(path), Processes(2))
            points = np.concatenate([profile.points_mm for profile in done.profiles])
            cloud = score_cloud(world, points)
            found = score_defects(world, [_plain(one) for one in done.survey().defects])
            depths = [abs(row["error"]["depth_mm"]) for row in found["rows"] if row["found"]]
            errors[codec] = cloud.rms_mm
            out += [
                Row(
                    f"{codec}: a frame",
                    "-",
                    f"<= {CPU_MS[codec]:g} ms",
                    f"{cost_ms:.1f} ms, {size / 1e3:.0f} kB",
                    cost_ms <= CPU_MS[codec],
                ),
                Row(
                    f"{codec}: an hour at {FPS:g} fps",
                    "-",
                    "-",
                    f"{size * FPS * 3600 / 1e9:.0f} GB, {size * FPS / 1e6:.1f} MB/s",
                ),
                Row(
                    f"{codec}: the twin's pipe",
                    "-",
                    f"<= raw + {WORSE_MM:g} mm",
                    f"{cloud.rms_mm:.4f} mm rms, "
                    f"{cloud.points} points, {found['found']} of {found['true']} defects, depths within "
                    f"{max(depths, default=np.nan):.3f} mm, {found['false']} false",
                    cloud.rms_mm <= errors[Codec.RAW] + WORSE_MM and found["missed"] == found["false"] == 0,
                ),
            ]
            path.unlink()
        out += [_of_recorder(folder, shots, codec) for codec in Codec]
        out.append(_of_preview(shots))
        out += [_beside_mcap(folder, shots, level) for level in (ZSTD_LEVEL, MCAP_LEVEL)]
        if PIPE_A.is_dir():
            out += _pipe_a(folder)
    return out


def _world() -> World:
    pockets = (
        WorldFeature("pocket", z_mm=110.0, length_mm=24.0, depth_mm=3.0, clock_deg=80.0, arc_deg=30.0),
        WorldFeature("pocket", z_mm=135.0, length_mm=14.0, depth_mm=1.0, clock_deg=250.0, arc_deg=40.0),
    )
    return replace(clean_world(travel_mm=90.0), features=pockets)


def _twin(world: World) -> Iterator[Shot]:
    renderer = Renderer(world)
    for i, z in enumerate(np.linspace(0.0, world.travel_mm, FRAMES)):
        label = Label.LED if i % 5 == 4 else Label.PROJECTOR
        lit = float(label is Label.PROJECTOR), float(label is Label.LED)
        yield Shot(i, label, float(z), renderer.render(world.pose(z), float(z), *lit, seed=i), "bayer_rggb8")


def _record(path: Path, shots: Sequence[Shot], calibration: dict[str, Any], codec: Codec) -> tuple[float, float]:
    """ms of processor and bytes, a frame."""
    cv2.setNumThreads(1)
    with RecordingWriter(
        path, calibration=calibration, configuration={}, now_ns=0, codec=codec, previews=False
    ) as writer:
        began, size = time.process_time(), writer.size
        for shot in shots:
            height, width = shot.image.shape[:2]
            header = FrameHeader(
                shot.index,
                None,
                shot.index * 10**7,
                shot.label,
                "",
                None,
                None,
                None,
                shot.z_mm,
                shot.encoding,
                width,
                height,
            )
            writer.frame(header.to_dict(), shot.image, header.timestamp_ns)
        return 1e3 * (time.process_time() - began) / len(shots), (writer.size - size) / len(shots)


def _of_recorder(folder: Path, shots: Sequence[Shot], codec: Codec) -> Row:
    """What the recorder does with a frame, one coming after the other at FPS."""
    job = RecorderJob(folder, f"recorder-{codec}", None, {}, codec=codec)
    began = time.process_time()
    for shot in shots:
        job._done_s = job._without_pause = 0  # there was a pause before it
        height, width = shot.image.shape[:2]
        stamp_ns = round(shot.index * 1e9 / FPS)
        job.frame(
            FrameHeader(
                shot.index, None, stamp_ns, shot.label, "", None, None, None, shot.z_mm, shot.encoding, width, height
            ),
            shot.image,
            None,
        )
    share = 100 * FPS * (time.process_time() - began) / len(shots)
    job.close()
    told = f"{share:.1f} % of a core"
    return Row(f"{codec}: the recorder, previews and all", "-", f"<= {SHARE[codec]:g} %", told, share <= SHARE[codec])


def _beside_mcap(folder: Path, shots: Sequence[Shot], level: int) -> Row:
    """The same messages by the writer of the mcap package, without our labels, in turn with ours at level 1."""
    ours, theirs = [], []
    for _ in range(3):
        own, other = folder / "ours.mcap", folder / "theirs.mcap"
        ours.append(_record(own, shots, {}, Codec.ZSTD))
        theirs.append(_by_mcap(other, shots, level))
        own.unlink()
    (own_ms, own_bytes), (other_ms, bytes_there) = min(ours), min(theirs)
    told = f"{own_ms:.1f} ms to {other_ms:.1f}, {own_ms / other_ms:.2f} of it; "
    told += f"{own_bytes / 1e3:.0f} kB to {bytes_there / 1e3:.0f}"
    what = f"zstd: a frame, beside mcap's own writer at zstd's level {level}"
    return Row(what, "-", f"<= {OF_MCAP:g} of it", told, own_ms <= OF_MCAP * other_ms)


def _by_mcap(path: Path, shots: Sequence[Shot], level: int) -> tuple[float, float]:
    """ms of processor and bytes, a frame."""
    packed = functools.partial(zstandard.compress, level=level)  # its writer takes no level
    with path.open("wb") as file, mock.patch("mcap.writer.zstandard.compress", packed):
        writer = McapWriter(file, compression=CompressionType.ZSTD)
        began = time.process_time()
        for shot in shots:
            height, width = shot.image.shape[:2]
            stamp_ns = shot.index * 10**7
            pixels = RawImage(width=width, height=height, encoding=shot.encoding, step=width, data=shot.image.tobytes())
            writer.write_message("/frame/0", pixels, stamp_ns, stamp_ns)
        cost_ms = 1e3 * (time.process_time() - began) / len(shots)
        writer.finish()
    return cost_ms, path.stat().st_size / len(shots)


def _of_preview(shots: Sequence[Shot]) -> Row:
    began = time.process_time()
    sizes = [len(preview(shot.image, shot.encoding)) for shot in shots]
    cost_ms = 1e3 * (time.process_time() - began) / len(shots)
    told = f"{cost_ms:.1f} ms, {np.mean(sizes) / 1e3:.0f} kB"
    return Row("preview of a mosaic, half the size", "-", "<= 5 ms", told, cost_ms <= 5.0)


def _pipe_a(folder: Path) -> list[Row]:
    scan = open_scan(PIPE_A)
    calibration = json.loads((PIPE_A / "calibration.json").read_text())
    given = [Shot(f.index, f.label, f.z_mm, scan.read(i), "bgr8") for i, f in enumerate(scan.frames)]
    mosaics = [replace(shot, image=_mosaic(shot.image), encoding="bayer_rggb8") for shot in given]
    out = []
    for what, shots in {"as given": given, "as a mosaic": mosaics}.items():
        plain = 0.0
        for codec in Codec:
            path, cloud = folder / "pipe-a.mcap", folder / "out"
            _, size = _record(path, shots, calibration, codec)
            if codec is Codec.ZSTD and _same(path, shots):
                told, ok = f"{size / 1e3:.0f} kB a frame; every pixel as recorded raw", True
            else:
                done = reprocess(open_job(path), Processes(2))
                write(done.survey(), ScanAccount("pipe-a", done.frames, done.drops, done.timing_ms), cloud)
                told, rms = _told(cloud / "cloud.ply")
                plain = rms if codec is Codec.RAW else plain
                told, ok = f"{size / 1e3:.0f} kB a frame; {told}", rms <= plain + WORSE_MM
            path.unlink()
            out.append(Row(f"pipe-a {what}, {codec}", "-", f"<= raw + {WORSE_MM:g} mm", told, ok))
    return out


def _same(path: Path, shots: Sequence[Shot]) -> bool:
    recording = open_recording(path)
    return all(
        np.array_equal(recording.read_raw(frame)[0], shot.image)
        for frame, shot in zip(recording.frames, shots, strict=True)
    )


def _mosaic(image: Image) -> Image:
    out = image[..., 1].copy()
    out[::2, ::2], out[1::2, 1::2] = image[::2, ::2, 2], image[1::2, 1::2, 0]
    return out


def _told(cloud: Path) -> tuple[str, float]:
    """What the scene's own score says, in words, and the error of the radius."""
    done = subprocess.run(
        [sys.executable, SCENES / "score.py", cloud, PIPE_A / "truth.json", "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    said = json.loads(done.stdout)
    off = max(abs(one["measured_mm"] - one["true_mm"]) for one in said["defects"])
    told = (
        f"{said['rms_mm']:.4f} mm rms, {100 * said['points_per_slit_direction']:.1f} % of all slits and directions, "
        f"{len(said['defects'])} defects within {off:.3f} mm"
    )
    return told, float(said["rms_mm"])


def _plain(defect: Any) -> dict[str, Any]:
    return {"kind": defect.kind, "z_mm": defect.z_mm, "clock_deg": defect.clock_deg, "depth_mm": defect.depth_mm}
