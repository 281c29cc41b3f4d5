"""What Sphinx is told of this checkout: pages that are a room's README, pages that are generated, links between files.

A page is included by a line `<!-- include: PATH -->`, PATH from the root of the checkout; what is generated comes in
place of `<!-- generated: NAME -->`, a made picture in place of `<!-- picture: FILE WORDS -->`. Links in any of them are
those of the checkout: one to a file that is a page leads to that page, one to another file becomes its words alone,
since the manual is read without a checkout. `[[name]]` leads to the page of that name in the same folder, and is a word
where there is none.
"""

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tools.manual import commands, docstrings, families, hardware, pictures, settings, topics

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
INCLUDE = re.compile(r"^<!-- include: (\S+) -->$", re.M)
GENERATED = re.compile(r"^<!-- generated: (\S+) -->$", re.M)
PICTURE = re.compile(r"^<!-- picture: (\S+) (.+) -->$", re.M)  # one of pictures.py, and what it shows
OPTIONAL = re.compile(r"^\S+\*$", re.M)  # in a toctree: pages that may not be there
CODE = re.compile(r"(`[^`]*`)")
BESIDE = re.compile(r"\[\[([a-z-]+)\]\]")
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^()\s]+)\)")
FENCE = re.compile(r"^(```|~~~|:::)")

GENERATORS: Mapping[str, Callable[[], str]] = {
    "commands": commands.page,
    "settings": settings.page,
    "hardware-parts": hardware.parts,
    "hardware-times": hardware.times,
    "topics": topics.page,
    "messages": families.page,
}


@cache
def pages() -> Mapping[Path, Path]:
    """Which page of docs/ a file of the checkout is: itself, or the page that includes it."""
    found = {}
    for page in sorted(DOCS.rglob("*.md")):
        found[page] = page
        for name in INCLUDE.findall(page.read_text(encoding="utf-8")):
            found[ROOT / name] = page
    return found


def included(page: Path) -> str:
    """A page's Markdown with the files it includes. Raises ValueError for a link that leads nowhere."""
    text = relinked(page.read_text(encoding="utf-8"), page, page)
    return INCLUDE.sub(lambda m: relinked((ROOT / m[1]).read_text(encoding="utf-8"), ROOT / m[1], page), text)


def whole(page: Path) -> str:
    """The same with what is generated. Raises ValueError where that cannot be made."""
    text = included(page)
    text = PICTURE.sub(lambda m: f"![{m[2]}]({os.path.relpath(pictures.FOLDER / m[1], page.parent)})", text)
    text = OPTIONAL.sub(lambda m: m[0] if any(DOCS.glob(m[0] + ".md")) else "", text)
    text = GENERATED.sub(lambda m: relinked(GENERATORS[m[1]](), page, page), text)
    siblings = sorted(other.stem for other in page.parent.glob("*.md") if other != page)
    if page.name == "README.md" and siblings:  # a folder's README leads to its pages
        text += "\n```{toctree}\n:hidden:\n" + "\n".join(siblings) + "\n```\n"
    return text


def relinked(text: str, source: Path, page: Path) -> str:
    """`text`, that stands in `source`, with the links it needs as a part of `page`. Fenced code stays as it is."""
    lines, fence = [], ""
    for line in text.split("\n"):
        mark = FENCE.match(line.lstrip())
        if mark and mark[1] != ":::" and fence in ("", mark[1]):
            fence = "" if fence else mark[1]
        lines.append(line if fence else _linked(line, source, page))
    return "\n".join(lines)


def _beside(name: str, page: Path) -> str:
    return f"[{name}]({name}.md)" if page.with_name(f"{name}.md").exists() else name


def _linked(line: str, source: Path, page: Path) -> str:
    beside = [
        part if i % 2 else BESIDE.sub(lambda m: _beside(m[1], page), part) for i, part in enumerate(CODE.split(line))
    ]
    return LINK.sub(lambda m: _link(m, source, page), "".join(beside))


def _link(match: re.Match[str], source: Path, page: Path) -> str:
    image, words, target = match.groups()
    if target.startswith("#") or re.match(r"\w+:", target):
        return match[0]
    name, _, anchor = target.partition("#")
    path = Path(os.path.normpath(source.parent / name))
    if not path.exists():
        raise ValueError(f"{source.relative_to(ROOT)}: [{words}]({target}) leads nowhere")
    if image:
        return f"![{words}]({os.path.relpath(path, page.parent)})"
    to = pages().get(path) or pages().get(path / "README.md")
    if to is None:
        return words
    return f"[{words}]({os.path.relpath(to, page.parent)}{'#' + anchor if anchor else ''})"


def setup(app: Any) -> dict[str, bool]:
    """Sphinx's door."""

    def read(app: Any, docname: str, source: list[str]) -> None:
        page = Path(app.env.doc2path(docname))
        for name in INCLUDE.findall(source[0]):
            app.env.note_dependency(str(ROOT / name))
        source[0] = whole(page)

    def docstring(app: Any, what: str, name: str, of: object, options: object, lines: list[str]) -> None:
        lines[:] = docstrings.told_apart(lines)

    def signature(app: Any, what: str, name: str, of: object, *_: object) -> tuple[str, None] | None:
        return ("", None) if what == "class" and is_dataclass(of) else None  # its fields follow

    app.connect("autodoc-process-docstring", docstring, priority=400)  # before napoleon reads it
    app.connect("autodoc-process-signature", signature)
    app.connect("builder-inited", lambda _: pictures.make())
    app.connect("builder-inited", lambda _: hardware.make())
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
