"""The console's page as people meet it: in Debian's chromium, before a daemon that only talks. It is looked at in three
widths, light and dark; run by keys alone; and it must say within 2 s that what it shows is no longer live.

Where $ANNULUS_SCREENS names a folder, every screen is left there as a picture.
"""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import chromium, faults
from fake_daemon import FakeDaemon

pytestmark = pytest.mark.alone

WIDTHS = (1400, 1024, 390)
THEMES = ("light", "dark")
STATES = ("idle", "scanning", "fault", "lost")  # of the scan's page; of the others the first
TABS = ("scan", "job", "bench", "surveys")
LOST_S = 2.0
STALL_S = 0.1  # a machine that stood still for longer keeps no promise in seconds
LATENCY_MS = 100.0  # 95 of 100 pictures, from published to drawn, with the wall in 3-D beside them
TOUCH_PX = 44
POINTS_MAX = 5_000_000


@dataclass
class Console:
    """A console of its own process, and the daemon it listens to."""

    head: FakeDaemon
    process: "subprocess.Popen[str]"
    url: str
    asked: list[str] = field(default_factory=list)  # by any page: URLs
    wrong: list[str] = field(default_factory=list)  # said at any page's terminal

    def foreign(self) -> list[str]:
        own = self.url.split("//")[1]
        return [url for url in self.asked if re.sub(r"^\w+://", "", url)[: len(own)] != own and url[:5] != "data:"]


@pytest.fixture(scope="module")
def console() -> Iterator[Console]:
    with FakeDaemon(fps=25.0) as head:
        process = subprocess.Popen(
            [
                sys.executable,
                "-c",
                "from annulus_pipe.cli import main; main()",
                "console",
                "--port",
                "0",
                "--daemon",
                f"{head.publish},{head.control}",
            ],
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stderr is not None
            said = re.search(r"http://[\d.:]+/", process.stderr.readline())
            assert said
            yield Console(head, process, said[0])
        finally:
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGINT)
            process.wait(10.0)
            process.stderr.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as one:
        yield one


@pytest.fixture
def page(console: Console, browser: Any) -> Iterator[Any]:
    """A page on the idle head; nothing it asks of others, and nothing it complains of, stays unsaid."""
    with at(console, browser) as tab:
        yield tab
    console.head.silent = False


class at:
    """A page, opened: `with at(console, browser, width=390) as tab:`."""

    def __init__(
        self,
        console: Console,
        browser: Any,
        tab: str = "scan",
        width: int = 1400,
        theme: str = "light",
        language: str = "en",
        touch: bool = False,
    ) -> None:
        self.console, self.tab = console, tab
        self.context = browser.new_context(
            viewport={"width": width, "height": 900},
            color_scheme=theme,
            locale=language,
            has_touch=touch,
            reduced_motion="reduce",
        )

    def __enter__(self) -> Any:
        page = self.context.new_page()
        page.on("request", lambda request: self.console.asked.append(request.url))
        page.on("websocket", lambda socket: self.console.asked.append(socket.url))
        page.on("pageerror", lambda error: self.console.wrong.append(str(error)))
        page.on("console", lambda said: said.type == "error" and self.console.wrong.append(said.text))
        page.goto(f"{self.console.url}#{self.tab}")
        page.wait_for_selector(f"#page-{self.tab}:not([hidden])")
        until(page, "document.body.dataset.link === 'live'")
        return page

    def __exit__(self, *_: object) -> None:
        self.context.close()


def put(console: Console, state: str, why: str = "") -> None:
    """The head into a state, as if somebody had asked for it, or it had happened."""
    head = console.head
    if state == "scanning" and head.state == "idle":
        head.index, head.z_mm, head.scan = 0, 0.0, head.scan + 1
    head.state = state
    head.extra.append(("state", {"state": state, "why": why}, b""))


def until(page: Any, what: str, seconds: float = 30.0) -> None:
    """Playwright's own way wants `eval`, which the page's content policy refuses."""
    end = time.monotonic() + seconds
    while not page.evaluate(what):
        assert time.monotonic() < end, f"not within {seconds:g} s: {what}"
        page.wait_for_timeout(20)


def wait_for_state(page: Any, state: str, seconds: float = 30.0) -> None:
    until(page, f"document.getElementById('state').dataset.state === '{state}'", seconds)


def pictures(page: Any) -> None:
    """Until ring and LED light, points and the map were drawn."""
    until(page, "window.annulus.stats.pictures > 8 && window.annulus.stats.points > 20000", 10.0)
    page.wait_for_timeout(600)


def kept(page: Any, name: str) -> None:
    if folder := os.environ.get("ANNULUS_SCREENS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        page.screenshot(path=Path(folder) / f"{name}.png", full_page=True)


@pytest.mark.deep(
    gate="tests/system/test_console_page.py::test_whatever_is_pressed_on_a_tablet_is_large_enough_for_a_finger"
)
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("theme", THEMES)
def test_no_screen_has_a_fault_or_is_wider_than_its_window(
    console: Console, browser: Any, width: int, theme: str
) -> None:
    wrong: list[str] = []
    for tab in TABS:
        states = STATES if tab == "scan" else STATES[:1]
        put(console, "idle")
        with at(console, browser, tab, width, theme) as page:
            for state in states:
                name = f"{tab}-{state}-{width}-{theme}"
                if state == "lost":
                    console.head.silent = True
                    wait_for_state(page, "lost-daemon")
                else:
                    put(console, state, "the camera is gone" if state == "fault" else "")
                    wait_for_state(page, state)
                if state == "scanning":
                    pictures(page)
                kept(page, name)
                wide = page.evaluate("document.documentElement.scrollWidth")
                wrong += [f"{name}: {wide} px wide"] if wide > width else []
                wrong += [f"{name}: {fault}" for fault in faults(page)]
            console.head.silent = False
    put(console, "idle")
    assert wrong == []


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("width", WIDTHS[1:])
def test_whatever_is_pressed_on_a_tablet_is_large_enough_for_a_finger(
    console: Console, browser: Any, width: int
) -> None:
    put(console, "scanning")
    with at(console, browser, width=width, touch=True) as page:
        pictures(page)
        small = page.evaluate(
            """(least) => [...document.querySelectorAll("button, select, input, nav a")]
              .filter((one) => one.offsetParent !== null && one.type !== "checkbox")
              .map((one) => [one.outerHTML.slice(0, 90), one.getBoundingClientRect()])
              .filter(([, box]) => Math.min(box.width, box.height) < least)
              .map(([html, box]) => `${box.width.toFixed(0)} x ${box.height.toFixed(0)}: ${html}`)""",
            TOUCH_PX,
        )
    put(console, "idle")
    assert small == []


def pressed(page: Any, key: str, until: str, most: int = 60) -> None:
    """Tab, or another key, until what has the focus has that id."""
    for _ in range(most):
        if page.evaluate("document.activeElement?.id") == until:
            return
        page.keyboard.press(key)
    raise AssertionError(f"{until} is not reached by {key}")


def test_a_scan_is_begun_by_keys_alone_and_only_by_the_second_of_two_different_presses(
    console: Console, page: Any
) -> None:
    head = console.head
    put(console, "idle")
    wait_for_state(page, "idle")
    head.asked.clear()
    pressed(page, "Tab", "do-start")
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") != "none"  # it is seen where one is
    page.keyboard.press("Enter")
    page.wait_for_selector("dialog[open] #confirm-yes")
    page.keyboard.press("Enter")  # the same key once more: the safe answer has the focus
    page.wait_for_selector("dialog[open]", state="detached")
    assert [one["do"] for one in head.asked if one["do"] == "start"] == []
    pressed(page, "Tab", "do-start")
    page.keyboard.press("Enter")
    page.wait_for_selector("dialog[open] #confirm-yes")
    page.keyboard.press("Escape")
    page.wait_for_selector("dialog[open]", state="detached")
    assert [one["do"] for one in head.asked if one["do"] == "start"] == []
    pressed(page, "Tab", "do-start")
    page.keyboard.press("Enter")
    page.wait_for_selector("dialog[open] #confirm-yes")
    pressed(page, "Tab", "confirm-yes")
    page.keyboard.press("Enter")
    wait_for_state(page, "scanning")
    assert [one["do"] for one in head.asked if one["do"] == "start"] == ["start"]
    assert head.state == "scanning"
    pressed(page, "Tab", "do-stop")
    page.keyboard.press("Enter")
    page.wait_for_selector("dialog[open] #confirm-yes")
    pressed(page, "Tab", "confirm-yes")
    page.keyboard.press("Enter")
    wait_for_state(page, "idle")
    assert head.state == "idle"


@pytest.mark.deep(
    gate="tests/system/test_console_page.py::test_a_scan_is_begun_by_keys_alone_and_only_by_the_second_of_two_different_presses"
)
def test_a_page_that_hears_no_more_of_the_daemon_says_so_within_2_s(console: Console, page: Any, stalls: Any) -> None:
    put(console, "scanning")
    pictures(page)
    assert page.locator(".picture.stale").count() == 0
    console.head.silent = True
    since = time.monotonic()
    wait_for_state(page, "lost-daemon")
    took, stood_still = time.monotonic() - since, stalls.since(since)
    until(page, "document.querySelectorAll('.picture.stale').length === 2")
    console.head.silent = False
    wait_for_state(page, "scanning")
    put(console, "idle")
    assert took <= LOST_S or stood_still > STALL_S


@pytest.mark.deep(
    gate="tests/system/test_console_page.py::test_a_scan_is_begun_by_keys_alone_and_only_by_the_second_of_two_different_presses"
)
def test_a_page_that_hears_no_more_of_the_console_says_so_within_2_s_and_finds_it_again(
    console: Console, page: Any, stalls: Any
) -> None:
    put(console, "scanning")
    pictures(page)
    console.process.send_signal(signal.SIGSTOP)
    since = time.monotonic()
    try:
        wait_for_state(page, "lost-console")
        took, stood_still = time.monotonic() - since, stalls.since(since)
    finally:
        console.process.send_signal(signal.SIGCONT)
    wait_for_state(page, "scanning")
    put(console, "idle")
    assert took <= LOST_S or stood_still > STALL_S


@pytest.mark.deep(
    gate="tests/system/test_console_page.py::test_a_scan_is_begun_by_keys_alone_and_only_by_the_second_of_two_different_presses"
)
def test_pictures_are_drawn_in_time_while_the_wall_grows_in_3d(console: Console, page: Any) -> None:
    put(console, "idle")
    put(console, "scanning")
    pictures(page)
    page.evaluate("Object.assign(window.annulus.stats, {latencyMs: [], withSlitsMs: [], drawn: 0})")
    page.locator(".cloud canvas").scroll_into_view_if_needed()
    page.wait_for_timeout(4000)
    stats = page.evaluate("window.annulus.stats")
    put(console, "idle")
    shown = stats["latencyMs"] + stats["withSlitsMs"]
    late = float(np.percentile(shown, 95))
    assert stats["renderer"]
    assert len(shown) > 4 * 15
    assert 5 <= stats["drawn"] <= 80  # slices, of ten pictures a second at most
    assert late <= LATENCY_MS, f"{late:.0f} ms, drawn by {stats['renderer']}"


def test_five_million_points_are_held_and_what_comes_anew_takes_their_place_at_once(page: Any) -> None:
    told = page.evaluate(
        """async (most) => {
          const {Chunks} = await import("/static/chunks.js");
          const {PointsMaterial} = await import("/static/vendor/three/three.module.min.js");
          const chunks = new Chunks(most, new PointsMaterial());
          const n = 30011;
          const xyz = new Float32Array(3 * n).map((_, i) => i);
          const rgb = new Uint8Array(3 * n).fill(9);
          let added = 0;
          while (chunks.add(xyz, rgb)) added += n;
          const full = chunks.held;
          let drawn = chunks.begin(200000);
          const first = drawn;
          for (let more = chunks.more(200000); more > 0; more = chunks.more(200000)) {
            drawn += more;
            if (more > 200000) return "a slice is too large";
          }
          const whole = chunks.begin(1e9);
          chunks.stage();
          chunks.add(xyz, rgb);
          const kept = chunks.held;
          chunks.shift();
          const {position} = chunks.shown[0].all.geometry.attributes;
          const last = position.array[3 * n - 1];
          return {added, full, first, drawn, whole, kept, held: chunks.held, begin: chunks.begin(1e9), last};
        }""",
        POINTS_MAX,
    )
    assert told["full"] == POINTS_MAX
    assert POINTS_MAX - 30011 <= told["added"] <= POINTS_MAX
    assert 50_000 <= told["first"] <= 200_000
    assert told["whole"] == POINTS_MAX
    assert POINTS_MAX <= told["drawn"] <= 1.05 * POINTS_MAX  # one in forty twice
    assert told["kept"] == POINTS_MAX
    assert told["held"] == told["begin"] == 30011
    assert told["last"] == 3 * 30011 - 1


@pytest.mark.deep(
    gate="tests/system/test_console_page.py::test_whatever_is_pressed_on_a_tablet_is_large_enough_for_a_finger"
)
def test_an_observation_goes_out_with_its_clock_position_and_a_photograph_that_is_small_enough(
    console: Console, page: Any, tmp_path: Path
) -> None:
    rng = np.random.default_rng(18)
    cv2.imwrite(str(tmp_path / "photo.png"), rng.integers(0, 255, (1500, 2000, 3), np.uint8))  # as hard as can be
    put(console, "scanning")
    wait_for_state(page, "scanning")
    console.head.asked.clear()
    form = page.locator("form.mark")
    form.locator("input[required]").fill("crack <b>here</b>")
    form.locator("select").select_option("105")
    form.locator("input[type=file]").set_input_files(tmp_path / "photo.png")
    form.locator("button").click()
    page.wait_for_selector(".events li.mark", timeout=5000)
    put(console, "idle")
    (mark,) = [one for one in console.head.asked if one["do"] == "mark"]
    assert mark["text"] == "crack <b>here</b>"
    assert mark["clock_deg"] == 105
    assert mark["photo"][:2] == b"\xff\xd8"
    assert len(mark["photo"]) <= 48 << 10
    assert "crack <b>here</b>" in page.inner_text(".events")
    assert page.locator(".events b").count() == 0


@pytest.mark.deep(
    gate="tests/system/test_console_page.py::test_a_scan_is_begun_by_keys_alone_and_only_by_the_second_of_two_different_presses"
)
def test_every_word_of_the_page_is_of_the_language_chosen(console: Console, browser: Any) -> None:
    put(console, "scanning")
    with at(console, browser, language="de-DE") as page:
        pictures(page)
        assert page.get_attribute("html", "lang") == "de"
        text = page.inner_text("body")
    put(console, "idle")
    assert not re.findall(r"\b(?:scan|state|next|do|head|map|cloud|counts|pictures)\.[a-z]+\b", text)


@pytest.mark.deep(
    gate="tests/system/test_console_page.py::test_a_scan_is_begun_by_keys_alone_and_only_by_the_second_of_two_different_presses"
)
def test_no_page_asked_anything_of_another_machine_or_complained(console: Console) -> None:
    """Of all pages of this file; the last one."""
    assert len(console.asked) > 100
    assert console.foreign() == []
    assert console.wrong == []
