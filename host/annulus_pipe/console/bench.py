"""Routes of the Bench and Job tabs that ask no daemon: when flashes may fire, how a burst looks, what a job takes."""

import asyncio
import contextlib
import re
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from annulus_pipe import untrusted
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.console.answers import Refusal, accepted, asked_for
from annulus_pipe.controller import CHIPS_MAX, CODES
from annulus_pipe.job import NUMBERS, REMARKS_MAX, TEXT_MAX, WORDS, JobSheet
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

BURST_S = 20.0  # a cold machine imports for seconds
SAID_MAX = 1 << 20  # bytes
NUMBER_MAX = 1e9
_CHIPS = re.compile(f"[01]{{1,{CHIPS_MAX}}}")
_RUN = (sys.executable, "-c", "from annulus_pipe.cli import main; main()")


def routes(program: object, command: Sequence[str] = _RUN) -> list[Any]:
    """command : what draws bursts, in place of annulus itself."""
    from starlette.routing import Route

    drawing = asyncio.Lock()  # one child at a time, of all pages together

    async def timing(request: "Request") -> "Response":
        return accepted(**frame_timing(await asked_for(request)))

    async def burst(request: "Request") -> "Response":
        arguments = burst_arguments(await asked_for(request))
        async with drawing:
            drawn, why = await _show(command, arguments)
        if drawn is None:
            raise AnnulusError(why)
        return accepted(burst=drawn, why=why)

    async def bench(request: "Request") -> "Response":
        return accepted(codes=list(CODES), chips_max=CHIPS_MAX)

    async def fields(request: "Request") -> "Response":
        return accepted(fields=job_fields())

    async def check(request: "Request") -> "Response":
        asked = await asked_for(request)
        return accepted(errors=job_errors(asked.get("job")))

    return [
        Route("/api/timing", timing, methods=["POST"]),
        Route("/api/burst", burst, methods=["POST"]),
        Route("/api/bench", bench),
        Route("/api/job", fields),
        Route("/api/job/check", check, methods=["POST"]),
    ]


def frame_timing(asked: Mapping[str, Any]) -> dict[str, Any]:
    """Of one camera mode, times after the sync signal's fall, us: when rows are open, the window in which all are, and
    whether a flash fits. Raises Refusal for what is no number, AnnulusError for what is no camera mode.
    """
    fps, exposure_us, readout_us = (_number(asked, name) for name in ("fps", "exposure_us", "readout_us"))
    mode = FrameTiming(fps, exposure_us, readout_us)
    out: dict[str, Any] = {
        "period_us": mode.period_us,
        "opens_us": mode.opens_us,
        "closes_us": mode.closes_us,
        "fits": None,
        "first_row_us": [mode.closes_us - mode.exposure_us, mode.closes_us],
        "last_row_us": [mode.opens_us, mode.period_us],
        "window": mode.exposure_us > mode.readout_us,
        "why": "",
    }
    flash = [None if asked.get(name) is None else _number(asked, name) for name in ("delay_us", "width_us")]
    try:
        mode.check_window()
        if flash[0] is not None and flash[1] is not None:
            out["fits"] = False
            mode.check_flash(flash[0], flash[1])
            out["fits"] = True
    except AnnulusError as error:
        out["why"] = str(error)
    return out


def burst_arguments(asked: Mapping[str, Any]) -> list[str]:
    """Of `annulus burst show`. Raises Refusal."""
    code = asked.get("code")
    if not isinstance(code, str) or not (code in CODES or _CHIPS.fullmatch(code)):
        raise Refusal(400, f"code: expected {', '.join(CODES)}, or a text of 1 to {CHIPS_MAX} signs 0 and 1")
    repeat = asked.get("repeat", 1)
    if isinstance(repeat, bool) or not isinstance(repeat, int) or abs(repeat) > NUMBER_MAX:
        raise Refusal(400, f"repeat is {untrusted.shown(repeat)}, expected a whole number")
    chip, period, offset = (
        f"{_number({'trigger_offset_us': 0.0, **asked}, name):.9g}"
        for name in ("chip_us", "period_us", "trigger_offset_us")
    )
    return [
        "burst",
        "show",
        "--repeat",
        str(repeat),
        "--chip-us",
        chip,
        "--period-us",
        period,
        "--trigger-offset-us",
        offset,
        "--json",
        "--",
        code,
    ]


def job_fields() -> list[dict[str, Any]]:
    """What a job sheet has, in the order of reports: a text of at most so many signs, a number in a range, or a day."""
    out: list[dict[str, Any]] = []
    for name in WORDS:
        if name in NUMBERS:
            out.append({"name": name, "kind": "number", "low": NUMBERS[name][0], "high": NUMBERS[name][1]})
        else:
            kind = {"date": "date", "remarks": "long"}.get(name, "text")
            out.append({"name": name, "kind": kind, "most": REMARKS_MAX if name == "remarks" else TEXT_MAX})
    return out


def job_errors(job: object) -> dict[str, str]:
    """What is wrong with a sheet, by field; empty when it may be saved. Raises Refusal for what is none."""
    try:
        sheet = untrusted.mapping(job, "job")
    except ValueError as error:
        raise Refusal(400, str(error)) from None
    errors = {}
    for name in WORDS:
        value = sheet.get(name)
        if value in ("", None):
            continue
        try:
            JobSheet.from_dict({name: value}, "")
        except ValueError as error:
            errors[name] = str(error).strip().removeprefix(f"{name} ")
    return errors


def _number(asked: Mapping[str, Any], name: str) -> float:
    try:
        return untrusted.number(asked.get(name), name, NUMBER_MAX)
    except ValueError as error:
        raise Refusal(400, str(error)) from None


async def _show(command: Sequence[str], arguments: Sequence[str]) -> tuple[Mapping[str, Any] | None, str]:
    """What the child drew, and what it refused."""
    child = await asyncio.create_subprocess_exec(
        *command,
        *arguments,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        out, error = await asyncio.wait_for(child.communicate(), BURST_S)
    except TimeoutError:
        return None, f"nothing was drawn within {BURST_S:g} s, expected a machine with less to do"
    finally:
        with contextlib.suppress(ProcessLookupError):
            child.kill()
    lines = error.decode("utf-8", "replace").strip().splitlines()
    why = untrusted.one_line(lines[-1].removeprefix("annulus: ")) if lines and child.returncode else ""
    try:
        return untrusted.mapping(untrusted.parse_json(out, SAID_MAX), "burst"), why
    except ValueError:
        return None, why or "nothing was drawn"
