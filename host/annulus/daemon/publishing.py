"""What is observed, to viewers: one topic for each method of an Observer."""

from collections.abc import Mapping
from typing import Any

from annulus.daemon.account import ScanReport
from annulus.daemon.health import Health
from annulus.daemon.observer import Mark, Observer
from annulus.daemon.state import State
from annulus.numeric.arrays import Image
from annulus.sensors.sample import Sample
from annulus.stream.frames import FrameHeader
from annulus.stream.publish import Publisher
from annulus.wall.profile import Profile


class Publishing(Observer):
    """Topics and bodies are listed in README.md."""

    def __init__(self, publisher: Publisher) -> None:
        self._send = publisher.send

    def state(self, state: State, why: str) -> None:
        self._send("state", {"state": state.value, "why": why})

    def event(self, kind: str, text: str) -> None:
        self._send("event", {"kind": kind, "text": text})

    def frame(self, header: FrameHeader, image: Image) -> None:
        self._send("label", header.to_dict())
        self._send(f"frame/{header.camera}", header.to_dict(), image.data)

    def profile(self, profile: Profile) -> None:
        self._send("profile", profile.to_dict())

    def sample(self, sample: Sample) -> None:
        self._send(f"sensor/{sample.sensor}", sample.to_dict())

    def mark(self, mark: Mark) -> None:
        self._send("mark", mark.to_dict())

    def telemetry(self, numbers: Mapping[str, Any]) -> None:
        self._send("telemetry", numbers)

    def health(self, health: Health) -> None:
        self._send("health", health.to_dict())

    def ended(self, report: ScanReport) -> None:
        self._send("ended", {"seconds": report.seconds, "recordings": [str(path) for path in report.recordings]})
