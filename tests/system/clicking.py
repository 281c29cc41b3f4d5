"""A console as people have it, and its page in Debian's chromium."""

import contextlib
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

RUN = [sys.executable, "-c", "from annulus_pipe.cli import main; main()"]


@contextlib.contextmanager
def console(head: Any, surveys: Path) -> Iterator[str]:
    """Its address."""
    where = ["--daemon", f"{head.publish},{head.control}", "--port", "0", "--surveys", str(surveys)]
    child = subprocess.Popen([*RUN, "console", *where], stderr=subprocess.PIPE, text=True)
    assert child.stderr is not None
    try:
        said = ""
        for line in child.stderr:
            said += line
            if found := re.search(r"http://\S+", line):
                break
        else:
            raise AssertionError(said)
        threading.Thread(target=child.stderr.read, daemon=True).start()
        yield found[0]
    finally:
        child.terminate()
        child.wait(60.0)


@contextlib.contextmanager
def page(browser: Any, url: str, tab: str, width: int = 1400, theme: str = "light") -> Iterator[Any]:
    context = browser.new_context(viewport={"width": width, "height": 900}, locale="en", color_scheme=theme)
    opened = context.new_page()
    opened.set_default_timeout(30_000)
    wrong: list[str] = []
    asked: list[str] = []
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.on("request", lambda request: asked.append(request.url))
    opened.goto(f"{url}#{tab}")
    opened.wait_for_selector("body[data-link=live]")
    try:
        yield opened
        assert not wrong
        assert not [one for one in asked if not one.startswith((url, "data:", "blob:", url.replace("http", "ws")))]
    finally:
        context.close()


def until(what: Callable[[], object], seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.02)


def asked(head: Any, do: str) -> list[dict[str, Any]]:
    return [one for one in list(head.asked) if one["do"] == do]
