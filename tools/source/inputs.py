"""What a few commands of the source's table begin with and no other command draws.

joint : a CT volume, a dogbone sawn out of it, a near-field raster of it, light through dogbones, strengths; by the
second drawer (tools/bench/blind/others). It is no CT of a real joint, for none is public.
target : pairs of frames of a chessboard, in white light and under rings. fisheye : photographs of a chessboard.
"""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from annulus_pipe.geometry.calibration import camera_to_dict
from annulus_pipe.geometry.camera import Camera
from tests.scenes.calibrate.photographs import DrawnTarget, photograph, poses
from tests.scenes.calibrate.ringed_targets import COLOURS, cones, write_scan
from tools.bench.blind.others.joint_volumes import Flaw, Joint, density

AIR, PLASTIC, NOISE = 150.0, 1900.0, 25.0  # grey
SAWN_MM = 12.0  # a dogbone's width
TURNED_DEG = 40.0  # of the raster's zero against the volume's
ANGLES = 8  # dogbones a joint
PIPES = 6  # whose dogbones are classified
ROLL = (1.6, 4.5, 2.0, 2.0)  # height and width of half a bead, mm, and the powers of its shape
PLAIN = np.zeros((2, 3))
JOINT = Joint(
    radius=30.0,
    wall=5.5,
    voxel=(0.36, 0.33, 0.33),
    shape=(130, 210, 210),
    centre=(0.4, -0.3),
    lean=(0.01, -0.02),
    tilt=(0.004, 0.0),
    aside=(0.3, 0.0),
    outer_wave=PLAIN,
    wall_wave=PLAIN,
    rolls=[ROLL, ROLL, (1.3, 4.0, 2.0, 2.0), (1.3, 4.0, 2.0, 2.0)],
    floors=(0.8, 0.7),
    bead_wave=np.array([[0.12, 0.0, 0.03], [0.0, 0.06, 0.0]]),
    zone_width=5.0,
    zone_drop=0.03,
    zone_edge=0.4,
    flare=0.0,
    zone_wave=np.array([[0.08, 0.0, 0.0], [0.05, 0.0, 0.0]]),
    cold=(0.0, 0.3, 0.0),
    flaws=[Flaw("void", 2.0, 27.2, 1.0, 0.6, -1.0)],
)


HEAD = Camera("pinhole", 832, 616, 235.0, 235.0, 418.0, 305.0)  # half the source's pixels
FISHEYE = Camera("fisheye", 1280, 960, 500.0, 499.0, 645.0, 476.0, (0.03, -0.012, 0.002, 0.0))  # 130 degrees


def target(folder: Path) -> None:
    """frames.csv and 9 pairs of a board of 8 x 6 squares of 40 mm; head.json, the camera that took them."""
    folder.mkdir(parents=True, exist_ok=True)
    write_scan(folder, HEAD, DrawnTarget(8, 6, 40.0), cones(), 9)
    head = {"camera": camera_to_dict(HEAD), "pattern": {"colours": COLOURS}}
    (folder / "head.json").write_text(json.dumps(head), encoding="utf-8")


def fisheye(folder: Path) -> None:
    """12 photographs of a board of 9 x 6 squares of 25 mm."""
    folder.mkdir(parents=True, exist_ok=True)
    board = DrawnTarget(9, 6)
    for i, pose in enumerate(poses(FISHEYE, board, 12, fill=0.6, off=0.8)):
        cv2.imwrite(str(folder / f"{i:02d}.png"), photograph(FISHEYE, board, *pose, seed=i))


def joint(folder: Path) -> None:
    """ct.npy, ct.json; dogbone.npy, dogbone.json; raster.npz; ots.csv, strength.csv; dogbones.csv, pipe-<n>; srr."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(4)
    plastic, _, _ = density(JOINT)
    _volume(folder / "ct.npy", plastic, rng)
    _volume(folder / "dogbone.npy", plastic * _sawn(), rng)
    _raster(folder / "raster.npz", rng)
    _light(folder, rng)
    _pipes(folder, rng)
    _sweeps(folder / "srr", 2.4e9, 40.0, 0.02, rng)
    _sweeps(folder / "capacitive", 4.5e6, 25.0, 0.004, rng)


def _sweeps(folder: Path, f0_hz: float, quality: float, part: float, rng: np.random.Generator) -> None:
    """points.csv and a sweep each (Touchstone): a circuit of R, L and C in air, on plain wall and on a bead."""
    folder.mkdir(exist_ok=True)
    rows = ["point,file,z_mm"]
    f = np.linspace(f0_hz * (1 - 3 / quality), f0_hz * (1 + 2.5 / quality), 201)
    for k, (name, lower) in enumerate((("air", 0.0), ("plain", part), ("bead", 1.1 * part))):
        own = f0_hz * (1 - lower)
        impedance = 83.0 + 1j * quality * 133.0 * (f / own - own / f)
        s11 = (impedance - 50) / (impedance + 50) + rng.normal(0, 0.007, (2, len(f))).T @ (1, 1j)
        lines = [f"{a / 1e6:.9g} {b.real:.6f} {b.imag:.6f}" for a, b in zip(f, s11, strict=True)]
        (folder / f"{name}.s1p").write_text("\n".join(["# MHz S RI R 50", *lines]) + "\n", encoding="utf-8")
        rows.append(f"{name},{name}.s1p,{'' if k == 0 else 10 * k}")
    (folder / "points.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


def _volume(path: Path, plastic: np.ndarray, rng: np.random.Generator) -> None:
    grey = gaussian_filter(AIR + (PLASTIC - AIR) * plastic, 0.7)
    np.save(path, (grey + rng.normal(0, NOISE, grey.shape)).astype(np.float32))
    path.with_suffix(".json").write_text(json.dumps({"voxel_mm": JOINT.voxel}), encoding="utf-8")


def _sawn() -> np.ndarray:
    """What a saw leaves of the pipe at angle 0."""
    _, dy, dx = JOINT.voxel
    _, rows, columns = JOINT.shape
    y = (np.arange(rows) - (rows - 1) / 2) * dy - JOINT.centre[1]
    x = (np.arange(columns) - (columns - 1) / 2) * dx - JOINT.centre[0]
    return np.asarray((np.abs(y)[:, None] < SAWN_MM / 2) & (x > 0)[None, :])


def _raster(path: Path, rng: np.random.Generator) -> None:
    """What a near-field probe says over the bead: 18 mV less for each mm, under an aperture, its zero turned."""
    angle, z = np.arange(0, 360, 3.6), np.arange(0.0, 40.5, 0.5)
    phi = np.radians(angle - TURNED_DEG)
    at, along = np.broadcast_arrays(phi[:, None], z[None, :] - 20.0)
    bead = JOINT.surface(False, at, along) - JOINT.surface(False, at, np.sign(along) * 1e3)
    seen = gaussian_filter(300.0 - 18.0 * bead, (2.0, 2.0), mode=("wrap", "nearest"))
    np.savez(path, angle_deg=angle, z_mm=z, amplitude_mv=seen + rng.normal(0, 0.4, seen.shape))


def _light(folder: Path, rng: np.random.Generator) -> None:
    """Eight lines through the wall by Beer and Lambert (Eq. 9.2), and strengths that fall where less light comes."""
    z = np.arange(0.0, 40.0, 0.25)
    deep = 0.10 + 0.05 * np.cos(np.arange(ANGLES) * 2 * math.pi / ANGLES - 1.0)
    shift = rng.normal(0, 0.6, ANGLES)
    over = np.exp(-(((z - 20.0 - shift[:, None]) / 3.0) ** 4))
    volts = 60.0 * np.exp(-2.2 - deep[:, None] * over) * (1 + 0.01 * rng.standard_normal((ANGLES, len(z))))
    names = [f"dogbone_{45 * k}" for k in range(ANGLES)]
    rows = [",".join(f"{value:.4f}" for value in row) for row in np.column_stack([z, volts.T])]
    (folder / "ots.csv").write_text("\n".join([",".join(["z_mm", *names]), *rows]) + "\n", encoding="utf-8")
    strong = [f"{45 * k},{30 - 80 * one:.2f}" for k, one in enumerate(deep)]
    (folder / "strength.csv").write_text("\n".join(["angle_deg,energy_j", *strong]) + "\n", encoding="utf-8")


def _pipes(folder: Path, rng: np.random.Generator) -> None:
    """W and T of six joints as `annulus joint image` writes them: bad dogbones wider and thinner (§9.9.4.2)."""
    rows, phi = ["joint,angle_deg,result"], np.arange(0.0, 360.0)
    for pipe in range(PIPES):
        good = np.arange(ANGLES) < pipe + 1
        at = np.append(np.arange(ANGLES) * 45.0, 360.0)
        wide, thick = (np.where(good, *means) + rng.normal(0, 0.15, ANGLES) for means in ((4.4, 5.4), (7.6, 6.6)))
        curves = {
            name: np.interp(phi, at, np.append(one, one[0])).tolist() for name, one in (("W", wide), ("T", thick))
        }
        (folder / f"pipe-{pipe}").mkdir(exist_ok=True)
        (folder / f"pipe-{pipe}/features.json").write_text(json.dumps({"phi_deg": phi.tolist(), **curves}))
        rows += [f"pipe-{pipe},{45 * k},{'good' if one else 'bad'}" for k, one in enumerate(good)]
    (folder / "dogbones.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")


KINDS: Mapping[str, Callable[[Path], None]] = {"joint": joint, "target": target, "fisheye": fisheye}
