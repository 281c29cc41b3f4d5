"""Nouns of the command line, each imported when one of its verbs is asked for: to list them takes a name and a line.

With all of them imported and built `annulus --help` took twice as long, and so did the start of every other command.
"""

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_group

from annulus_pipe.hooks import nouns

CORE = {  # and what `--help` says of it
    "head": "Talk to one controller: configure, arm, fire a burst, turn the turntable.",
    "calibrate": "Measure the head: camera, rings, colours. Every answer goes into one calibration.json.",
    "reference": "A piece of pipe of known diameter: whether the head still measures it right, and what has drifted.",
    "pattern": "The projector's pattern.",
    "certify": "What a head's diameters are worth: a gauge study on reference pieces of pipe, and its certificate.",
    "pod": "What a head detects: defects to machine, what became of them in a survey, probability of detection.",
    "archive": "Surveys of many pipes over the years: a catalogue of them, and questions to it.",
    "firmware": "Look at the controller's firmware, put it on a board, watch what it says.",
    "selftest": "A second Pico plays camera, encoder and interlock to the controller, and times its outputs.",
    "twin": "The simulated head.",
    "record": "Recordings: what is in one, whether it is whole, its labels said again; "
    "to and from pictures and videos.",
}


def add_nouns(app: typer.Typer) -> None:
    """The core's and the wings'; where a wing names a noun that is there, its verbs come behind those."""
    modules, about = {name: [f"annulus_pipe.cli.{name}"] for name in CORE}, dict(CORE)
    for name, noun in nouns():
        modules.setdefault(name, []).append(noun.module)
        about.setdefault(name, noun.about)
    for name, its in modules.items():
        app.add_typer(typer.Typer(cls=_group(its), help=about[name], no_args_is_help=True), name=name)


def _group(modules: list[str]) -> type[TyperGroup]:
    """With the verbs of each module's `app`, a typer.Typer."""

    class Late(TyperGroup):
        def list_commands(self, ctx: Any) -> list[str]:
            self._load()
            return super().list_commands(ctx)

        def get_command(self, ctx: Any, cmd_name: str) -> Any:
            self._load()
            return super().get_command(ctx, cmd_name)

        def _load(self) -> None:
            for module in () if self.commands else modules:
                its: typer.Typer = import_module(module).app
                its.rich_markup_mode = self.rich_markup_mode  # help is plain text, whatever a wing's app was made with
                self.commands.update(get_group(its).commands)

    return Late
