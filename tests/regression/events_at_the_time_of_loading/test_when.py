"""The page showed every event with the time at which it was loaded, and each twice when it connected again."""

import json
import re
import shutil
import subprocess
import time
from pathlib import Path

import pytest

import annulus_pipe.console
from annulus_pipe.console.feed import Feed
from annulus_pipe.console.hub import Hub, Viewer
from annulus_pipe.console.live import Live

STATIC = Path(annulus_pipe.console.__file__).with_name("static")
# As much of a document as a list needs, and the page's own module run in it.
PAGE = """
class Place {
  constructor(tag) { this.tag = tag; this.children = []; this.dataset = {}; this.text = ""; this.hidden = false; }
  setAttribute(name, value) { if (name.startsWith("data-")) this.dataset[name.slice(5)] = String(value); }
  addEventListener() {}
  removeAttribute() {}
  append(...more) { for (const one of more) typeof one === "string" ? (this.text += one) : this.children.push(one); }
  prepend(one) { this.children.unshift(one); }
  insertBefore(one, other) {
    const at = other === null ? this.children.length : this.children.indexOf(other);
    this.children.splice(at, 0, one);
  }
  get lastElementChild() { return { remove: () => this.children.pop() }; }
  get textContent() { return this.text + this.children.map((one) => one.textContent).join(""); }
}
globalThis.document = { createElement: (tag) => new Place(tag) };
const hears = {};
const app = { t: (key) => key, language: "en", on: (topic, hear) => { hears[topic] = hear; } };
const list = events(app).children[1];
for (const [topic, body] of SAID) hears[topic](body);
const lines = list.children.map((one) => [one.children[0].textContent, one.text.trim()]);
console.log(JSON.stringify([lines, new Date(NOON * 1000).toLocaleTimeString([], { hour12: false })]));
"""


class Silent(Feed):
    """A daemon's words without a daemon."""

    def __init__(self) -> None:
        pass


def told(live: Live) -> list[dict[str, object]]:
    """What a page that comes now is told."""
    viewer = Viewer()
    live.welcome(viewer)
    said = []
    while (message := viewer.take()) is not None:
        if message[0] == 1:
            said.append(json.loads(message[1:]))
    return said


def test_who_comes_later_is_told_when_it_happened() -> None:
    live = Live(Silent(), Hub())
    live.feed.on_word("event", {"kind": "link", "text": "of a daemon that says when", "utc_s": 1.7e9}, b"")
    before = time.time()
    live.feed.on_word("event", {"kind": "link", "text": "of one that does not"}, b"")
    after = time.time()
    time.sleep(0.05)
    first, second = (one["body"]["utc_s"] for one in told(live))  # type: ignore[index]
    assert first == 1.7e9 and before <= second <= after


def test_the_page_shows_each_once_at_its_own_time_in_their_order() -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs Debian's nodejs")
    noon = time.mktime((*time.localtime()[:3], 12, 0, 0, 0, 0, -1))
    events = [["event", {"kind": "link", "text": f"the {k}th", "utc_s": noon + 60 * k}] for k in range(4)]
    said = [["ended", {"seconds": 5.0, "utc_s": noon + 90}], *events, *events, ["mark", {"text": "nobody knows when"}]]
    modules = [(STATIC / name).read_text(encoding="utf-8") for name in ("dom.js", "rounding.js", "events.js")]
    own = re.sub(r"^import .*$|^export ", "", "\n".join(modules), flags=re.MULTILINE)
    program = f"const NOON = {noon}, SAID = {json.dumps(said)};\n{own}\n{PAGE}"
    ran = subprocess.run([node], input=f"{{{program}}}", capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    lines, midday = json.loads(ran.stdout)
    texts = [text for _, text in lines]
    assert texts == ["events.mark: nobody knows when", "the 3th", "the 2th", "events.ended", "the 1th", "the 0th"]
    assert lines[-1][0] == midday and lines[0][0] == "unknown"
