"""What is fuzzed: a sample made wrong by a seed, and the reader it is given to.

A target's `case(rng)` makes one input; `read(input, folder)` gives it to the readers, and raises whatever they raise,
or `Silent` where what came out is not what went in and nobody said so.
"""

import io
import json
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random

import cv2
import h5py
import msgpack
import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.archive.wall_map import read_map
from annulus_pipe.calibrate.both import placement_from_dict
from annulus_pipe.daemon.config import load_config
from annulus_pipe.daemon.control import REQUEST_MAX, Request
from annulus_pipe.daemon.filmed import ScanFolderCamera
from annulus_pipe.link import codec, messages
from annulus_pipe.link.fields import Message
from annulus_pipe.link.head import HeadControl
from annulus_pipe.link.stage import stage_from_us
from annulus_pipe.rings.calibration.reference import Reference
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.storage.calibration_file import load_calibration, load_camera, load_part
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.testing.scripted import ScriptedController
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, load_acoustic, save_acoustic
from annulus_pipe.wings.tai.decode import load_template
from annulus_pipe.wings.tai.design import load_transducer
from tools.bench.fuzz.catalogue_files import catalogue_case, catalogue_read
from tools.bench.fuzz.certificate_files import certificate_case, certificate_read
from tools.bench.fuzz.found import Silent
from tools.bench.fuzz.joint_files import joint_case, joint_read
from tools.bench.fuzz.mutate import HOSTILE, UNWRITABLE, as_json, of_bytes, of_rows, of_toml, of_values
from tools.bench.fuzz.plate_files import plate_case, plate_read
from tools.bench.fuzz.pod_files import pod_case, pod_read
from tools.bench.fuzz.recordings import mcap_case, mcap_read, packed_case
from tools.bench.fuzz.rig_lines import rig_case, rig_read
from tools.bench.fuzz.unity_files import unity_case, unity_read

ROOT = Path(__file__).parents[3]
BEFORE = ROOT / "tests/data/before"
FRAMES, H, W = 4, 24, 32


@dataclass(frozen=True)
class Target:
    """`one_line`: what else than AnnulusError the reader may raise, to one who makes it an answer."""

    case: Callable[[Random], bytes]
    read: Callable[[bytes, Path], None]
    one_line: tuple[type[Exception], ...] = ()


# ---- the line: any bytes, and whole frames with any content, as answers to what the host asks ----


def _framed(message: type[Message], head: bytes, payload: bytes) -> bytes:
    body = bytes((message.ID,)) + head + payload
    return codec._stuff(body + codec.crc16(body, message.SCHEMA_BYTE).to_bytes(2, "little")) + b"\0"


def _link_case(rng: Random) -> bytes:
    return rng.randbytes(8)


def _link_read(data: bytes, _: Path) -> None:
    rng, now, fps = Random(data), 10**9, 25.0
    stage = stage_from_us(
        ratio=3, period_us=1e6 / fps, exposure_us=38e3, readout_us=28e3, projector_us=(3e3, 5e3), led_us=(3e3, 2.5e3)
    )
    head, controller = HeadControl(stage if rng.random() < 0.9 else None), ScriptedController()
    wrong = rng.choice((0.0, 0.01, 0.1, 0.5))  # of what the controller says, from the second exchange on
    for turn in range(80):
        now += rng.choice((1_000_000, 20_000_000, 40_000_000, 3_000_000_000))
        controller.receive(head.pending(now), now)
        if rng.random() < 0.02:
            rng.choice((controller.reset, controller.power_cycle))()
        said = [part + b"\0" for part in controller.take().split(b"\0") if part]
        for _event in range(rng.choice((0, 0, 1, 5)) if rng.random() < wrong else 0):
            kind = rng.choice(list(messages.EVENTS.values()))
            body = rng.randbytes(2) + bytes((rng.choice((controller.boot, rng.randrange(256))),))
            said.insert(rng.randrange(len(said) + 1), _framed(kind, body, rng.randbytes(kind.LENGTH)))
        answer = b"".join(_spoilt(rng, part) if turn > 1 and rng.random() < wrong else part for part in said)
        while answer:
            size = rng.choice((1, 3, 64, 5000))
            head.receive(answer[:size], now)
            answer = answer[size:]
    for held in (head.session.backlog, len(head._early)):
        if held > 1000:
            raise Silent(f"{held} things wait in the session")


def _spoilt(rng: Random, wire: bytes) -> bytes:
    """A frame with its bytes wrong, or with a content that is wrong and a checksum that is right."""
    body = codec._unstuff(wire[:-1])
    kind = None if body is None else codec.TO_HOST.get(body[0])
    if body is None or kind is None or rng.random() < 0.3:
        return of_bytes(rng, wire)
    head = 4 if issubclass(kind, messages.Event) else 1 if issubclass(kind, messages.Notice) else 2
    payload = of_bytes(rng, body[head:-2])[: kind.LENGTH].ljust(kind.LENGTH, b"\0")
    return _framed(kind, body[1:head], payload)


# ---- requests to the control socket, samples of other programs, frame headers ----

_HEADER = {
    "index": 1,
    "sequence": 2,
    "timestamp_ns": 3,
    "label": "led",
    "reason": "",
    "edge": 4,
    "slot": 1,
    "odometer": -5,
    "z_mm": 1.5,
    "encoding": "mono8",
    "width": 4,
    "height": 3,
    "roll_deg": None,
    "camera": 0,
}
_PACKED = (
    {"do": "mark", "text": "joint", "clock_deg": 90.0},
    {"do": "start"},
    _HEADER,
    {"sensor": "imu", "host_ns": 5, "values": {"roll_deg": 1.5}, "units": {"roll_deg": "deg"}},
)


def _control_case(rng: Random) -> bytes:
    value = rng.choice(_PACKED)
    if rng.random() < 0.3:
        return of_bytes(rng, msgpack.packb(value))
    wrong = of_values(rng, value, HOSTILE)
    try:
        packed: bytes = msgpack.packb(wrong)
    except OverflowError:  # over 64 bits
        packed = b"\xc1"
    deep = rng.choice((40, 900, 3000))
    return packed if rng.random() < 0.9 else b"\x91" * deep + packed


def _control_read(data: bytes, _: Path) -> None:
    for parse in (Request.from_dict, Sample.from_dict, FrameHeader.from_dict):
        try:
            parse(untrusted.unpack(data, REQUEST_MAX))
        except ValueError as error:
            AnnulusError(str(error))
            _must_be_a_line(str(error))


def _must_be_a_line(text: str) -> None:
    if "\n" in text or len(text) > 1000:
        raise Silent(f"no line: {text[:100]!r}")


# ---- calibrations and the files beside them ----

_PARTS: dict[str, Callable[[Path], object]] = {
    "calibration-full.json": load_calibration,
    "calibration-mirror.json": load_calibration,
    "../calibration-2.json": load_calibration,
    "calibration-plain.json": load_camera,
    "target_placement.json": lambda path: load_part(path, placement_from_dict, "annulus calibrate camera"),
    "template.json": load_template,
    "colour.json": lambda path: load_part(path, ColourProfile.from_dict, "annulus calibrate colour"),
    "reference.json": lambda path: load_part(path, Reference.from_dict, "annulus calibrate reference"),
}


@cache
def _part(name: str) -> bytes:
    return (BEFORE / name).read_bytes()


def _calibration_case(rng: Random) -> bytes:
    number = rng.randrange(len(_PARTS))
    sample = _part(list(_PARTS)[number])
    wrong = (
        of_bytes(rng, sample)
        if rng.random() < 0.2
        else as_json(rng, of_values(rng, json.loads(sample), HOSTILE + UNWRITABLE))
    )
    return bytes([number]) + wrong


def _calibration_read(data: bytes, folder: Path) -> None:
    path = folder / "part.json"
    path.write_bytes(data[1:])
    list(_PARTS.values())[data[0] % len(_PARTS)](path)


# ---- scan folders ----


@cache
def _pictures() -> dict[str, bytes]:
    noise = np.random.default_rng(0).integers(0, 256, (H, W, 3), dtype=np.uint8)
    return {
        f"0{kind}": cv2.imencode(kind, noise)[1].tobytes()
        for kind in (".png", ".jpg", ".bmp", ".tiff", ".ppm", ".webp")
    }


def _scan_case(rng: Random) -> bytes:
    pictures = dict(_pictures())
    rows = ["index,file,light,z_mm,roll_deg,camera"]
    rows += [f"{i},{name},{'led' if i == 4 else 'projector'},{2.5 * i},{i},0" for i, name in enumerate(pictures)]
    table = "\n".join(rows) + "\n"
    if rng.random() < 0.5:
        name = rng.choice(list(pictures))
        pictures[name] = (
            of_bytes(rng, pictures[name][: rng.choice((60, 10**6))]) if rng.random() < 0.7 else of_bytes(rng, b"")
        )
        if name == "0.png":
            pictures[name] = _sealed(pictures[name])
    text = of_bytes(rng, table.encode()) if rng.random() < 0.3 else of_rows(rng, table).encode("utf-8", "surrogatepass")
    return bytes(msgpack.packb([text if rng.random() < 0.8 else table.encode(), pictures]))


def _sealed(data: bytes) -> bytes:
    """A PNG whose checksums are right again, so that what is behind them is reached."""
    import zlib

    out, at = bytearray(data), 8
    while at + 12 <= len(out):
        end = at + 12 + int.from_bytes(out[at : at + 4], "big")
        if end > len(out):
            break
        out[end - 4 : end] = zlib.crc32(out[at + 4 : end - 4]).to_bytes(4, "big")
        at = end
    return bytes(out)


def _scan_read(data: bytes, folder: Path) -> None:
    table, pictures = msgpack.unpackb(data)
    (folder / "frames.csv").write_bytes(table)
    for name, content in pictures.items():
        (folder / name).write_bytes(content)
    scan = open_scan(folder)
    for i in range(len(scan.frames[:20])):
        try:
            scan.read(i)
        except AnnulusError as error:
            _must_be_a_line(str(error))
    ScanFolderCamera(folder)


# ---- head.toml ----


@cache
def _toml() -> str:
    page = (ROOT / "host/annulus_pipe/daemon/README.md").read_text()
    lines = page.split("```toml\n")[1].split("```")[0].splitlines()
    return "\n".join(line.split("  #")[0] for line in lines if "key_file" not in line)


def _head_case(rng: Random) -> bytes:
    if rng.random() < 0.2:
        return of_bytes(rng, _toml().encode())
    return of_toml(rng, _toml()).encode("utf-8", "surrogatepass")


def _head_read(data: bytes, folder: Path) -> None:
    shutil.copy(BEFORE.parent / "calibration-1.json", folder / "head-7.json")
    (folder / "head.toml").write_bytes(data)
    load_config(folder / "head.toml")


# ---- raw sound ----


@cache
def _sound(kind: str) -> bytes:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        signals = np.random.default_rng(0).normal(size=(4, 32)).astype(np.float32)
        record = AcousticRecord(
            signals, np.arange(4) * 90.0, 100.0, 1e6, 1e-6, 1480.0, "1011", 1e-6, 4, {"note": "x", "n": 1.0}
        )
        save_acoustic(Path(folder) / f"a.{kind}", record)
        return (Path(folder) / f"a.{kind}").read_bytes()


_ARRAYS: tuple[object, ...] = (
    np.zeros(0),
    np.zeros((4, 32, 3)),
    np.full((4, 32), np.nan),
    np.array(["x"] * 4),
    np.array(b"\x1b[2J"),
    np.zeros((2, 2), complex),
    np.inf,
    -1.0,
    1e300,
    2**63,
    np.zeros((4, 32), bool),
    np.zeros((1, 1)),
    np.array(5),
    np.zeros((4, 32), "M8[s]"),
    "x" * 70_000,
    np.float16(1),
)


def _acoustic_case(rng: Random) -> bytes:
    kind = rng.choice(("npz", "hdf5"))
    sample = _sound(kind)
    wrong = of_bytes(rng, sample) if rng.random() < 0.5 else _npz(rng, sample) if kind == "npz" else _hdf5(rng)
    return kind.encode().ljust(4) + wrong


def _npz(rng: Random, sample: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(sample)) as archive, zipfile.ZipFile(out, "w", rng.choice((0, 8, 12, 14))) as other:
        names = archive.namelist()
        chosen = rng.choice(names)
        for name in names:
            content = archive.read(name)
            if name == chosen:
                new = io.BytesIO()
                np.save(new, np.asarray(rng.choice(_ARRAYS)), allow_pickle=True)
                content = rng.choice(
                    (of_bytes(rng, content), of_bytes(rng, content[:80]) + content[80:], new.getvalue(), b"")
                )
            if rng.random() > 0.02:
                other.writestr(name, content)
    return out.getvalue()


def _hdf5(rng: Random) -> bytes:
    out = io.BytesIO(_sound("hdf5"))
    with h5py.File(out, "r+") as root:
        names: list[str] = []
        gone: list[str] = []
        root.visit(names.append)
        for _ in range(rng.choice((1, 1, 2))):
            name = rng.choice(names)
            if any(name.startswith(one) for one in gone):  # and what was in it
                continue
            gone.append(name)
            del root[name]
            match rng.randrange(7):
                case 0:
                    root[name] = h5py.ExternalLink("/etc/passwd", "/a")
                case 1:
                    root[name] = h5py.SoftLink(rng.choice(("/", "/meta_data", "/nowhere", name)))
                case 2:
                    root[name] = root["/"]
                case 3:
                    root.create_dataset(
                        name, (8192, 1 << 22), "f4", chunks=(1, 4096), compression=rng.choice((None, "gzip", "lzf"))
                    )
                case 4:
                    root.create_group(name)
                case _:
                    value = rng.choice([one for one in _ARRAYS if np.asarray(one).dtype.kind not in "MU"])
                    root[name] = value
    return out.getvalue()


def _acoustic_read(data: bytes, folder: Path) -> None:
    path = folder / f"a.{data[:4].decode().strip()}"
    path.write_bytes(data[4:])
    load_acoustic(path)


@cache
def _wall() -> bytes:
    out = io.BytesIO()
    cells = np.random.default_rng(0).integers(-200, 200, (20, 24)).astype(np.int16)
    np.savez_compressed(
        out,
        format="annulus-wall/1",
        deviation_um=cells,
        shadowed=cells > 190,
        z_step_mm=4.0,
        radius_mm=76.2,
        z_mm=100 + 4.0 * np.arange(20),
        clock_deg=15.0 * np.arange(24),
        imu_roll_deg=np.zeros(20, np.float32),
    )
    return out.getvalue()


def _wall_case(rng: Random) -> bytes:
    return of_bytes(rng, _wall()) if rng.random() < 0.5 else _npz(rng, _wall())


def _wall_read(data: bytes, folder: Path) -> None:
    (folder / "wall.npz").write_bytes(data)
    read_map(folder)


def _transducer_case(rng: Random) -> bytes:
    table = "time_us,amplitude\n" + "".join(f"{0.1 * i:.1f},{(-0.8) ** i:.4f}\n" for i in range(20))
    return of_bytes(rng, table.encode()) if rng.random() < 0.4 else of_rows(rng, table).encode("utf-8", "surrogatepass")


def _transducer_read(data: bytes, folder: Path) -> None:
    (folder / "t.csv").write_bytes(data)
    load_transducer(folder / "t.csv")


TARGETS: dict[str, Target] = {
    "link": Target(_link_case, _link_read),
    "rig": Target(rig_case, rig_read),
    "control": Target(_control_case, _control_read, (ValueError,)),
    "mcap": Target(mcap_case, mcap_read),
    "packed": Target(packed_case, mcap_read),
    "calibration": Target(_calibration_case, _calibration_read),
    "scan": Target(_scan_case, _scan_read),
    "head": Target(_head_case, _head_read),
    "acoustic": Target(_acoustic_case, _acoustic_read),
    "plate": Target(plate_case, plate_read),
    "transducer": Target(_transducer_case, _transducer_read),
    "joint": Target(joint_case, joint_read),
    "wall": Target(_wall_case, _wall_read),
    "catalogue": Target(catalogue_case, catalogue_read),
    "certificate": Target(certificate_case, certificate_read, (ValueError,)),
    "unity": Target(unity_case, unity_read),
    "pod": Target(pod_case, pod_read),
}
