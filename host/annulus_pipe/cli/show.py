"""What every command needs to speak to a person or a program: a progress bar, --json, fields one a line."""

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from typing import Annotated, Any, Protocol

import typer

from annulus_pipe.cli.terminal import as_it_is
from annulus_pipe.controller import CHIP_MAX_TICKS, CHIP_MIN_TICKS, TICKS_PER_US

Port = Annotated[str, typer.Option(help="Serial port of the controller: /dev/ttyACM0, a pty, socket://host:port.")]
ChipUs = Annotated[
    float,
    typer.Option(min=CHIP_MIN_TICKS / TICKS_PER_US, max=CHIP_MAX_TICKS / TICKS_PER_US, help="Length of a chip, us."),
]
Json = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]

SAID_S = 0.2  # between two lines of one kind of progress


class Bars(StrEnum):
    """How progress is told on stderr."""

    BAR = "bar"
    JSON = "json"


def verbs(help: str = "") -> typer.Typer:
    """Of a noun. help : what it is about, where that does not stand beside its name already (`hooks.Noun`)."""
    return typer.Typer(help=help, no_args_is_help=True)


@contextmanager
def progress(how: Bars = Bars.BAR) -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on stderr, or lines of JSON, fed with (what, done, total)."""
    if how is Bars.JSON:
        yield _lines()
        return
    begun: list[Any] = []  # nothing is drawn, or imported for it, before there is some progress
    tasks: dict[str, Any] = {}

    def report(what: str, done: int, total: int) -> None:
        if not begun:
            begun.append(_drawn())
            begun[0].start()
        if what not in tasks:
            tasks[what] = begun[0].add_task(what, total=total)
        begun[0].update(tasks[what], completed=done, total=total)

    try:
        yield report
    finally:
        for bars in begun:
            bars.stop()


def _drawn() -> Any:
    from rich import progress as rich
    from rich.console import Console

    columns = (
        rich.TextColumn("{task.description:<24}"),
        rich.BarColumn(),
        rich.MofNCompleteColumn(),
        rich.TimeRemainingColumn(),
    )
    return rich.Progress(*columns, console=Console(file=as_it_is(sys.stderr)))


def _lines() -> Callable[[str, int, int], None]:
    """The first, the last, and now and then one between."""
    shown: dict[str, float] = {}

    def report(what: str, done: int, total: int) -> None:
        now = time.monotonic()
        if done >= total or now - shown.get(what, -SAID_S) >= SAID_S:
            shown[what] = now
            tell(json.dumps({"what": what, "done": done, "total": total}))

    return report


class CheckedRow(Protocol):
    """A row of what was looked at; `ok` None: there is nothing to be right or wrong."""

    @property
    def what(self) -> str: ...
    @property
    def ok(self) -> bool | None: ...
    @property
    def text(self) -> str: ...


def print_findings(found: Sequence[CheckedRow], as_json: bool) -> None:
    """Rows as a table, or as JSON. Status 1 where one is wrong."""
    if as_json:
        print(json.dumps([{"what": one.what, "ok": one.ok, "text": one.text} for one in found]))
    else:
        for one in found:
            print(f"{ {True: 'ok', False: 'NOT OK', None: '-'}[one.ok]:<8}{one.what:<14}{one.text}")
    if any(one.ok is False for one in found):
        raise typer.Exit(1)


def tell(line: str) -> None:
    """A remark for who waits, not part of the answer."""
    print(line, file=sys.stderr, flush=True)


def print_fields(fields: dict[str, object], as_json: bool) -> None:
    if as_json:
        print(json.dumps(fields))
        return
    for name, value in fields.items():
        print(f"{name:<22} {value}")
