"""What commands say of report.pdf."""

from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from annulus_pipe.report import Paper


class PaperSize(StrEnum):
    A4 = "A4"
    LETTER = "letter"


def on_paper(wanted: bool, paper: PaperSize) -> "Paper | None":
    """The paper of a PDF where one is wanted. Asks for what makes it before the work begins: AnnulusError, one line."""
    if not wanted:
        return None
    from annulus_pipe.report import Paper, check_pdf

    check_pdf()
    return Paper(paper.value)
