"""The surveyor's process as the daemon sees it: fed with profiles, never waited for; what it finds goes to viewers."""

import math
from typing import Any

from annulus_pipe.daemon.account import Account, ScanReport
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.pools import Pool
from annulus_pipe.daemon.publishing import Publishing
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.stream.orphan import child
from annulus_pipe.stream.workers import Shared, WorkerKind
from annulus_pipe.wall.profile import Profile

SPACING_OF_DIAMETER = 0.02  # of the profiles that are looked at: those between show the same
UNHEARD_MAX = 100  # profiles on their way, of 90 kB each: more are not looked at


class Surveying(Pool, Observer):
    """Looks after itself: it hears of profiles and, once a second, of telemetry. One that takes over goes on
    with what was found.
    """

    def __init__(
        self, calibration: Calibration, shared: Shared, account: Account, observer: Observer, publishing: Publishing
    ) -> None:
        self._setup: dict[str, Any] = {"calibration": calibration.to_dict(), "under_way": None}
        self._publishing = publishing
        self._spacing_mm = SPACING_OF_DIAMETER * 2.0 * float(calibration.pipe_radius_mm)
        self._at_mm = math.nan  # of the last profile that it was told of
        self._sent = self._heard = 0
        command = ["nice", "-n", "19", *child("annulus_pipe.daemon.surveyor")]  # while it begins, too
        kind = WorkerKind("surveyor", command, self._setup, 1, 1)
        super().__init__(kind, shared, account, observer)

    @property
    def unheard(self) -> int:
        """Profiles on their way."""
        return self._sent - self._heard

    def begun(self, scan: int) -> None:
        self._setup["under_way"] = {"scan": scan, "defects": []}
        self._at_mm = math.nan
        self._pool.tell("begun", scan)

    def profile(self, profile: Profile) -> None:
        if abs(profile.z_mm - self._at_mm) < self._spacing_mm or profile.pose is None:
            return
        self.poll()
        if not self._pool.alive or self.unheard >= UNHEARD_MAX:
            self._account.lose("surveyor_notes")
            return
        self._at_mm = profile.z_mm
        self._sent += 1
        self._pool.tell("profile", profile.to_dict())

    def telemetry(self, numbers: Any) -> None:
        self.poll()

    def ended(self, report: ScanReport) -> None:
        self._pool.tell("ended", None)

    def _died(self, why: str, replaced: bool) -> None:
        self._sent = self._heard = 0
        super()._died(why, replaced)

    def _done(self, header: Any, body: Any) -> None:
        pass

    def _reported(self, worker: int, body: list[Any]) -> None:
        self._heard, missed, why, messages = body
        self._account.lose("surveyor_notes", missed)
        if why:
            self._account.lose("surveyor_failed")
            self._observer.event("surveyor_failed", f"the wall so far cannot be looked at: {why}")
        for topic, found, part in messages:
            if topic == "defects":
                self._setup["under_way"] = found
            self._publishing.made(topic, found, part)
