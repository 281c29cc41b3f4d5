"""Promises of what Bench and Job ask the console itself: numbers are those of `annulus timing` and `burst show`; a
sheet is checked field by field before the daemon sees it.
"""

import asyncio
import json
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from starlette.applications import Starlette
from starlette.testclient import TestClient

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.console.answers import Refusal, refused
from annulus_pipe.console.bench import burst_arguments, frame_timing, job_errors, job_fields, routes
from annulus_pipe.console.light import light
from annulus_pipe.job import WORDS
from annulus_pipe.vocabulary import AnnulusError

MODE = {"fps": 25.0, "exposure_us": 38000.0, "readout_us": 28000.0}
BURST = {"code": "101", "chip_us": 0.5, "repeat": 3, "period_us": 1000.0, "trigger_offset_us": -2.0}
CHILD = """
import json, sys, time
if "111" in sys.argv:
    print(json.dumps({"ok": False}))
    print("annulus: the controller would refuse this: duty", file=sys.stderr)
    sys.exit(1)
if "000" in sys.argv:
    print("annulus: no pulse in it", file=sys.stderr)
    sys.exit(1)
print(json.dumps({"ok": True, "argv": sys.argv[1:]}))
"""


@pytest.fixture
def web() -> Iterator[TestClient]:
    async def wrong(request: Any, error: Exception) -> Any:
        return refused(str(error), getattr(error, "status", 409))

    app = Starlette(routes=routes(None, (sys.executable, "-c", CHILD)), exception_handlers={AnnulusError: wrong})
    with TestClient(app) as client:
        yield client


def test_the_window_is_that_of_annulus_timing() -> None:
    said, mode = frame_timing(MODE), FrameTiming(25.0, 38000.0, 28000.0)
    assert (said["opens_us"], said["closes_us"], said["period_us"]) == (mode.opens_us, mode.closes_us, 40000.0)
    assert (said["first_row_us"], said["last_row_us"]) == ([-26000.0, 12000.0], [2000.0, 40000.0])
    assert said["window"] and said["fits"] is None and said["why"] == ""


@pytest.mark.parametrize(("delay", "width", "fits"), [(2500, 4000, True), (100, 4000, False), (2500, 20000, False)])
def test_a_flash_that_leaves_the_window_is_refused_with_the_reason(delay: float, width: float, fits: bool) -> None:
    said = frame_timing({**MODE, "delay_us": delay, "width_us": width})
    assert said["fits"] is fits
    assert fits or "leaves the window" in said["why"]


def test_a_mode_without_a_window_is_drawn_and_says_so() -> None:
    said = frame_timing({**MODE, "exposure_us": 20000.0})
    assert not said["window"] and "no moment at which all rows expose" in said["why"]


@pytest.mark.parametrize("wrong", [{"fps": None}, {"fps": True}, {"fps": 1e300}, {"exposure_us": "38"}, {"fps": [25]}])
def test_what_is_no_number_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(Refusal) as refusal:
        frame_timing({**MODE, **wrong})
    assert refusal.value.status == 400


def test_an_impossible_mode_is_refused_by_the_one_who_knows() -> None:
    with pytest.raises(AnnulusError, match="does not fit a frame"):
        frame_timing({**MODE, "exposure_us": 50000.0})


def test_a_burst_is_what_annulus_burst_show_says(web: TestClient) -> None:
    answer = web.post("/api/burst", json=BURST).json()
    assert answer["burst"]["argv"] == [
        "burst",
        "show",
        "--repeat",
        "3",
        "--chip-us",
        "0.5",
        "--period-us",
        "1000",
        "--trigger-offset-us",
        "-2",
        "--json",
        "--",
        "101",
    ]
    assert answer["why"] == ""


def test_a_burst_that_the_controller_would_refuse_is_drawn_with_the_reason(web: TestClient) -> None:
    answer = web.post("/api/burst", json={**BURST, "code": "111"}).json()
    assert answer["ok"] and answer["burst"] == {"ok": False}
    assert answer["why"] == "the controller would refuse this: duty"
    nothing = web.post("/api/burst", json={**BURST, "code": "000"})
    assert nothing.status_code == 409 and nothing.json()["error"] == "no pulse in it"


@pytest.mark.parametrize(
    "wrong",
    [
        {"code": "--help"},
        {"code": "1" * 5000},
        {"code": ""},
        {"code": 101},
        {"repeat": 1.5},
        {"repeat": True},
        {"chip_us": "1"},
        {"period_us": None},
        {"trigger_offset_us": 1e12},
    ],
)
def test_nothing_but_a_code_and_numbers_reaches_the_child(wrong: dict[str, Any]) -> None:
    with pytest.raises(Refusal):
        burst_arguments({**BURST, **wrong})


def test_the_real_one_answers() -> None:
    from annulus_pipe.console.bench import _RUN, _show

    drawn, why = asyncio.run(_show(_RUN, burst_arguments({**BURST, "code": "mpsl25-stuffed"})))
    assert drawn is not None and drawn["ok"] and drawn["chips"] == 50 and why == ""
    drawn, why = asyncio.run(_show(_RUN, burst_arguments({**BURST, "chip_us": 50.0})))
    assert drawn is not None and not drawn["ok"] and why.startswith("the controller would refuse this: ")
    assert {one["name"] for one in drawn["limits"] if not one["ok"]} >= {"chip"}


def test_a_sheet_is_checked_field_by_field() -> None:
    good = {"client": "Gas AG", "sdr": 11, "nominal_diameter_mm": "152.4", "date": "2026-11-25", "remarks": ""}
    assert job_errors(good) == {}
    wrong = {"client": "x" * 301, "sdr": 1000, "date": "25.11.2026", "nominal_diameter_mm": "wide", "remarks": "fine"}
    errors = job_errors(wrong)
    assert errors.keys() == {"client", "sdr", "date", "nominal_diameter_mm"}
    assert "3..100" in errors["sdr"] and "YYYY-MM-DD" in errors["date"]
    with pytest.raises(Refusal):
        job_errors([1])


def test_every_field_of_a_sheet_is_asked_for(web: TestClient) -> None:
    fields = web.get("/api/job").json()["fields"]
    assert [one["name"] for one in fields] == list(WORDS) and fields == json.loads(json.dumps(job_fields()))
    assert {one["kind"] for one in fields} == {"text", "number", "date", "long"}
    assert web.post("/api/job/check", json={"job": {"sdr": 1}}).json()["errors"].keys() == {"sdr"}


def test_banding_is_the_spread_of_the_bands_and_unknown_in_the_dark() -> None:
    bands = np.full(64, 100.0, "<f4")
    bands[:8] = 60.0
    said = light(0, "projector", 7, bands.tobytes())
    assert (said["mean"], said["banding_percent"]) == (95.0, 42.1)
    assert light(0, "led", 8, np.zeros(64, "<f4").tobytes())["banding_percent"] is None
    assert light(0, "led", 8, np.full(64, np.nan, "<f4").tobytes())["mean"] == 0.0
    assert light(0, "led", 8, b"")["mean"] == 0.0
