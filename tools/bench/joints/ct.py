"""`annulus joint image` and `register` on the joint of ../shared/joints: bias, rms, flaws, raster, time and memory."""

import importlib.util
import json
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import tifffile
from scipy.ndimage import zoom

from tools.bench.joints import TABLE
from tools.bench.table import ROOT, Row

JOINTS = ROOT.parent / "shared" / "joints"
NOTE = """
190 x 256 x 256 voxels of 0.288 mm, projected and reconstructed by a program that is not ours: a polychromatic beam,
scatter, rings, brightness along y, drift along z. Not on a user's machine: rows are left out there. No CT of a PE joint
is public. Its 512 x 512 x 512 voxels are the same volume drawn finer, for time and memory.
"""
LARGE = 512
LARGE_S, LARGE_GB = 60.0, 2.0
ASKED = (
    ("outer radius, rms", "outer_radius_rms_mm", None, 0.02),
    ("thickness T, rms", "T_mm", "rms", 0.06),
    ("bead's height outside, rms", "bead_out_height_mm", "rms", 0.05),
    ("bead's height inside, rms", "bead_in_height_mm", "rms", 0.05),
    ("bead's width outside, bias", "bead_out_width_mm", "bias", 0.15),
    ("bead's width inside, bias", "bead_in_width_mm", "bias", 0.15),
    ("zone's width W, rms", "W_inner4_mm", "rms", 0.30),
    ("zone's width W, bias", "W_inner4_mm", "bias", 0.10),
)


def rows() -> list[Row]:
    if not (JOINTS / "score.py").is_file():
        return []
    spec = importlib.util.spec_from_file_location("score_joints", JOINTS / "score.py")
    assert spec is not None and spec.loader is not None
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    truth = JOINTS / "joint-a-truth" / "truth.json"
    with tempfile.TemporaryDirectory() as folder:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-c", "from annulus_pipe.cli import main; main()", "joint", "image"]
        subprocess.run(
            [*command, str(JOINTS / "joint-a" / "ct.tif"), "-o", folder], check=True, capture_output=True, timeout=600
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        said = json.loads((Path(folder) / "features.json").read_text())
        for name in ("density.png", "features.png"):
            shutil.copy(f"{folder}/{name}", TABLE.pictures / name)
        raster = str(JOINTS / "joint-a" / "microwave.npz")
        laid = subprocess.run(
            [*command[:-1], "register", folder, raster, "--json"], check=True, capture_output=True, timeout=600
        )
        scan = json.loads(laid.stdout)
        shutil.copy(f"{folder}/scan.png", TABLE.pictures / "scan.png")
        score = scorer.score(f"{folder}/features.json", str(truth))
        took, held = _large(Path(folder))
    told = json.loads(truth.read_text())
    by, probe = told["by_angle"], told["scene"]["microwave"]
    off = (scan["shift_deg"] - probe["shift_deg"] + 180) % 360 - 180
    sense = scan["sense"] == ("mirrored" if probe["flip"] else "same")
    phi = np.array(said["phi_deg"])
    drop = np.interp(phi, [*by["phi_deg"], 360.0], [*by["drop"], by["drop"][0]])
    light = 100 * float(np.nanmax(np.abs(np.array(said["haz"], float) - (1 - drop))))
    aside = float(np.nanmax(np.abs(said["hilo_out"])))
    found = sum(bool(hit) for _, hit, _ in score["defects"])
    table = []
    for what, key, part, most in ASKED:
        value = score[key] if part is None else score[key][part]
        table.append(Row(what, "-", f"<= {most:g} mm", f"{value:.3f} mm", abs(value) <= most))
    typical = float(np.sqrt(np.mean((np.array(said["haz"], float) - (1 - drop)) ** 2))) * 100
    return [
        *table,
        Row("zone's density, rms; worst angle", "-", "<= 0.3 %", f"{typical:.2f} %; {light:.2f} %", typical <= 0.3),
        Row("hi-lo where there is none, worst angle", "-", "<= 0.05 mm", f"{aside:.3f} mm", aside <= 0.05),
        Row(
            "voids, grains and gaps found; made up",
            "-",
            "all; <= 1",
            f"{found} of {len(score['defects'])}; {score['false']}",
            found == len(score["defects"]) and score["false"] <= 1,
        ),
        Row(
            "probe's raster: shift less truth, its sigma; sense",
            "-",
            "within k = 2",
            f"{off:+.1f} deg, {scan['shift_sigma_deg']:.1f} deg; {scan['sense']}",
            scan["accepted"] and sense and abs(off) <= 2 * scan["shift_sigma_deg"],
        ),
        Row("CPU time, start and pictures included", "-", "-", f"{after.ru_utime - before.ru_utime:.1f} s"),
        Row("memory at most", "-", "<= 2 GB", f"{after.ru_maxrss / 1e6:.2f} GB", after.ru_maxrss < 2e6),
        Row(
            f"{LARGE}^3 voxels: from start to pictures; memory",
            "-",
            f"<= {LARGE_S:g} s; <= {LARGE_GB:g} GB",
            f"{took:.0f} s; {held:.2f} GB",
            took <= LARGE_S and held <= LARGE_GB,
        ),
    ]


def _large(folder: Path) -> tuple[float, float]:
    """Seconds and GB of `joint image` on the volume at LARGE^3 voxels."""
    small = tifffile.imread(JOINTS / "joint-a" / "ct.tif")
    voxel = json.loads((JOINTS / "joint-a" / "ct.json").read_text())["voxel_mm"]
    finer = [LARGE / n for n in small.shape]
    tifffile.imwrite(folder / "ct.tif", zoom(small, finer, order=1, grid_mode=False), photometric="minisblack")
    size = [f"{v * (n - 1) / (LARGE - 1):.9f}" for v, n in zip(np.broadcast_to(voxel, 3), small.shape, strict=True)]
    told = folder / "time.txt"
    code = (
        "import resource, time; t = time.monotonic()\nfrom annulus_pipe.cli import main\ntry: main()\nfinally: "
        f"open({str(told)!r}, 'w').write(f'{{time.monotonic() - t}} "
        "{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6}')"
    )
    command = [sys.executable, "-c", code, "joint", "image", str(folder / "ct.tif"), "-o", str(folder / "large")]
    subprocess.run([*command, "--voxel-mm", *size], check=True, capture_output=True, timeout=600)
    took, held = told.read_text().split()
    return float(took), float(held)
