"""A page of a result: one HTML document, no script, no font and no picture from anywhere else; prints on A4."""

import base64
from collections.abc import Mapping
from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup


def sheet(template: str, pictures: Mapping[str, bytes], **values: Any) -> str:
    """The template of this package, filled; `picture[name]` are the PNGs, inline."""
    here = resources.files("annulus.report")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    inline = {
        name: f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}" for name, data in pictures.items()
    }
    style = Markup(here.joinpath("style.css").read_text(encoding="utf-8"))
    text = here.joinpath(template).read_text(encoding="utf-8")
    return environment.from_string(text).render(picture=inline, style=style, **values)
