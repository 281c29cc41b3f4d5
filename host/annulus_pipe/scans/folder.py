"""A recording as a scan folder: a picture a frame, and a table of what lit it and where it was taken.

Mosaics are demosaiced, by what reconstruction does it with. Frames of which nobody knows the place are left out: a scan
folder has no word for them.
"""

import csv
import json
import math
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2

from annulus_pipe.numeric.arrays import Image
from annulus_pipe.record.codec import jpeg, to_bgr
from annulus_pipe.record.frames import RecordedFrame
from annulus_pipe.record.recording import Recording
from annulus_pipe.scans.scan import CAMERA, COLUMNS, ROLL, SLOT, TABLE
from annulus_pipe.vocabulary import AnnulusError

FORMS = ("png", "jpeg")


@dataclass(slots=True)
class Exported:
    """What became of a recording's frames."""

    frames: int = 0
    without_place: int = 0
    damaged: list[str] = field(default_factory=list)  # frames that could not be read, each a line


def export_folder(
    recording: Recording, folder: Path, form: str = "png", progress: Callable[[str, int, int], None] | None = None
) -> Exported:
    """Write a scan folder, which appears when it is whole. Raises AnnulusError, one line."""
    if form not in FORMS:
        raise AnnulusError(f"pictures as {form}: expected one of {', '.join(FORMS)}.")
    exported, rows = Exported(), []
    partial = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
            raise AnnulusError(f"{folder}: is not empty, expected a new folder for the scan.")
        (partial / "frames").mkdir(parents=True)
        for number, frame in enumerate(recording.frames):
            if progress is not None:
                progress("frames", number + 1, len(recording.frames))
            if not math.isfinite(frame.z_mm):
                exported.without_place += 1
                continue
            try:
                data = _picture(recording, frame, form)
            except AnnulusError as error:
                exported.damaged.append(str(error).removeprefix(f"{recording.path}: "))
                continue
            camera = f"-{frame.camera}" if frame.camera else ""
            name = f"frames/{frame.index:06d}{camera}.{'jpg' if form == 'jpeg' else form}"
            (partial / name).write_bytes(data)
            slot = recording.label(frame).get("slot")
            rows.append(
                (
                    frame.index,
                    name,
                    frame.label.value,
                    f"{frame.z_mm:.4f}",
                    frame.camera,
                    "" if frame.roll_deg is None else f"{frame.roll_deg:.5f}",
                    "" if slot is None else slot,
                )
            )
        if not rows:
            raise AnnulusError(f"{recording.path}: has no frame that can be read and whose place is known.")
        with (partial / TABLE).open("w", newline="") as file:
            csv.writer(file).writerows([(*COLUMNS, CAMERA, ROLL, SLOT), *rows])
        if recording.calibration is not None:
            (partial / "calibration.json").write_text(json.dumps(recording.calibration, indent=1) + "\n")
        partial.replace(folder)
    except OSError as error:
        raise AnnulusError(f"{folder}: cannot be written ({error.strerror}).") from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    exported.frames = len(rows)
    return exported


def _picture(recording: Recording, frame: RecordedFrame, form: str) -> bytes:
    if form == "jpeg" and frame.jpeg:
        return recording.read_jpeg(frame)
    image, encoding = recording.read_raw(frame)
    if form == "jpeg":
        return jpeg(image, encoding)
    whole: Image = image if encoding == "mono8" else to_bgr(image, encoding)
    return bytes(cv2.imencode(".png", whole, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].data)
