"""The five hooks by which the core asks the wings, methods beside the rings that each have a folder of their own.

A wing is a package in `wings`, which finds them. Whichever of these functions stand in its `__init__` are all that the
core knows of it, and none costs an import before it is called (so no module of a wing may have such a name):

    1  opens(scan, calibration, by) -> WingJob | None     a scan that is this wing's to measure; None: it is not
       measured(job, executor, place, out, context, ..) -> WingResults  to its result files
    2  watches(config, observers) -> None                 a companion of a running head, among its observers
    3  adds(survey, scan, profiles) -> Survey             what a scan's recording says beside the frames
       sheet(survey) -> Sheet | None                      that, drawn for the report
    4  worlds() -> {name: seed -> World}                  pipes and heads of the twin
       lights() -> {name: type}                           what a world may hold: projectors, the ground around a pipe
    5  app() -> {name: Noun}                              a noun of its own, or more verbs of one that is there

How each is used: docs/ARCHITECTURE.md, "A wing". The core imports this module and no wing (`lint-imports`).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from types import ModuleType
from typing import Any, NamedTuple, Protocol, TypeVar

from annulus_pipe.vocabulary import AnnulusError

Pipe = TypeVar("Pipe")


class Sheet(NamedTuple):
    """A part of the report. title : above it. picture : PNG. shows : the picture in words. note : below it, with a
    full stop. summary : of summary.json, by key."""

    title: str
    picture: bytes
    shows: str
    note: str
    summary: Mapping[str, Any]


class Noun(NamedTuple):
    """Of the command line. module : whose `app`, a typer.Typer, has its verbs; imported when one is asked for. about :
    what `--help` says of it; of no use where the noun is another's."""

    module: str
    about: str = ""


class WingJob(Protocol):
    """A scan that a wing opened. refuses : options of a command that do not go with it, and with what they do not."""

    @property
    def scan(self) -> Any: ...

    @property
    def refuses(self) -> Mapping[str, str]: ...


class WingContext(Protocol):
    """What results carry beside what was measured: source, as a person named the scan; origin, job.Origin; limits of a
    verdict, wall.conformity.Criteria or None."""

    @property
    def source(self) -> str: ...

    @property
    def origin(self) -> Any: ...

    @property
    def limits(self) -> Any: ...


class WingResults(NamedTuple):
    """summary : as summary.json has it. lines : for people, before where the report lies; None: those of any survey.
    ranges, made : how many windows of the scan were measured apart, and how many of them now."""

    summary: Mapping[str, Any]
    lines: Sequence[str] | None = None
    ranges: int = 0
    made: int = 0


def _wings() -> Sequence[ModuleType]:
    found: Sequence[ModuleType] = import_module("annulus_pipe.wings").found()  # by name: nothing here stands on them
    return found


def _those_with(hook: str) -> Iterator[Callable[..., Any]]:
    return (getattr(wing, hook) for wing in _wings() if hasattr(wing, hook))


def opened(scan: Any, calibration: Any = None, by: str = "") -> tuple[WingJob, Callable[..., WingResults]] | None:
    """The job of the wing whose the scan is, and what measures it; None where it is rings'. Raises AnnulusError as the
    wing does, one line."""
    for wing in _wings():
        job = wing.opens(scan, calibration, by) if hasattr(wing, "opens") else None
        if job is not None:
            return job, wing.measured
    return None


def watch(config: Any, observers: Any) -> None:
    for hook in _those_with("watches"):
        hook(config, observers)


def added(survey: Pipe, scan: Any, profiles: Any) -> Pipe:
    for hook in _those_with("adds"):
        survey = hook(survey, scan, profiles)
    return survey


def sheets(survey: Any) -> tuple[Sheet, ...]:
    return tuple(one for hook in _those_with("sheet") if (one := hook(survey)) is not None)


def merged(hook: str) -> dict[str, Any]:
    """`worlds` or `lights` of all wings. Raises AnnulusError where two have one name."""
    out: dict[str, Any] = {}
    for each in _those_with(hook):
        for name, one in each().items():
            if name in out:
                raise AnnulusError(f"wings: two have {name!r} among their {hook}, expected a name of its own")
            out[name] = one
    return out


def nouns() -> Iterator[tuple[str, Noun]]:
    """`app` of all wings: several may have verbs of one noun."""
    return (pair for each in _those_with("app") for pair in each().items())
