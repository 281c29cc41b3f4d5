"""A whole scan by clicking, from the job to the report: the page, the console, the daemon and the firmware's own code
on the simulated head, as `annulus console --demo` starts them.
"""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser import chromium, faults

from annulus_pipe.record.recording import open_recording
from annulus_pipe.vocabulary import Label

pytestmark = [
    pytest.mark.alone,
    pytest.mark.timeout(240),
    pytest.mark.deep(gate="tests/unit/console/test_serving.py::test_pictures_and_points_come_at_once"),
]

FPS = 8
FRAMES = 60  # labelled, before it is ended: 140 mm of the pipe


def until(what: Callable[[], object], seconds: float) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, f"not within {seconds:g} s"
        time.sleep(0.1)


def test_from_the_job_to_the_report(tmp_path: Path) -> None:
    command = [sys.executable, "-c", "from annulus_pipe.cli import main; main()"]
    console = subprocess.Popen(
        [*command, "console", "--demo", "--fps", str(FPS), "--port", "0", "--out", str(tmp_path)],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert console.stderr is not None
        url = next(found[0] for line in console.stderr if (found := re.search(r"http://[\d.:]+/", line)))
        with chromium() as browser:
            _scan(browser, url)
    finally:
        console.send_signal(signal.SIGINT)
        console.wait(30.0)
        assert console.stderr is not None
        console.stderr.close()
    assert console.returncode == 0
    log = (tmp_path / "demo.log").read_text()
    assert "Traceback" not in log, log[-3000:]
    recording = next((tmp_path / "scans").glob("*.mcap"))
    read = open_recording(recording)
    assert sum(frame.label is not Label.UNKNOWN for frame in read.frames) >= FRAMES
    assert [mark["text"] for mark in read.notes("/mark")] == ["root <b>ingress</b>"]
    summary = json.loads(next((tmp_path / "scans").rglob("summary.json")).read_text())
    assert summary["points"] > 10_000


def _scan(browser: Any, url: str) -> None:
    context = browser.new_context(viewport={"width": 1400, "height": 900}, locale="en")
    page = context.new_page()
    page.set_default_timeout(60_000)
    asked: list[str] = []
    wrong: list[str] = []
    context.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(url)
    state = page.locator("#state-word")
    until(lambda: state.inner_text() == "Ready", 120.0)

    page.click("#tab-job")
    page.get_by_label("Client", exact=True).fill("The Waterworks")
    page.get_by_label("Site", exact=True).fill("Elm Street")
    page.click("#job-save")
    until(lambda: not page.locator("#job-save").is_enabled(), 60.0)

    page.click("#tab-scan")
    page.click("#do-start")
    page.click("#confirm-yes")
    until(lambda: state.inner_text() == "Scanning", 60.0)
    latest = "window.annulus.latest"
    page.get_by_label("What is here").fill("root <b>ingress</b>")
    page.get_by_label("Clock", exact=True).select_option(label="6:00")
    page.click("text=Mark this place")
    page.click("#do-pause")
    until(lambda: state.inner_text() == "Paused", 60.0)
    page.click("#do-resume")
    page.click("#confirm-yes")
    until(lambda: page.evaluate(f"(f => f.projector + f.led)({latest}.telemetry.frames)") >= FRAMES, 90.0)
    assert page.evaluate("window.annulus.stats.pictures") > 20
    assert page.evaluate("window.annulus.stats.points") > 10_000, "the wall grows"
    assert not faults(page)
    page.click("#do-stop")
    page.click("#confirm-yes")
    until(lambda: state.inner_text() == "Ready", 60.0)

    page.click("#tab-surveys")
    page.get_by_role("button", name=re.compile("^Reconstruct")).first.click()
    page.click("dialog button.primary")
    report = page.get_by_role("link", name=re.compile("^Open the report"))
    report.first.wait_for(timeout=120_000)
    with context.expect_page() as opening:
        report.first.click()
    shown = opening.value
    shown.wait_for_load_state()
    text = shown.inner_text("body")
    assert "The Waterworks" in text and "Elm Street" in text
    assert "root <b>ingress</b>" in text, "as text, not as markup"
    context.close()
    assert not wrong
    own = url.split("//")[1]
    named = [one for one in asked if not one.startswith(("data:", "blob:"))]
    foreign = [one for one in named if not one.split("//")[-1].startswith(own)]
    assert not foreign, foreign
