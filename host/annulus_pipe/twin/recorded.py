"""A recording made in virtual time, without a daemon: the same world gives the same bytes.

The firmware, the camera, its driver and the daemon's own labelling are those of a soak in which nothing goes wrong. The
head rests until its labels are proved, then the recording begins, with its evidence, and the winch pulls.
"""

import importlib.metadata
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from annulus_pipe.capture.photometry import Photometry, measure
from annulus_pipe.labelling.evidence import Row
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.twin.driver import PicturePart
from annulus_pipe.twin.emulated import VirtualBoard, open_board
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.pictures import WorldPictures
from annulus_pipe.twin.soak_world import SoakWorld, Waiting
from annulus_pipe.twin.worlds import World
from annulus_pipe.vocabulary import AnnulusError, Label

PROVED_WITHIN = 200  # frames
ROWS_A_NOTE = 100
BEGAN = datetime(2026, 1, 1, 12, 0, tzinfo=UTC)  # of a world that has no clock on the wall


class _Drawn(WorldPictures):
    """Every exposure's own picture, kept until it is recorded."""

    def __init__(self, world: World, seed: int) -> None:
        super().__init__(world, seed)
        self.drawn: dict[int, Image] = {}

    def measured(self, parts: tuple[PicturePart, ...]) -> Photometry:
        (part,) = parts  # nothing goes wrong: no picture is torn
        exposure, number = part.exposure, int(part.exposure.sequence)
        pose = self._world.pose(exposure.z_mm)
        image = self._renderer.render(pose, exposure.z_mm, exposure.projector, exposure.led, seed=number)
        self.drawn[number] = image
        return measure(image)


class _Scan(SoakWorld):
    """One pull of the head, after its labels are proved."""

    def __init__(self, world: World, frames: int, seed: int, board: VirtualBoard) -> None:
        super().__init__(PROVED_WITHIN + frames, seed, Faults(), board, frozenset(), world=world)
        self.pictures: _Drawn = _Drawn(self.world, seed)
        self.speed_mm_s = world.travel_mm / frames * self.timing.fps
        self.rows: list[Row] = []
        self.headers: list[tuple[FrameHeader, Image]] = []
        self.begun = False
        self.navigation.write_down(self.rows.append)

    def begin(self) -> None:
        self._pull(self.speed_mm_s)
        self.begun = True

    def _winch(self, number: int) -> None:
        pass

    def _label(self, one: Waiting) -> None:
        header = self.labelling.header(one.seen)
        image = self.pictures.drawn.pop(int(one.frame.parts[0].exposure.sequence))
        self.labels[header.label] += 1
        if self.begun:
            self.headers.append((header, image))


def write_recording(
    world: World,
    path: Path,
    frames: int,
    *,
    seed: int = 1,
    job: dict[str, str] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> None:
    """Pull the head through `world` in `frames` even steps into a new recording, with labels, evidence and calibration.

    Raises AnnulusError where labels cannot be proved, or the file cannot be written.
    """
    board = open_board("native")
    try:
        scan = _Scan(world, frames, seed, board)
        number = 0
        while not scan.labels[Label.LED] or not scan.labels[Label.PROJECTOR]:
            if number > PROVED_WITHIN:
                raise AnnulusError(f"{path}: labels are not proved after {number} frames: {dict(scan.reasons)}")
            scan.frame(number)
            number += 1
        scan.begin()
        while len(scan.headers) < frames:
            scan.frame(number)
            number += 1
            if progress is not None:
                progress("frames", len(scan.headers), frames)
    finally:
        board.close()
    _write(scan, path, scan.headers[:frames], job or {})


def _write(scan: _Scan, path: Path, headers: list[tuple[FrameHeader, Image]], job: dict[str, str]) -> None:
    world, timing = scan.world, scan.timing
    first_ns = headers[0][0].timestamp_ns
    width, height = world.camera.width, world.camera.height
    mode = {"kind": "twin", "fps": timing.fps, "exposure_us": timing.exposure_us, "readout_us": timing.readout_us}
    cameras = [{**mode, "encoding": headers[0][0].encoding, "gives": [width, height]}]
    identity = {"cameras": cameras, "job": job, "versions": {"annulus": importlib.metadata.version("annulus-pipe")}}
    with RecordingWriter(
        path,
        calibration=world.calibration().to_dict(),
        configuration={"job": job, "cameras": [mode]},
        now_ns=first_ns,
        clock=Clock(first_ns, round(BEGAN.timestamp()) * 1_000_000_000),
    ) as writer:
        utc = BEGAN.isoformat(timespec="milliseconds")
        writer.note("/identity", {"why": "start", "host_ns": first_ns, "utc": utc, **identity}, first_ns)
        for at in range(0, len(scan.rows), ROWS_A_NOTE):
            writer.note("/evidence", {"first": at, "rows": scan.rows[at : at + ROWS_A_NOTE]}, first_ns)
        for header, image in headers:
            writer.frame(header.to_dict(), image, header.timestamp_ns)
