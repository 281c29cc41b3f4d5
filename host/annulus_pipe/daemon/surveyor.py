"""The surveyor process: defects and diameter during a scan. Run as `python -m annulus_pipe.daemon.surveyor`.

Gets profiles as notes, a fiftieth of a diameter apart, and has wall.survey look at the last WINDOW of them when the
head has moved on by half a diameter. That takes seconds, in a thread: so notes are taken meanwhile, and what cannot be
kept until it is done is counted. Who starts it gives it the lowest priority there is: it is slow alone.
"""

import sys
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from annulus_pipe.daemon.found import Findings, FoundDefect
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.working import serve
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey, survey

# of profiles: five diameters, half a one, and what two windows have in common at least
WINDOW, STEP, OVERLAP = 250, 25, 125
WAITING = 250  # not looked at yet, at most
JUMP_OF_DIAMETER = 1.0  # between two profiles: they do not belong together, z was set
CLOSEUPS_MAX = 100  # repeated: those of the defects found last
REST_MS = 200
REPEAT_TURNS = 10  # of REST_MS: the list, for who came late; a close-up each turn between


class ProfileWindow:
    """The profiles that are to be looked at next, and as many of those before as belong with them."""

    def __init__(self, diameter_mm: float, begins: bool = True) -> None:
        """begins : the first profile that comes is the scan's first."""
        self._jump_mm = JUMP_OF_DIAMETER * diameter_mm
        self._kept: deque[Profile] = deque()
        self._old = 0  # of them were looked at before
        self._begins = begins  # the first one kept is the first that came
        self._finished = False  # all were looked at as the scan's last
        self.missed = 0  # that were never looked at

    def add(self, profile: Profile) -> None:
        if profile.pose is None:
            return
        if self._kept and abs(profile.z_mm - self._kept[-1].z_mm) > self._jump_mm:
            self.missed += len(self._kept) - self._old
            self._kept.clear()
            self._old, self._begins = 0, True
        self._kept.append(profile)
        self._finished = False
        while len(self._kept) - self._old > WAITING:
            self._drop()

    def take(self, final: bool) -> tuple[list[Profile], int, bool, bool] | None:
        """Profiles, which way the head moves, and whether the window's ends are those of the scan; None while there is
        nothing to look at."""
        new = len(self._kept) - self._old
        if (final and (self._finished or len(self._kept) < 2)) or (not final and new < STEP):
            return None
        some = min(new, WINDOW - OVERLAP)
        while self._old + some > WINDOW:
            self._drop()
        part = list(self._kept)[: self._old + some]
        self._old += some
        way = 1 if part[-1].z_mm >= part[0].z_mm else -1
        self._finished = final and some == new
        return part, way, self._begins, self._finished

    def _drop(self) -> None:
        self._kept.popleft()
        self._begins = False
        if self._old:
            self._old -= 1
        else:
            self.missed += 1


class SurveyorJob:
    """Windows and findings as a job. Reports how many profiles it has heard, how many it will not look at, why a window
    could not be looked at, and words for viewers: topic, body, part.
    """

    def __init__(self, calibration: Calibration, takes_over: Mapping[str, Any] | None = None) -> None:
        """`takes_over`: the scan under way, what was found in it, and the next defect's number."""
        self._calibration = calibration
        self._diameter_mm = 2.0 * float(calibration.pipe_radius_mm)
        self._heard = self._reported = self._turns = 0
        self._looking: threading.Thread | None = None
        self._result: list[Any] = []  # of the thread: a Survey, or why there is none
        self._asked: Any = None  # of it: which way, and whether its ends are the scan's
        self._begin(0)
        if takes_over is not None:
            self._scan = takes_over["scan"]
            self._window = ProfileWindow(self._diameter_mm, begins=False)
            self._findings.take_over(takes_over)

    def _begin(self, scan: int) -> None:
        self._scan, self._ended, self._stale = scan, False, self._looking is not None
        self._window = ProfileWindow(self._diameter_mm)
        self._findings = Findings(self._diameter_mm)
        self._shown: deque[FoundDefect] = deque(maxlen=CLOSEUPS_MAX)
        self._told_missed = 0

    def frame(self, header: FrameHeader, image: Image, extra: Any) -> Any:
        return None

    def note(self, kind: str, body: Any) -> None:
        if kind == "begun":
            self._begin(int(body))
        elif kind == "ended":
            self._ended = True
        elif kind == "profile":
            self._heard += 1
            with suppress(ValueError):  # a malformed profile must not cost those that are there
                self._window.add(Profile.from_dict(body))

    def idle(self) -> Any:
        messages: list[list[Any]] = []
        why = ""
        if self._looking is not None and not self._looking.is_alive():
            self._looking, result = None, self._result.pop()
            if self._stale:  # of a scan before this one
                self._stale = False
            elif isinstance(result, Survey):
                messages = self._look(result)
            else:
                why = str(result)
        if self._looking is None and (part := self._window.take(self._ended)) is not None:
            profiles, *self._asked = part
            self._looking = threading.Thread(target=self._survey, args=(profiles,), daemon=True)
            self._looking.start()
        self._turns += 1
        messages = messages or self._again()
        missed = self._window.missed - self._told_missed
        if not messages and not why and not missed and self._heard == self._reported:
            return None
        self._reported, self._told_missed = self._heard, self._window.missed
        return [self._heard, missed, why, messages]

    def close(self) -> Any:
        return None

    def _survey(self, profiles: list[Profile]) -> None:
        try:
            self._result.append(survey(profiles, self._calibration))
        except AnnulusError:  # too little was seen for a station of the pipe: the next window has more
            self._result.append("")
        except Exception as error:
            self._result.append(f"{type(error).__name__}: {error}")

    def _look(self, result: Survey) -> list[list[Any]]:
        new = self._findings.look(result, *self._asked)
        for one in new:
            for old in [old for old in self._shown if old.id == one.id]:
                self._shown.remove(old)
            self._shown.append(one)
        return [self._defects(), *(self._closeup(one) for one in new)]

    def _again(self) -> list[list[Any]]:
        """Now and then what was said before."""
        if self._findings.looked_mm is None:
            return []
        if self._turns % REPEAT_TURNS == 0:
            return [self._defects()]
        if self._turns % (REPEAT_TURNS // 2) == 2 and self._shown:
            self._shown.rotate(-1)
            return [self._closeup(self._shown[-1])]
        return []

    def _defects(self) -> list[Any]:
        return ["defects", self._findings.to_dict(self._scan), b""]

    def _closeup(self, one: FoundDefect) -> list[Any]:
        body, picture = one.closeup
        return ["closeup", {"scan": self._scan, **body}, picture]


def _prepare(setup: Any) -> SurveyorJob:
    return SurveyorJob(Calibration.from_dict(setup["calibration"]), setup["under_way"])


if __name__ == "__main__":
    serve(sys.argv[-1], _prepare, REST_MS)
