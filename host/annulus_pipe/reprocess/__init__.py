"""One engine that turns the frames of any recording or scan folder into profiles, wherever the work is done.

`method` is the one place where a head's method is chosen, and has the one function from a frame to its profile: the
daemon's workers call it live, everything else goes through `engine`. An executor says where chunks of frames are worked
on (this process, local processes). What comes out is the same to the bit whichever it is: what must be decided once per
scan is decided before, and chunks are fixed.
A scan that has no profile a frame belongs to a wing: `hooks.opened` says so.

>>> pipe = survey_of("scan.mcap")
"""

from annulus_pipe.reprocess.engine import LedFrames, Reprocessed, look_at, measure, reprocess, survey_of
from annulus_pipe.reprocess.executors import Executor, Failed, Processes, Work, in_process
from annulus_pipe.reprocess.job import Job, open_job, stage_medians
from annulus_pipe.reprocess.method import Method, method_for
from annulus_pipe.reprocess.optics import prior_of
from annulus_pipe.reprocess.photographs import photographs
from annulus_pipe.reprocess.whole import Surveyed, surveyed

__all__ = [
    "Executor",
    "Failed",
    "Job",
    "LedFrames",
    "Method",
    "Processes",
    "Reprocessed",
    "Surveyed",
    "Work",
    "in_process",
    "look_at",
    "measure",
    "method_for",
    "open_job",
    "photographs",
    "prior_of",
    "reprocess",
    "stage_medians",
    "survey_of",
    "surveyed",
]
