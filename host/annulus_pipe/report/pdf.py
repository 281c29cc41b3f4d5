"""report.pdf: the page as it prints, tagged, with its own letters.

WeasyPrint lays the page out by its print style. It asks the system for fonts, and a small system has none: then it
draws boxes. matplotlib brings DejaVu Sans, which has every sign that the page uses, so that is what a PDF is set in.
"""

import warnings
from enum import StrEnum
from pathlib import Path
from typing import Any

from annulus_pipe.extras import need


class Paper(StrEnum):
    A4 = "A4"
    LETTER = "letter"


FACES = (("DejaVuSans.ttf", "normal"), ("DejaVuSans-Bold.ttf", "bold"))
DPI = 220  # of pictures: more than they have


def to_pdf(html: str, paper: Paper = Paper.A4) -> bytes:
    """A page of this room as PDF. Raises AnnulusError, one line, where WeasyPrint or what it loads is missing."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "No fonts configured")  # of a system without: the page's are named below
        weasyprint = _weasyprint()
        fonts = weasyprint.text.fonts.FontConfiguration()
        style = weasyprint.CSS(string=_style(paper), font_config=fonts)
        document = weasyprint.HTML(string=html)
        data: bytes = document.write_pdf(stylesheets=[style], font_config=fonts, pdf_tags=True, dpi=DPI)
    return data


def _style(paper: Paper) -> str:
    folder = _fonts()
    faces = "".join(
        f'@font-face {{ font-family: "Page"; src: url("{(folder / name).as_uri()}"); font-weight: {weight}; }}\n'
        for name, weight in FACES
    )
    margins = " ".join(
        f"@{box} {{ font-family: Page; }}" for box in ("top-left", "top-right", "bottom-left", "bottom-right")
    )
    return f"{faces}@page {{ size: {paper}; {margins} }}\nbody {{ font-family: Page, sans-serif; }}\n"


def _fonts() -> Path:
    import matplotlib

    return Path(matplotlib.get_data_path()) / "fonts/ttf"


def check_pdf() -> None:
    """Whether a PDF can be made here, asked before long work. Raises AnnulusError as `to_pdf` does."""
    _weasyprint()


def _weasyprint() -> Any:
    module = need("weasyprint")
    need("weasyprint.text.fonts")
    return module
