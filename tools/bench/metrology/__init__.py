"""Ring metrology: calibration, pose, uncertainty, defects, speed, in the source's own simulations where it has them."""

from pathlib import Path

from tools.bench.metrology.claims import CLAIMS
from tools.bench.table import Table

TABLE = Table(
    __name__,
    "Ring metrology: the source's numbers and ours, in the same simulation",
    {
        "autocalibration": "Calibration in the pipe, simulated (§4.3.2)",
        "fine_tuning": "Fine-tuning per direction (Alg. 3)",
        "calibrate_scene": "Calibration in the pipe, ray-traced",
        "intrinsics": "Camera calibration from photographs",
        "stabilisation": "Pose of the head (§3.4.3)",
        "few_rings": "Two rings, one ring, damaged rings",
        "uncertainty": "Uncertainty of a point",
        "light": "Another light: what a real pipe does with it",
        "diameter": "Diameter over repeated scans",
        "absolute": "An absolute scale: optics that have drifted",
        "colour": "Pipes of other colours",
        "artefacts": "Artefacts, vibration, blind zones",
        "back": "Heads back to back (§3.5.1.2)",
        "mirror": "Mirror sensor for small pipes (§3.6)",
        "stereo": "Two cameras, 360 degrees (ch. 5)",
        "fringe": "Motion phase shifting (ch. 6)",
        "fringe_plate": "Motion phase shifting in pictures (ch. 6)",
        "pattern": "Pattern design",
        "speed": "Speed, one core",
    },
    Path(__file__).parent,
    "make bench-metrology",
    CLAIMS,
)
