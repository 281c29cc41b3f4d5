"""Recordings made wrong: their records, their labels, their packed chunks."""

import io
import json
import struct
import zlib
from functools import cache
from pathlib import Path
from random import Random

import numpy as np
import zstandard

from annulus_pipe.record.codec import Codec
from annulus_pipe.record.frames import FRAME_TOPIC, LABEL_TOPIC
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.fuzz.found import Silent
from tools.bench.fuzz.mutate import HOSTILE, UNWRITABLE, as_json, of_bytes, of_values

FRAMES, H, W = 4, 24, 32


def _image(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 32, (H, W), dtype=np.uint8)


def _label(index: int) -> dict[str, object]:
    return {
        "index": index,
        "label": "led" if index % 5 == 4 else "projector",
        "reason": "",
        "z_mm": 2.5 * index,
        "encoding": "mono8",
        "width": W,
        "height": H,
        "roll_deg": 1.0,
    }


@cache
def _recording(codec: Codec) -> bytes:
    return _written([json.dumps(_label(index)).encode() for index in range(FRAMES)], codec)


def _written(labels: list[bytes], codec: Codec) -> bytes:
    path, kept = Path("/dev/null"), io.BytesIO()
    kept.close = lambda: None  # type: ignore[method-assign]
    file: object = kept
    with RecordingWriter(
        path,
        calibration={"a": 1},
        configuration={"fps": 25},
        now_ns=0,
        file=file,
        codec=codec,  # type: ignore[arg-type]
    ) as writer:
        for index, label in enumerate(labels):
            writer.note("/event", {"kind": "edge", "n": index}, index)
            writer.frame(_label(index), _image(index), index)
            if label != json.dumps(_label(index)).encode():
                writer._add(LABEL_TOPIC, label, index, index)
                writer._add(f"{FRAME_TOPIC}/0", label[:200], index, 90 + index, FRAME_TOPIC)
                writer.flush()
    return kept.getvalue()


def mcap_case(rng: Random) -> bytes:
    if rng.random() < 0.8:
        return b"B" + of_bytes(rng, _recording(Codec.RAW))
    labels = [as_json(rng, of_values(rng, _label(i), HOSTILE + UNWRITABLE)) for i in range(FRAMES)]
    return b"V" + _written(labels, rng.choice((Codec.RAW, Codec.ZSTD)))


def packed_case(rng: Random) -> bytes:
    """Packed chunks wrong in their bytes; or packed again after that, so that only what is inside is wrong; or saying
    that they hold what they do not.
    """
    whole = _recording(Codec.ZSTD)
    if rng.random() < 0.5:
        return b"B" + of_bytes(rng, whole)
    out, at = bytearray(whole[:8]), 8
    wrong = rng.randrange(2 * FRAMES)
    while at + 9 <= len(whole):
        opcode, length = struct.unpack_from("<BQ", whole, at)
        record = whole[at : at + 9 + length]
        if opcode == 6 and whole[at + 37 : at + 45] == b"\4\0\0\0zstd" and (wrong := wrong - 1) == -1:
            record = _repacked(rng, record)
        out += record
        at += 9 + length
    return b"V" + bytes(out + whole[at:])


def _repacked(rng: Random, record: bytes) -> bytes:
    inside = zstandard.decompress(record[53:])
    if rng.random() < 0.5:
        inside = of_bytes(rng, inside)
    size, crc = len(inside), zlib.crc32(inside)
    if rng.random() < 0.3:
        inside += bytes(rng.choice((1, 1000, 300 << 20)))  # more than it says
        packed = zstandard.compress(inside)
    else:
        packer = zstandard.ZstdCompressor(write_content_size=rng.random() < 0.5)
        packed = packer.compress(inside)
    if rng.random() < 0.3:
        size = rng.choice((0, 1, size - 1, size + 1, 10_000_000_000, 2**64 - 1, 1 << 28))
    if rng.random() < 0.2:
        packed += rng.choice((packed, b"x", rng.randbytes(20)))
    head = record[9:25] + struct.pack("<QI", size, crc) + b"\4\0\0\0zstd" + struct.pack("<Q", len(packed))
    return struct.pack("<BQ", 6, len(head) + len(packed)) + head + packed


def mcap_read(data: bytes, folder: Path) -> None:
    path = folder / "scan.mcap"
    path.write_bytes(data[1:])
    recording = open_recording(path)
    told, right = recording.torn or bool(recording.damage), 0
    for frame in recording.frames:
        recording.label(frame)
        try:
            same = np.array_equal(recording.read_raw(frame)[0], _image(frame.index))
            recording.read(frame)
        except AnnulusError:
            told = True
            continue
        if data[:1] == b"B":
            written = _label(frame.index)
            if not same or (
                frame.label != "unknown" and (frame.label, frame.z_mm) != (written["label"], written["z_mm"])
            ):
                raise Silent(f"frame {frame.index} is another one's")
            right += frame.label != "unknown"
    if data[:1] == b"B" and not told and (right < FRAMES or recording.calibration != {"a": 1}):
        raise Silent(f"{right} of {FRAMES} frames, calibration {recording.calibration}")
    checked = recording.check()
    notes = [note.get("n") if isinstance(note, dict) else None for note in recording.notes("/event")]
    if data[:1] == b"B" and not (told or checked) and notes != [None, *range(FRAMES)]:
        raise Silent(f"events {notes}")
    open_scan(path)
