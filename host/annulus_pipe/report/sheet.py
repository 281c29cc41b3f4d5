"""A page of a result: one HTML document, no script, no font and no picture from anywhere else; prints on any paper.

All pages share `base.html.j2` (landmarks, header, running lines of the print) and `style.css`. Templates say numbers
with `numeric.rounding` only: its functions are filters here, `{{ depth|quoted(MEASURE, k2) }}`.
"""

import base64
from collections.abc import Mapping
from datetime import datetime
from functools import cache
from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup

from annulus_pipe.numeric import rounding

QUANTITIES = ("DISTANCE", "MEASURE", "EXTENT", "AREA", "ANGLE", "ARC", "PERCENT", "SHARE")
PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 .,:;/_-()+")


def sheet(template: str, pictures: Mapping[str, bytes], /, **values: Any) -> str:
    """The template of this package, filled; `picture[name]` are the PNGs, inline."""
    return (
        _environment()
        .get_template(template)
        .render(
            picture={name: inline(data) for name, data in pictures.items()}, style=Markup(_read("style.css")), **values
        )
    )


def inline(png: bytes) -> str:
    """A PNG as an address that needs no file."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def minute(iso: str) -> str:
    """A time for people: 2026-11-25 08:15 UTC."""
    return f"{datetime.fromisoformat(iso):%Y-%m-%d %H:%M} UTC"


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        loader=jinja2.FunctionLoader(_template),
    )
    environment.globals.update({name: getattr(rounding, name) for name in QUANTITIES})
    environment.filters.update(
        quoted=_unbroken, digits=rounding.digits, off=rounding.off, clock=rounding.clock_face, css=_css_string
    )
    environment.globals["span"] = rounding.span
    return environment


def _template(name: str) -> str | None:
    """PACKAGE/NAME, of another room's; NAME alone is one of the report's own."""
    package, _, own = name.rpartition("/")
    here = resources.files(package or "annulus_pipe.report").joinpath(own)
    return here.read_text(encoding="utf-8") if here.is_file() else None


def _read(name: str) -> str:
    return resources.files("annulus_pipe.report").joinpath(name).read_text(encoding="utf-8")


def _css_string(text: str) -> Markup:
    """Any text as a string of CSS, harmless inside a style element too."""
    return Markup('"{}"').format(Markup("".join(c if c in PLAIN else f"\\{ord(c):06x}" for c in text)))


def _unbroken(value: float | None, quantity: rounding.Quantity, k2: float | None = None) -> str:
    """As `rounding.quoted`, no line ending between a number and its unit."""
    return rounding.quoted(value, quantity, k2).replace(" ", "\u00a0")
