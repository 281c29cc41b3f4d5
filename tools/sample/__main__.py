"""`python -m tools.sample [FOLDER]`: scan.mcap and truth.json of the demo's pipe, 64 frames at half size, in 5 s."""

import json
import sys
from pathlib import Path

from annulus_pipe.twin.recorded import write_recording
from annulus_pipe.twin.worlds import demo_world

FOLDER = Path(__file__).parent / "annulus_sample"
WIDTH, FRAMES = 832, 64  # half the camera's; every ring passes every defect, 5 mm a frame
JOB = {"operator": "the simulated head", "site": "nowhere: simulated", "pipe": "DN 150 PVC with four known defects"}


def write(folder: Path) -> None:
    """Both files anew."""
    world = demo_world().scaled(WIDTH)
    new = folder / "scan.mcap.new"
    new.unlink(missing_ok=True)
    write_recording(world, new, FRAMES, job=JOB)
    new.rename(folder / "scan.mcap")
    (folder / "truth.json").write_text(json.dumps(world.truth(), indent=1) + "\n")


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
