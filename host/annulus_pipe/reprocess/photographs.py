"""Photographs of a survey's defects, from the LED frames of its scan. Only the frames that are shown are read."""

import contextlib
from collections.abc import Sequence

from annulus_pipe.reprocess.job import Job
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wall.photograph import Photograph, Shot, best_views, crop
from annulus_pipe.wall.survey import Survey


def photographs(job: Job, survey: Survey, indices: Sequence[int]) -> tuple[Photograph, ...]:
    """Of each of those defects, numbers into the survey's, that some LED frame shows; a damaged frame shows nothing."""
    shots = [
        Shot(i, job.scan.frames[i].index, job.scan.frames[i].z_mm, job.scan.frames[i].camera)
        for i in job.which(Label.LED)
    ]
    out = []
    for view in best_views(survey, job.calibration, shots, indices).values():
        with contextlib.suppress(AnnulusError):
            out.append(crop(view, job.read(view.shot.number)))
    return tuple(out)
