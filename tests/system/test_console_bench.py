"""Promises of Job, Bench and Surveys, by clicking in Debian's chromium, before a daemon that only talks: what is being
written is never overwritten, lamps come on by two steps and go dark with the page, times are put in force only when
they were judged.
"""

import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import chromium, faults
from clicking import asked, console, page, until

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests/unit/console"))

from fake_daemon import FakeDaemon  # noqa: E402

pytestmark = pytest.mark.alone

WIDTHS = (1400, 1024, 390)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as one:
        yield one


@pytest.fixture(scope="module")
def daemon() -> Iterator[FakeDaemon]:
    with FakeDaemon(fps=25.0) as one:
        yield one


@pytest.fixture
def head(daemon: FakeDaemon) -> FakeDaemon:
    """As it is in the morning."""
    daemon.job, daemon.state, daemon.trial_until, daemon.command = {}, "idle", None, None
    daemon.lamps = {
        "ratio": 4,
        "projector_delay_us": 3000.0,
        "projector_width_us": 5000.0,
        "led_delay_us": 3000.0,
        "led_width_us": 2500.0,
    }
    daemon.asked.clear()
    return daemon


@pytest.fixture(scope="module")
def url(daemon: FakeDaemon, shelf: Path) -> Iterator[str]:
    with console(daemon, shelf) as address:
        yield address


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result, a scan folder, and a scan that can be reconstructed."""
    folder = tmp_path_factory.mktemp("scans")
    result = folder / "elm-street-results"
    result.mkdir()
    summary = {
        "format": "annulus-summary/1",
        "source": "elm-street.mcap",
        "created": "2026-11-25T06:29:48+00:00",
        "job": {"pipe": "P-<b>1</b>", "site": "Elm Street"},
        "scanned_mm": {"from": 0, "to": 401, "length": 401},
        "diameter_mm": {"mean": 152.444, "k2": 0.1},
        "defects": [{"depth_mm": 4.0}],
        "warnings": [],
        "conformity": {"decision": "does not conform"},
    }
    (result / "summary.json").write_text(json.dumps(summary))
    (result / "report.html").write_text(
        "<!doctype html><title>r</title><p id=a>report</p><script>document.getElementById('a').textContent += ' drawn';"
        "fetch('/api/session').then(() => document.title = 'let in', () => document.title = 'kept out')</script>"
    )
    scan = folder / "plate"
    scan.mkdir()
    (scan / "frames.csv").write_text("index,file,light,z_mm\n0,0.png,led,5\n")
    return folder


@pytest.mark.deep(
    gate="tests/system/test_console_bench.py::test_scans_are_listed_filtered_and_a_report_opens_kept_apart"
)
def test_a_job_is_checked_beside_its_fields_and_saved(browser: Any, url: str, head: FakeDaemon) -> None:
    with page(browser, url, "job") as tab:
        tab.get_by_label("Client").fill("Gas AG")
        tab.get_by_label("SDR").fill("1000")
        tab.get_by_label("Date of the scan").fill("2026-11-25")
        tab.locator("#job-save").click()
        tab.wait_for_selector("text=expected a number in 3..100")
        assert tab.get_by_label("SDR").get_attribute("aria-invalid") == "true"
        assert not asked(head, "job")
        tab.get_by_label("SDR").fill("17,6")
        tab.locator("#job-save").click()
        until(lambda: asked(head, "job"))
        assert asked(head, "job")[-1]["job"] == {"client": "Gas AG", "sdr": 17.6, "date": "2026-11-25"}
        tab.wait_for_selector("text=All of it is saved")


@pytest.mark.deep(gate="tests/system/test_console_bench.py::test_times_are_staged_judged_and_put_in_force")
def test_what_is_being_written_survives_tabs_and_another_operator(browser: Any, url: str, head: FakeDaemon) -> None:
    head.job = {"site": "Elm Street"}
    with page(browser, url, "job") as tab:
        until(lambda: tab.get_by_label("Site").input_value() == "Elm Street")
        tab.get_by_label("Site").fill("Elm Street 7")
        tab.goto(f"{url}#surveys")
        head.job = {"site": "Oak Street", "client": "Gas AG"}
        tab.goto(f"{url}#job")
        tab.wait_for_selector("text=Saved by another meanwhile: Oak Street.")
        assert tab.get_by_label("Site").input_value() == "Elm Street 7"
        until(lambda: tab.get_by_label("Client").input_value() == "Gas AG")
        tab.reload()
        until(lambda: tab.get_by_label("Site").input_value() == "Elm Street 7")
        tab.get_by_role("button", name="Take that").click()
        assert tab.get_by_label("Site").input_value() == "Oak Street"


def test_times_are_staged_judged_and_put_in_force(browser: Any, url: str, head: FakeDaemon) -> None:
    with page(browser, url, "bench") as tab:
        delay = tab.get_by_role("slider", name="Projector, delay")
        until(lambda: delay.input_value() == "3000")
        tab.wait_for_selector("svg.timeline .window")
        delay.focus()
        tab.keyboard.press("ArrowRight")
        tab.wait_for_selector("text=Allowed. Not in force yet.")
        assert asked(head, "lamps")[-1]["lamps"] == {"projector_delay_us": 3050}
        assert asked(head, "lamps")[-1]["commit"] is False
        number = tab.get_by_role("spinbutton", name="LED, width")
        number.fill("20000")
        tab.wait_for_selector("text=in which all rows expose >> visible=true")
        until(lambda: tab.locator("#lamps-commit").is_disabled())
        number.fill("2000")
        tab.wait_for_selector("text=Allowed. Not in force yet.")
        tab.locator("#lamps-commit").click()
        until(lambda: head.lamps["led_width_us"] == 2000 and head.lamps["projector_delay_us"] == 3050)
        tab.wait_for_selector("text=These times are in force.")


@pytest.mark.deep(
    gate="tests/system/test_console_bench.py::test_scans_are_listed_filtered_and_a_report_opens_kept_apart"
)
def test_a_trial_takes_two_steps_is_held_while_it_is_seen_and_ends_with_the_page(
    browser: Any, url: str, head: FakeDaemon
) -> None:
    with page(browser, url, "bench") as tab:
        tab.locator("#trial-on").click()
        tab.get_by_role("dialog").wait_for()
        assert not asked(head, "start")
        tab.keyboard.press("Escape")
        assert not asked(head, "start")
        tab.locator("#trial-on").click()
        tab.locator("#confirm-yes").click()
        until(lambda: asked(head, "start"))
        assert asked(head, "start")[-1]["record"] is False and asked(head, "start")[-1]["hold_s"] == 10
        tab.wait_for_selector("text=held while this page is looked at")
        tab.wait_for_selector("text=of it >> visible=true")
        assert tab.locator(".plot canvas").count() == 1
        until(lambda: asked(head, "hold"))
        tab.goto(f"{url}#job")
        until(lambda: head.state == "idle")
        held = len(asked(head, "hold"))
        time.sleep(3.5)
        assert len(asked(head, "hold")) == held


@pytest.mark.deep(
    gate="tests/system/test_console_bench.py::test_scans_are_listed_filtered_and_a_report_opens_kept_apart"
)
def test_a_burst_is_drawn_and_what_the_controller_refuses_is_said(browser: Any, url: str) -> None:
    with page(browser, url, "bench") as tab:
        tab.wait_for_selector("text=The controller takes it: 50 chips, 11 on, 25 µs.")
        tab.get_by_label("Chip, µs").fill("50")
        tab.wait_for_selector("text=the controller would refuse this: chip 50 us, expected 0.1..30 us")
        tab.get_by_label("Chip, µs").fill("0.5")
        tab.get_by_label("Code", exact=True).select_option("own")
        tab.get_by_label("Chips, 0 and 1").fill("11x")
        tab.wait_for_selector("text=signs 0 and 1")
        tab.get_by_label("Chips, 0 and 1").fill("1101")
        tab.wait_for_selector("text=The controller takes it: 4 chips, 3 on, 2 µs.")


def test_scans_are_listed_filtered_and_a_report_opens_kept_apart(browser: Any, url: str) -> None:
    with page(browser, url, "surveys") as tab:
        tab.wait_for_selector("text=2 of 2, newest first")
        assert "P-<b>1</b>" in tab.locator(".surveys tbody").inner_text()
        assert tab.get_by_text("defects: 1, worst 4.00 mm").is_visible()
        tab.get_by_label("Show those with").fill("elm")
        tab.wait_for_selector("text=1 of 2, newest first")
        with tab.expect_popup() as opened:
            tab.get_by_role("link", name="Open the report of elm-street-results").click()
        report = opened.value
        report.wait_for_selector("text=report drawn")
        until(lambda: report.title() == "kept out")


@pytest.mark.deep(gate="tests/system/test_console_bench.py::test_times_are_staged_judged_and_put_in_force")
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_every_page_is_usable_by_all(browser: Any, url: str, head: FakeDaemon, theme: str) -> None:
    with page(browser, url, "job", theme=theme) as tab:
        for name, ready in (("job", "#job-save"), ("bench", ".timeline .gate"), ("surveys", ".surveys tbody tr")):
            tab.goto(f"{url}#{name}")
            tab.wait_for_selector(ready, state="attached")
            for width in WIDTHS:
                tab.set_viewport_size({"width": width, "height": 900})
                assert tab.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0, (name, width)
                if width == 1400 or (width == 390 and theme == "light"):
                    assert faults(tab) == [], (name, width)
