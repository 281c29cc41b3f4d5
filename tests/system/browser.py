"""Debian's chromium by Playwright, and axe-core: readers of our pages that are not ours."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip


@contextmanager
def chromium() -> Iterator[Any]:
    """The browser; skips where Debian's package is not installed."""
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("needs Debian's chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(QUIET))
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(browser: Any, page: Path, width: int) -> Iterator[tuple[Any, list[str]]]:
    """A page in a window so wide, and all that it asked for besides itself."""
    tab = browser.new_page(viewport={"width": width, "height": 900})
    asked: list[str] = []
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(page.as_uri())
    try:
        yield tab, [url for url in asked if not url.startswith("data:") and url != page.as_uri()]
    finally:
        tab.close()


def faults(tab: Any) -> list[str]:
    """What axe-core finds wrong, of any kind, and what it cannot decide."""
    import axe_core_python

    tab.evaluate(next(Path(axe_core_python.__file__).parent.rglob("axe.min.js")).read_text(encoding="utf-8"))
    found = tab.evaluate("axe.run(document, {resultTypes: ['violations', 'incomplete']})")
    return [
        f"{one['id']}: {one['nodes'][0]['html'][:120]}" for kind in ("violations", "incomplete") for one in found[kind]
    ]
