"""One engine that turns the frames of any recording or scan folder into profiles, wherever the work is done.

`method` is the one place where a head's method is chosen, and has the one function from a frame to its profile: the
daemon's workers call it live, everything else goes through `engine`. An executor says where chunks of frames are worked
on (this process, local processes). What comes out is the same to the bit whichever it is: what must be decided once per
scan is decided before, and chunks are fixed.
A scan that has no profile a frame belongs to a wing: `hooks.opened` says so.

>>> pipe = survey_of("scan.mcap")
"""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from annulus_pipe.wall.survey import Survey


def survey_of(scan: str | Path, calibration: str | Path | None = None) -> "Survey":
    """The survey of a scan folder or a recording; the calibration in a recording is used where no file is given.

    Raises AnnulusError, one line, for any input that is missing, damaged or does not belong together.
    """
    from annulus_pipe.reprocess.engine import reprocess  # late: workers live in this package and need none of it
    from annulus_pipe.reprocess.job import open_job

    return reprocess(open_job(scan, calibration)).survey()
