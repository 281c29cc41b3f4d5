"""The one place that counts what a scan took and what it lost. A frame that was taken is accounted for:

    taken         = labelled + lost before a label     + waiting for their label
    to record     = recorded + lost after it           + in the recorder's hands
    to profile    = profiles + lost on the way there   + in the workers' hands

`in_hand` is the last column; it is zero once a scan is over, and then ledger.py has what is asked of the rest.
"""

import time
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from annulus_pipe.daemon.ledger import AFTER, BEFORE, UNTAKEN, ExitReason, Ledger, findings
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import Label

EVENTS_KEPT = 200
LATENCIES_KEPT = 1000
LOSSES: Mapping[str, str] = {
    "camera": "holes in the driver's frame counter",
    "camera_away": "frames due while the camera, or its intake, was gone or silent",
    "no_slot": "shared memory full: recorder, publisher and workers hold every slot",
    "recorder_busy": "labelled, but the recorder held its whole share of the slots: the disk is slow",
    "recorder_absent": "labelled, but no recorder was up",
    "disk": "labelled, but the disk did not take it",
    "recorder_failed": "the recorder refused it",
    "recorder_died": "in the hands of a recorder that died (another takes over, in a file of its own)",
    "recording_gone": "recorded, but the file was removed or cut short while it was written",
    "recorder_notes": "small records (profiles, telemetry, events, samples) the recorder had no room for",
    "camera_late": "recorded, but its flash was measured before it came",
    "camera_missing": "flashes measured live without a camera's frame",
    "worker_busy": "recorded, but not reconstructed live: all workers had their hands full",
    "worker_failed": "recorded, but the worker refused it",
    "worker_died": "recorded, but the worker died with it",
    "worker_late": "recorded, but the worker was not done when the scan ended",
    "publisher_busy": "labelled, but the publisher held its whole share of the slots: no viewer had it",
    "publisher_failed": "labelled, but the publisher refused it",
    "publisher_died": "labelled, but the publisher died with it",
    "publisher_notes": "small messages (labels, profiles, telemetry, events, samples) the publisher had no room for",
    "workers_replaced": "workers that died or hung, and were started again",
    "recorders_replaced": "recorders that died or hung, and were started again",
    "publishers_replaced": "publishers that died or hung, and were started again",
    "surveyors_replaced": "surveyors that died or hung, and were started again",
    "surveyor_notes": "profiles that the surveyor had no time for; `annulus reconstruct` has",
    "surveyor_failed": "stretches of the wall that the surveyor could not look at",
    "edge_events": "events of the controller that could not be read again; their frames are unknown",
    "line_broken": "times the serial line went away",
    "camera_silent": "times a camera fell silent; its stream is begun anew",
    "camera_gone": "times a camera went away, or its intake; it is opened again",
    "cameras_replaced": "intakes of cameras that died or hung, and were started again",
    "sensor_silent": "times a sensor fell silent for over 2 s, or broke",
    "sensor_malformed": "what came from a sensor's address and was no sample",
    "sensor_fault": "transfers of chips on I2C that were tried again or given up, brown-outs, tanks that stood still",
    "sensor_dropped": "samples of chips on I2C that nobody fetched in time",
    "supply_fault": "times a supply had too little voltage, drew too much, or a lamp drew nothing",
    "control_malformed": "what came to the control socket and was no request",
}
_RECONSTRUCTION = ("worker_busy", "worker_failed", "worker_died", "worker_late")


@dataclass(frozen=True, slots=True)
class ScanReport:
    """What a scan was, in numbers."""

    seconds: float
    frames: Mapping[str, int]  # by label
    unknown: Mapping[str, int]  # by reason
    drops: Mapping[str, int]  # by kind, see LOSSES
    profiles: int
    recordings: tuple[Path, ...]
    latency_ms: float  # median, frame in hand to profile joined; 0 without profiles
    telemetry: Mapping[str, Any]  # the last one
    events: tuple[str, ...]  # the last ones, for people
    ledger: Ledger
    findings: tuple[ExitReason, ...]  # why it did not end well; empty when it did


class Account:
    """Of one scan, `restart`ed for the next. Everybody in a session writes into the same one."""

    def __init__(self) -> None:
        self.events: deque[str] = deque(maxlen=EVENTS_KEPT)  # the last ones, of earlier scans too
        self.restart()

    def restart(self) -> None:
        """Everything at zero."""
        self.taken = 0  # frames from the cameras
        self.frames: Counter[str] = Counter()  # by label
        self.unknown: Counter[str] = Counter()  # by reason
        self.to_record = 0
        self.recorded = 0
        self.to_profile = 0
        self.profiles = 0
        self.samples: Counter[str] = Counter()  # by sensor
        self.recordings: list[Path] = []  # the files there are
        self.recording = False  # whether there is to be one
        self.dark = True  # the lamps are off for certain, or there are none
        self._lost: Counter[str] = Counter()
        self._cameras: dict[int, tuple[Counter[str], Counter[str]]] = {}  # by label, and lost by kind
        self._latency_ms: deque[float] = deque(maxlen=LATENCIES_KEPT)
        self._began_ns = self._ended_ns = 0

    def begin(self) -> None:
        """The camera was started."""
        self._began_ns = time.monotonic_ns()

    def end(self) -> None:
        """It was stopped."""
        self._ended_ns = time.monotonic_ns()

    @property
    def seconds(self) -> float:
        """Since the camera was started; 0 before."""
        return ((self._ended_ns or time.monotonic_ns()) - self._began_ns) / 1e9 if self._began_ns else 0.0

    @property
    def labelled(self) -> int:
        """Frames with a label that is not unknown."""
        return self.frames[Label.PROJECTOR.value] + self.frames[Label.LED.value]

    def label(self, header: FrameHeader) -> None:
        self.frames[header.label.value] += 1
        self._of(header.camera)[0][header.label.value] += 1
        if header.label is Label.UNKNOWN:
            self.unknown[header.reason] += 1

    def profile(self, latency_ms: float) -> None:
        """A profile is out, so long after its frame was in hand."""
        self.profiles += 1
        self._latency_ms.append(latency_ms)

    def lose(self, kind: str, count: int = 1, *, camera: int | None = None) -> None:
        """`kind` is one of LOSSES. `camera`: the one that lost it."""
        if kind not in LOSSES:
            raise ValueError(f"a loss of kind {kind!r}, expected one of {', '.join(LOSSES)}")
        self._lost[kind] += count
        if camera is not None:
            self._of(camera)[1][kind] += count

    def of_camera(self, number: int) -> dict[str, Any]:
        """One camera's frames by label, and what was lost of it by kind."""
        frames, lost = self._of(number)
        return {
            "frames": {label.value: frames[label.value] for label in Label},
            "lost": {kind: count for kind, count in sorted(lost.items()) if count},
        }

    def _of(self, camera: int) -> tuple[Counter[str], Counter[str]]:
        return self._cameras.setdefault(camera, (Counter(), Counter()))

    @property
    def drops(self) -> dict[str, int]:
        """What was lost, by kind."""
        return {kind: count for kind, count in sorted(self._lost.items()) if count}

    @property
    def in_hand(self) -> dict[str, int]:
        """Frames on their way, by where they are."""
        return {
            "label": self.taken - self._sum(BEFORE) + self._sum(UNTAKEN) - self.frames.total(),
            "recorder": self.to_record - self.recorded - self._sum(AFTER),
            "workers": self.to_profile - self.profiles - self._sum(_RECONSTRUCTION),
        }

    @property
    def ledger(self) -> Ledger:
        """Of a scan that is over; before, what is in hand is missing in it."""
        return Ledger(
            taken=self.taken + self._sum(UNTAKEN),
            labelled=self.frames.total(),
            before={kind: self._lost[kind] for kind in BEFORE if self._lost[kind]},
            recording=self.recording,
            recorded=self.recorded,
            after={kind: self._lost[kind] for kind in AFTER if self._lost[kind]},
        )

    def unrecord(self, frames: int) -> None:
        """A file with so many recorded frames is gone."""
        frames = min(frames, self.recorded)
        self.recorded -= frames
        self.lose("recording_gone", frames)

    def numbers(self) -> dict[str, Any]:
        """For the telemetry."""
        return {
            "frames": {label.value: self.frames[label.value] for label in Label},
            "unknown": dict(self.unknown),
            "drops": self.drops,
            "recorded": self.recorded,
            "profiles": self.profiles,
            "in_hand": self.in_hand,
            "ledger": self.ledger.to_dict(),
            "samples": dict(self.samples),
        }

    def report(self, telemetry: Mapping[str, Any]) -> ScanReport:
        """Where the scan stands, or ended."""
        ledger = self.ledger
        return ScanReport(
            self.seconds,
            dict(self.frames),
            dict(self.unknown),
            self.drops,
            self.profiles,
            tuple(self.recordings),
            median(self._latency_ms) if self._latency_ms else 0.0,
            telemetry,
            tuple(self.events),
            ledger,
            tuple(findings(ledger, self.seconds, self.dark)),
        )

    def _sum(self, kinds: Sequence[str]) -> int:
        return sum(self._lost[kind] for kind in kinds)
