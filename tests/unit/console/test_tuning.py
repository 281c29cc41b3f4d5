"""Promises of tuning from the page: two steps before lamps, watched, given up, and over with the page that asked."""

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from browsing import Browser, status, wait_for

from annulus_pipe.console import program as room
from annulus_pipe.console.program import Program
from annulus_pipe.vocabulary import AnnulusError

STATUS = 1  # the kind of a message


class Driver:
    """In place of the daemon's: goes on until it is let go, or given up."""

    def __init__(self) -> None:
        self.go, self.error, self.asked = False, "", []

    def tune(self, client: Any, publish: str, lamp: str, *, keys: Any, progress: Any, cancelled: Any) -> Any:
        from annulus_pipe.daemon.tuning import Cancelled

        self.asked.append((client.address, publish, lamp, client._who.name))
        progress("waiting for frames", 0, 10)
        while not self.go:
            if cancelled():
                raise Cancelled("tune: cancelled")
            time.sleep(0.01)
        if self.error:
            raise AnnulusError(self.error)
        return SimpleNamespace(
            proposed={f"{lamp}_delay_us": 2100.0, f"{lamp}_width_us": 9000.0}, remarks=["opens 2000"]
        )


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    driver = Driver()
    monkeypatch.setattr("annulus_pipe.daemon.tuning.tune", driver.tune)
    return driver


def begin(console: Browser, lamp: str = "led") -> Any:
    return console.post("/api/tune", {"lamp": lamp, "confirm": console.post("/api/arm").json()["confirm"]})


def heard(view: Any, enough: Callable[[Any], bool]) -> Any:
    for _ in range(500):
        message = view.receive_bytes()
        topic, body = status(message) if message[0] == STATUS else ("", {})
        if topic == "tune" and enough(body):
            return body
    raise AssertionError("not told")


def test_what_is_proposed_is_told_to_all(console: Browser, driver: Driver, program: Program) -> None:
    with console.view() as view:
        assert begin(console).status_code == 200
        assert heard(view, lambda body: body["state"] == "running")["lamp"] == "led"
        assert begin(console).status_code == 409
        driver.go = True
        body = heard(view, lambda body: body["state"] == "done")
    assert body["proposed"] == {"led_delay_us": 2100.0, "led_width_us": 9000.0} and body["remarks"] == ["opens 2000"]
    ((control, publish, lamp, name),) = driver.asked
    assert (control, publish, lamp) == (program.daemon.control, program.daemon.publish, "led") and name


def test_lamps_take_a_second_step_and_a_page_that_sees_them(console: Browser, driver: Driver) -> None:
    assert begin(console).status_code == 409  # no page is open
    with console.view():
        assert console.post("/api/tune", {"lamp": "led"}).status_code == 403
        assert begin(console, "sun").status_code == 400
        assert console.post("/api/tune/cancel").status_code == 409
    assert not driver.asked


def test_it_is_given_up_by_a_press(console: Browser, driver: Driver) -> None:
    with console.view() as view:
        begin(console)
        heard(view, lambda body: body["state"] == "running")
        assert console.post("/api/tune/cancel").status_code == 200
        heard(view, lambda body: body["state"] == "cancelled")


def test_it_is_over_when_the_page_is_gone(
    console: Browser, driver: Driver, program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room, "ANSWERS_S", 0.5)
    told = []
    monkeypatch.setattr(program.live, "latest", lambda topic, body: told.append(body) if topic == "tune" else None)
    with console.view():
        begin(console)
        wait_for(lambda: driver.asked)
    wait_for(lambda: told and told[-1]["state"] == "cancelled")


def test_why_nothing_is_proposed_is_said(console: Browser, driver: Driver) -> None:
    driver.error, driver.go = "tune: the picture is dark\nat all delays", True
    with console.view() as view:
        begin(console)
        assert heard(view, lambda body: body["state"] == "failed")["error"].startswith("tune: the picture is dark")
