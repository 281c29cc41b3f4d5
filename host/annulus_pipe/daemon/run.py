"""`annulus daemon`: one head from the command line."""

import logging
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from annulus_pipe.daemon.account import ScanReport
from annulus_pipe.daemon.config import HeadConfig, LogConfig
from annulus_pipe.daemon.health import HeadHealth, Word
from annulus_pipe.daemon.interrupt import Interrupt
from annulus_pipe.daemon.ledger import ExitStatus
from annulus_pipe.daemon.logfile import LogFile
from annulus_pipe.daemon.observer import Commanded, Observer, Observers
from annulus_pipe.daemon.priority import raise_priority
from annulus_pipe.daemon.samples import open_sensors
from annulus_pipe.daemon.service import Service
from annulus_pipe.daemon.session import Session
from annulus_pipe.daemon.state import State
from annulus_pipe.job import job_of
from annulus_pipe.stream.working import leave_uncollected
from annulus_pipe.vocabulary import AnnulusError


class Console(Observer):
    """What happens, line by line on stderr."""

    def __init__(self) -> None:
        self._word = Word.OK

    def health(self, health: HeadHealth) -> None:
        if health.word is not self._word:
            _say(f"health {health}")
        self._word = health.word

    def state(self, state: State, why: str) -> None:
        if state is not State.OFF:  # it is the end of the process too
            _say(f"head {state}: {why}" if why else f"head {state}")

    def event(self, kind: str, text: str) -> None:
        _say(text)

    def commanded(self, what: Commanded) -> None:
        _say(f"asked: {what}")

    def telemetry(self, numbers: Mapping[str, Any]) -> None:
        _say(one_line(numbers))

    def ended(self, report: ScanReport) -> None:
        for line in ending(report):
            _say(line)


def run_daemon(config: HeadConfig, log: Path | None = None, job: Sequence[str] = ()) -> ExitStatus:
    """Until Ctrl-C or SIGTERM; every scan ends with what was made. Returns how the worst of them ended. Raises
    AnnulusError when it cannot begin.

    log : in place of the one that head.toml names. job : NAME=TEXT or a job.toml each, over what head.toml says of it.
    """
    with Interrupt() as interrupt, ExitStack() as stack:
        config = replace(config, job=config.job.under(job_of(job)))
        if log is not None:
            config = replace(config, log=replace(config.log or LogConfig(log), file=log))
        service = Service()
        stack.callback(service.close)
        listeners = Observers([Console(), service])
        written = LogFile(config.log) if config.log is not None else None
        if written is not None:
            stack.callback(written.close)
            listeners.all.append(written)
        if remark := raise_priority(config.realtime):
            listeners.event("priority", remark)
        try:
            sensors = open_sensors(config.sensors)
            session = Session(config, observer=listeners, sensors=sensors)
            leave_uncollected()
            session.run(lambda: interrupt.requested)
        except AnnulusError as error:
            if written is not None:
                written.say(logging.ERROR, "daemon", str(error))
            raise
        return session.status


def one_line(telemetry: Mapping[str, Any]) -> str:
    """The state of a scan for people."""
    frames = ", ".join(f"{count} {label}" for label, count in telemetry["frames"].items())
    drops = ", ".join(f"{count} {kind}" for kind, count in telemetry["drops"].items())
    return f"{telemetry['state']}: {frames}; {telemetry['profiles']} profiles" + (f"; lost: {drops}" if drops else "")


def ending(report: ScanReport) -> list[str]:
    """What a scan was, line by line."""
    lines = [f"{report.seconds:.1f} s, frames: " + ", ".join(f"{n} {label}" for label, n in report.frames.items())]
    if report.unknown:
        lines.append("unknown: " + ", ".join(f"{count} {why}" for why, count in report.unknown.items()))
    if len(cameras := report.telemetry.get("cameras", ())) > 1:
        lines += [f"camera {number}: {_of_camera(one)}" for number, one in enumerate(cameras)]
    lines += report.ledger.lines()
    lines.append("lost: " + (", ".join(f"{n} {kind}" for kind, n in report.drops.items()) or "nothing"))
    lines += [f"recording {path}" for path in report.recordings]
    lines += [finding.text for finding in report.findings]
    return lines


def _of_camera(numbers: Mapping[str, Any]) -> str:
    frames = ", ".join(f"{count} {label}" for label, count in numbers["frames"].items())
    lost = ", ".join(f"{count} {kind}" for kind, count in numbers["lost"].items())
    return f"{frames}; lost: {lost or 'nothing'}"


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
