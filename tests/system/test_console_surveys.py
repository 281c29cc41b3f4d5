"""Promise: a scan is reconstructed again from the page, watched, given up with nothing left of it; its report opens."""

import subprocess
import sys
from pathlib import Path

import pytest
from browser import chromium
from clicking import RUN, console, page, until

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests/unit/console"))

from fake_daemon import FakeDaemon  # noqa: E402

pytestmark = pytest.mark.deep(
    gate="tests/unit/console/test_surveys.py::test_a_reconstruction_is_watched_and_lies_beside_its_scan"
)


def test_a_real_reconstruction_is_watched_and_given_up(tmp_path: Path) -> None:
    shelf = tmp_path / "scans"
    shelf.mkdir()
    subprocess.run([*RUN, "twin", "scan", "-o", str(shelf / "oak"), "--frames", "6"], check=True, capture_output=True)
    with FakeDaemon() as head, console(head, shelf) as url, chromium() as browser, page(browser, url, "surveys") as tab:
        tab.get_by_role("button", name="Reconstruct oak").click()
        tab.get_by_role("dialog").get_by_role("button", name="Reconstruct").click()
        until(lambda: list(shelf.glob(".oak.*.part")))
        tab.get_by_role("button", name="Cancel the reconstruction of oak").click()
        tab.wait_for_selector("text=cancelled; nothing of it is left")
        assert {path.name for path in shelf.iterdir()} == {"oak"}
        tab.get_by_role("button", name="Reconstruct oak").click()
        tab.get_by_role("dialog").get_by_role("button", name="Reconstruct").click()
        tab.wait_for_selector("text=done: oak-results", timeout=60_000)
        with tab.expect_popup() as opened:
            tab.get_by_role("link", name="Open the report of oak-results").click()
        opened.value.wait_for_selector("text=152.4")
