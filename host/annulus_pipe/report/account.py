"""What a reader is told of a scan besides the wall."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from annulus_pipe.job import Origin
from annulus_pipe.qualification.quoting import QuotedStatements
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.conformity import Verdict
from annulus_pipe.wall.photograph import Photograph


@dataclass(frozen=True, slots=True)
class ScanAccount:
    """Where a scan came from, what was counted, what was lost and what is wrong with it.

    source : what was scanned, for people. frames : how many by label. drops : everything that was lost, by kind.
    timing_ms : by step. findings : what is wrong with the frames, for people. truth : scores on the twin; passed
    through, never looked at. origin : whose job it was, when, with which calibration. verdict : against the limits
    that somebody named. photographs : of defects, from LED frames. covariance_stated : whether the calibration says
    how well it is known, so that the points' sigma have it. stated : of the head, by the files that vouch for it.
    """

    source: str
    frames: Mapping[str, int]
    drops: Mapping[str, int]
    timing_ms: Mapping[str, float]
    findings: tuple[Finding, ...] = ()
    truth: Mapping[str, Any] | None = None
    origin: Origin = field(default_factory=Origin)
    verdict: Verdict | None = None
    photographs: tuple[Photograph, ...] = ()
    covariance_stated: bool = False
    stated: QuotedStatements = field(default_factory=QuotedStatements)
