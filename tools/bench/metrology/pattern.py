"""The source's two patterns out of `annulus pattern design`, and heads built to them reading their own rings.

A frame is drawn from first principles for the head as designed, leaning a little in a clean pipe, and goes through the
reconstruction with the calibration.json that the design wrote.
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np

from annulus_pipe.calibrate.slide import write_design
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.pattern import PatternHead, design, stripe_colours
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.storage.calibration_file import load_calibration
from tests.unit.rings.drawn import draw
from tools.bench.metrology import TABLE
from tools.bench.table import Row

CAMERA = Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5)
HEAD = PatternHead(CAMERA, 152.4, 152.4, 152.4, 56.0, 9.0, 45.0)  # §3.2.3, §4.3.2: 18 mm sensor in a 6 inch pipe
SLIT_PX = 8.0
POSE = Pose(0.02, -0.03, 3.0, -2.0)


def rows() -> list[Row]:
    return [_one("11 rings, n = 3 (Fig. 3.2)", 3, 12), _one("9 stripes, n = 2 (Fig. 4.1)", 2, 9)]


def _one(name: str, word: int, stripes: int) -> Row:
    colours = stripe_colours("RGB", word, stripes)
    pattern = design(HEAD, colours, word, slit_px=SLIT_PX)
    words = [colours[i : i + word] for i in range(stripes - word + 1)]
    unequal = float(np.ptp(pattern.widths_px(HEAD.nominal_mm)))
    with tempfile.TemporaryDirectory() as folder:
        write_design(pattern, 12.0, Path(folder))
        calibration = load_calibration(Path(folder) / "calibration.json")
        for file in ("slide", "preview"):
            (TABLE.pictures / f"pattern-{len(colours) - 1}-{file}.png").write_bytes(
                (Path(folder) / f"{file}.png").read_bytes()
            )
    image = draw(calibration, POSE, slit_px=SLIT_PX)
    cv2.imwrite(str(TABLE.pictures / f"pattern-{len(colours) - 1}-frame.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 85])
    profile = Reconstructor(calibration).profile(image, frame=0, z_mm=0.0)
    seen = np.bincount(profile.ring, minlength=stripes - 1) / 720
    off = np.hypot(profile.points_mm[:, 0], profile.points_mm[:, 1]) - calibration.pipe_radius_mm
    wrong = float(np.mean(np.abs(off) > 1.0))
    rms = float(np.sqrt(np.mean(off**2)))
    print(f"  {name}: {colours}, least seen ring {100 * seen.min():.1f} %, rms {rms:.3f} mm", flush=True)
    return Row(
        f"pattern design, {name}",
        f"{stripes - 1 if word == 3 else stripes} {'rings' if word == 3 else 'stripes'}",
        "no word twice, stripes of one width, every ring read >= 95 %, rms <= 0.1 mm",
        f"{colours}, widths within {unequal:.0e} px, least ring {100 * seen.min():.1f} %, rms {rms:.3f} mm, "
        f"{wrong:.0%} off by more than 1 mm",
        len(set(words)) == len(words) and unequal < 1e-6 and seen.min() >= 0.95 and rms <= 0.1,
    )
