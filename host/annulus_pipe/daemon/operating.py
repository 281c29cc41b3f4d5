"""What operators ask of a session, done: who commands, the job, lamps tried out and put in force, trials that end by
themselves.

A **trial** has cameras and lamps on, and records nothing. It ends `hold_s` after the last request that asked for more,
whoever asked and whatever became of them: a head does not stay armed because a browser once armed it.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol

from annulus_pipe.daemon.about import about
from annulus_pipe.daemon.command import CommandLease
from annulus_pipe.daemon.config import HeadConfig, LampConfig
from annulus_pipe.daemon.controller_line import (
    ControllerLine,
    check_lamps,
    lamp_numbers,
    preamble_for,
    stage_of,
    with_lamps,
)
from annulus_pipe.daemon.observer import Commanded, Mark, Observers
from annulus_pipe.daemon.request import COMMANDED, Do, Request
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.vocabulary import AnnulusError

PHOTO_S = 1.0  # from one photo to the next at least
WRITTEN_MAX = 20  # requests written down in one second; test_operating_audit: a flood fills neither recording nor log
ASKS = frozenset({Do.STATE, Do.ABOUT, Do.HOLD})  # change nothing, or only go on


class Operated(Protocol):
    """Of a session what operators can see and change."""

    config: HeadConfig
    observers: Observers
    navigation: Navigation
    newest_led: int | None

    @property
    def line(self) -> ControllerLine | None: ...
    @property
    def has_scan(self) -> bool: ...
    @property
    def scan(self) -> int | None: ...
    def require_scan(self) -> None: ...
    def start(self, record: bool = True) -> None: ...
    def pause(self) -> None: ...
    def resume(self) -> None: ...
    def stop(self) -> None: ...


class Operating:
    """Of one session, whose thread calls everything here."""

    def __init__(self, session: Operated) -> None:
        self._session = session
        self._command = CommandLease()
        self._trial_until_s: float | None = None  # monotonic
        self._before: LampConfig | None = None  # the lamps that come back when the trial ends
        self._photo_s = -PHOTO_S  # monotonic, of the last mark with a photo
        self._second, self._written, self._left_out = 0, 0, 0  # of what is written down: in which second, how much

    def obey(self, request: Request) -> Mapping[str, Any] | None:
        """Do what is asked, and write down who asked; what the answer says besides. Raises AnnulusError when it cannot
        be done now.
        """
        renewal = request.do is Do.COMMAND and self._holds(request)
        quiet = request.do in ASKS or renewal or (request.do is Do.LAMPS and not request.commit)
        under_way = self._session.scan
        ending = request.do is Do.STOP and under_way is not None and request.scan in (None, under_way)
        if ending:  # written down while its recording is open
            self._write_down(request, "done")
        try:
            answer = self._obey(request)
        except AnnulusError as refused:
            if not renewal:
                self._write_down(request, str(refused))
            raise
        if not (quiet or ending):
            self._write_down(request, "done")
        return answer

    def _holds(self, request: Request) -> bool:
        holder = self._command.holder(time.monotonic())
        return holder is not None and request.who is not None and holder.is_same(request.who)

    def _write_down(self, request: Request, outcome: str) -> None:
        """Bounded: a client that asks as fast as it can fills neither the recording nor the log."""
        now_ns, who = time.monotonic_ns(), request.who
        second = now_ns // 1_000_000_000
        if second != self._second:
            self._second, self._written = second, 0
        self._written += 1
        if self._written > WRITTEN_MAX:
            self._left_out += 1
            return
        name, own, address = ("", "", "") if who is None else (who.name, self._command.public_id(who), who.address)
        left_out, self._left_out = self._left_out, 0
        entry = Commanded(now_ns, name, own, request.peer, address, request.summary(), outcome, left_out)
        self._session.observers.commanded(entry)

    def _obey(self, request: Request) -> Mapping[str, Any] | None:
        now_s = time.monotonic()
        if request.do in COMMANDED:
            self._command.require(request.who, now_s)
        session = self._session
        if request.scan is not None and request.scan != session.scan:
            raise AnnulusError("the scan or trial that this is about is over")
        match request.do:
            case Do.START:
                self._start(request, now_s)
                return {"scan": session.scan}
            case Do.STOP:
                session.require_scan()
                session.stop()
            case Do.PAUSE:
                if self._trial_until_s is not None:
                    raise AnnulusError("a trial cannot be paused, only ended")
                session.pause()
            case Do.RESUME:
                session.resume()
            case Do.HOLD:
                if self._trial_until_s is None:
                    raise AnnulusError("no trial is under way that could be held")
                self._trial_until_s = now_s + request.hold_s
            case Do.MARK:
                session.require_scan()
                self._bound_photos(request, now_s)
                z_mm, note = session.navigation.odometer.here_mm, (request.text, request.clock_deg, request.photo)
                session.observers.mark(Mark(time.monotonic_ns(), z_mm, *note, session.newest_led))
            case Do.ZERO:
                if session.line is None:
                    raise AnnulusError("there is no controller, and so no odometer to zero")
                session.navigation.zero()
            case Do.ABOUT:
                return {"about": about(session.config, session.line)}
            case Do.JOB:
                assert request.job is not None
                session.config = replace(
                    session.config, job=session.config.job.under(request.job).without(request.emptied)
                )
                session.observers.job(session.config.job)
            case Do.LAMPS:
                return {"lamps": lamp_numbers(self._lamps(request))}
            case Do.COMMAND:
                self._tell(self._command.ask(request.who, now_s, take=request.take))
            case Do.RELEASE:
                self._tell(self._command.release(request.who, now_s))
        return None

    def turn(self) -> None:
        """Now and then: a trial that nobody holds is over."""
        if self._trial_until_s is not None and time.monotonic() > self._trial_until_s:
            self._session.observers.event("trial", "the trial is over, lamps off: nobody asked for more")
            self._session.stop()

    def ended(self) -> None:
        """The scan, or the trial, is over: lamps that were tried are the former ones again."""
        self._trial_until_s = None
        before, self._before = self._before, None
        if before is not None:
            try:
                self._put_in_force(replace(self._session.config, lamps=before), window=True)
            except AnnulusError as error:  # the head keeps what it was asked for, and has it before it is armed again
                self._session.observers.event("lamps", f"the lamps of before the trial are not confirmed yet: {error}")

    def numbers(self) -> dict[str, Any]:
        """For the telemetry."""
        now_s, config = time.monotonic(), self._session.config
        left = None if self._trial_until_s is None else round(max(0.0, self._trial_until_s - now_s), 1)
        return {
            "command": self._command.numbers(now_s),
            "trial": left,
            "lamps": lamp_numbers(config.lamps),
            "job": config.job.to_dict(),
        }

    def _start(self, request: Request, now_s: float) -> None:
        if not request.record and self._session.line is None:
            raise AnnulusError("there is no controller, and so no lamps to try")
        self._session.start(record=request.record)
        if not request.record:
            self._trial_until_s = now_s + request.hold_s

    def _lamps(self, request: Request) -> LampConfig:
        """As they would be, or, when that is asked, as they are from now on."""
        session = self._session
        trying = request.trial and request.commit
        if trying and self._trial_until_s is None:
            raise AnnulusError("no trial is under way in which lamps could be tried")
        wanted = replace(session.config, lamps=with_lamps(session.config.lamps, request.lamps))
        check_lamps(wanted, window=not request.trial)
        if not request.commit:
            return wanted.lamps
        if session.line is None:
            raise AnnulusError("there is no controller, and so no lamps to set")
        if session.has_scan and self._trial_until_s is None:
            raise AnnulusError("a scan is under way: end it before you set lamps")
        former = session.config
        try:
            self._put_in_force(wanted, window=not request.trial)
        except AnnulusError:
            self._put_in_force(former, window=self._before is None)
            raise
        if trying:
            self._before = self._before or former.lamps
        else:
            self._before = None
            session.observers.event("lamps", f"lamps set: {_in_words(wanted.lamps)}")
        return wanted.lamps

    def _put_in_force(self, config: HeadConfig, window: bool) -> None:
        session = self._session
        session.config = config
        if session.line is None:
            return
        for event in session.line.configure(stage_of(config, window=window), preamble_for(config)):
            session.navigation.heard(event)
        if problem := session.line.refusal:
            raise AnnulusError(f"{session.line.url}: {problem}")
        if not session.line.settled:
            raise AnnulusError(f"{session.line.url}: the controller did not confirm these lamps")

    def _bound_photos(self, request: Request, now_s: float) -> None:
        """A client that sends photos as fast as it can would fill the disk of the scan."""
        if request.photo:
            if now_s - self._photo_s < PHOTO_S:
                raise AnnulusError(f"a mark with a photo came less than {PHOTO_S:g} s ago; wait, or mark without one")
            self._photo_s = now_s

    def _tell(self, text: str) -> None:
        if text:
            self._session.observers.event("command", text)


def _in_words(lamps: LampConfig) -> str:
    projector = f"projector {lamps.projector_delay_us:g} us, {lamps.projector_width_us:g} us long"
    return f"{projector}; LED {lamps.led_delay_us:g} us, {lamps.led_width_us:g} us long; {lamps.ratio}:1"
