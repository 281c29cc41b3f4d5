"""Debian's chromium by Playwright, and axe-core: readers of our pages that are not ours."""

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


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
    """What axe-core finds wrong, of any kind, and what it cannot decide; the contrast of text within a drawing, which
    it does not decide, is measured here against what is behind it."""
    import axe_core_python

    tab.evaluate(next(Path(axe_core_python.__file__).parent.rglob("axe.min.js")).read_text(encoding="utf-8"))
    found = tab.evaluate("axe.run(document, {resultTypes: ['violations', 'incomplete']})")
    nodes = [
        (one["id"], node["html"])
        for kind in ("violations", "incomplete")
        for one in found[kind]
        for node in one["nodes"]
        if not (kind == "incomplete" and one["id"] == "color-contrast" and node["html"].startswith("<text"))
    ]
    out = [f"{name}: {html[:120]}" for name, html in nodes]
    drawn = tab.evaluate(_DRAWN)
    return out + [f"text in a drawing: {ink} on {paper}" for ink, paper in drawn if _contrast(ink, paper) < 4.5]


# [fill, the paper behind it] of every text in a drawing
_DRAWN = """[...new Set([...document.querySelectorAll('svg text')].map((text) => {
  let at = text;
  while (at && /^(transparent|rgba\\(.*, 0\\))$/.test(getComputedStyle(at).backgroundColor)) at = at.parentElement;
  const paper = at ? getComputedStyle(at).backgroundColor : 'rgb(255, 255, 255)';
  return JSON.stringify([getComputedStyle(text).fill, paper]);
}))].map((one) => JSON.parse(one))"""


def _contrast(ink: str, paper: str) -> float:
    """WCAG's, of two "rgb(r, g, b)"."""
    light, dark = sorted((_luminance(ink), _luminance(paper)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def _luminance(colour: str) -> float:
    parts = [int(part) / 255 for part in re.findall(r"\d+", colour)[:3]]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
