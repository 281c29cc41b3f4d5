"""What became of a scan's frames: each is somewhere, or lost under a name. The law, checked when a scan is over:

    taken    = labelled + lost before a label
    labelled = recorded + lost after it            (where there is a recorder)

Taken are the frames that the camera made, as far as it counts them; labelled is unknown too.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

# Every kind of loss in account.LOSSES stands on one side; tests/unit/daemon/test_ledger.py sees to it.
UNTAKEN = ("camera", "camera_away")  # the daemon never had them
BEFORE = (*UNTAKEN, "no_slot")
AFTER = ("recorder_busy", "recorder_absent", "recorder_failed", "recorder_died", "disk", "recording_gone")
LIVE = (
    "camera_late",
    "worker_busy",
    "worker_failed",
    "worker_died",
    "worker_late",
    "publisher_busy",
    "publisher_failed",
    "publisher_died",
)
NO_FRAMES = (
    "camera_missing",
    "recorder_notes",
    "publisher_notes",
    "workers_replaced",
    "recorders_replaced",
    "publishers_replaced",
    "surveyors_replaced",
    "surveyor_notes",
    "surveyor_failed",
    "edge_events",
    "line_broken",
    "camera_silent",
    "camera_gone",
    "cameras_replaced",
    "sensor_silent",
    "sensor_malformed",
    "sensor_fault",
    "sensor_dropped",
    "supply_fault",
    "control_malformed",
)

LOST_MAX = 0.01  # of the labelled frames; a recording that lacks more is a lost one. tests/unit/daemon/test_ledger.py
EMPTY_S = 5.0  # cameras that brought nothing for so long should have


class ExitStatus(IntEnum):
    """How `annulus daemon` exits. The highest of those that apply; 2 is a command line that cannot be read."""

    FINE = 0
    FAILED = 1  # it could not begin, or not go on
    UNRECORDED = 3  # a scan recorded nothing though it should
    INCOMPLETE = 4  # a recording is lost, or lacks more than LOST_MAX of its frames
    UNBALANCED = 5  # frames that are neither somewhere nor lost
    NOT_DARK = 6  # the controller did not confirm at the end that the lamps are off


@dataclass(frozen=True, slots=True)
class ExitReason:
    """Why a scan does not end well, one line."""

    status: ExitStatus
    text: str


@dataclass(frozen=True, slots=True)
class Ledger:
    """Of one scan that is over."""

    taken: int
    labelled: int
    before: Mapping[str, int]  # lost before a label, by kind
    recording: bool  # whether there was to be one
    recorded: int
    after: Mapping[str, int]  # lost after it, by kind

    @property
    def problem(self) -> str:
        """What does not add up, one line; empty when all does."""
        unlabelled = self.taken - self.labelled - sum(self.before.values())
        unrecorded = self.labelled - self.recorded - sum(self.after.values()) if self.recording else 0
        wrong = [
            f"{abs(count)} {what}{' too many' if count < 0 else ''}"
            for count, what in ((unlabelled, "neither labelled nor lost"), (unrecorded, "neither recorded nor lost"))
            if count
        ]
        return f"the ledger of frames does not add up: {' and '.join(wrong)}" if wrong else ""

    def lines(self) -> list[str]:
        """For people."""
        lines = [f"{self.taken} frames = {self.labelled} labelled + {_sum(self.before)} before a label"]
        if self.recording:
            lines.append(f"{self.labelled} labelled = {self.recorded} recorded + {_sum(self.after)} after it")
        return lines

    def to_dict(self) -> dict[str, Any]:
        return {
            "taken": self.taken,
            "labelled": self.labelled,
            "lost_before_label": dict(self.before),
            "recorded": self.recorded if self.recording else None,
            "lost_after_label": dict(self.after),
        }


def findings(ledger: Ledger, seconds: float, dark: bool) -> list[ExitReason]:
    """Why a scan of so many `seconds` does not end well. `dark`: the lamps are off for certain."""
    found = []
    lost = sum(ledger.after.values())
    if ledger.recording and ledger.recorded == 0 and (ledger.taken > 0 or seconds > EMPTY_S):
        found.append(ExitReason(ExitStatus.UNRECORDED, f"nothing was recorded of {ledger.taken} frames"))
    elif ledger.recording and lost > LOST_MAX * ledger.labelled:
        text = f"the recording lacks {lost} of {ledger.labelled} labelled frames ({_sum(ledger.after)})"
        found.append(ExitReason(ExitStatus.INCOMPLETE, text))
    if ledger.problem:
        found.append(ExitReason(ExitStatus.UNBALANCED, ledger.problem))
    if not dark:
        found.append(
            ExitReason(ExitStatus.NOT_DARK, "the lamps may be on: the controller did not confirm that they are off")
        )
    return found


def _sum(lost: Mapping[str, int]) -> str:
    named = ", ".join(f"{count} {kind}" for kind, count in lost.items() if count)
    return f"{sum(lost.values())} lost" + (f" ({named})" if named else "")
