"""`annulus docs`: the manual that comes with the program."""

import os
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.vocabulary import AnnulusError


def docs(
    topic: Annotated[
        str | None,
        typer.Argument(
            help="Page, or a part of its name: first-scan, commands, head-toml. The first page if not given."
        ),
    ] = None,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open it in a browser.")] = True,
    print_path: Annotated[
        bool, typer.Option("--print-path", help="Print only where the page lies; open nothing.")
    ] = False,
) -> None:
    """Open the manual. It comes with the program and needs no network."""
    from annulus_pipe.shipped import MANUAL, shipped

    page = _page(shipped(MANUAL), topic)
    print(page)
    if open_page and not print_path and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        webbrowser.open(page.absolute().as_uri())


def _page(manual: Path, topic: str | None) -> Path:
    if topic is None:
        return manual / "index.html"
    pages = sorted(
        path
        for path in manual.rglob("*.html")
        if not path.is_relative_to(manual / "_static") and path.stem not in ("genindex", "search", "py-modindex")
    )
    names = {path.relative_to(manual).with_suffix("").as_posix().removeprefix("manual/"): path for path in pages}
    wanted = topic.lower().removesuffix(".html")
    exact = [path for name, path in names.items() if wanted in (name.lower(), name.rpartition("/")[2].lower())]
    if len(exact) == 1:
        return exact[0]
    near = {name: path for name, path in names.items() if wanted in name.lower()}
    if len(near) == 1:
        return next(iter(near.values()))
    raise AnnulusError(f"the manual has no one page {topic}, expected one of {', '.join(near or _usual(names))}")


def _usual(names: dict[str, Path]) -> list[str]:
    return [name for name in names if "/" not in name]
