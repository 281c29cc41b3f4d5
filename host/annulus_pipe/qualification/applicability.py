"""Whether what a file states of a head speaks for a scan: of the same head as it then was, in such a pipe."""

from dataclasses import dataclass, field
from datetime import date
from enum import StrEnum

from annulus_pipe.untrusted import printable


class Applicability(StrEnum):
    """Whether a certificate or a study speaks for a scan, or for a head as it is."""

    APPLIES = "applies"
    OPEN = "cannot be told"
    DOES_NOT = "does not apply"


@dataclass(frozen=True, slots=True)
class HeadInUse:
    """What a scan or a machine says of the head that is used; "" or None: it does not say. day : of the scan."""

    head: str = ""
    calibration: str = ""
    firmware: str = ""
    software: str = ""
    diameter_mm: float | None = None
    temperature_c: float | None = None
    day: date | None = None


@dataclass(slots=True)
class ScopeCheck:
    """What speaks against a file, and what of it nobody can tell, one reason each."""

    against: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)

    def same(self, what: str, stated: str, used: str) -> None:
        """stated : by the file."""
        if not stated or not used:
            who = "it does not say" if not stated else "the scan does not say"
            self.unknown.append(f"{who} which {what}" + (f" ({printable(stated)})" if stated else ""))
        elif stated != used:
            self.against.append(f"it is of {what} {printable(stated)}, and this is {printable(used)}")

    def within(
        self, what: str, unit: str, reach: tuple[float, float] | None, margin: float, value: float | None
    ) -> None:
        """reach : what the file's runs had; it holds by `margin` beyond."""
        if reach is None or value is None:
            who = "its runs have no" if reach is None else "the scan has no"
            self.unknown.append(f"{who} {what}" + ("" if reach is None else f" ({reach[0]:g} to {reach[1]:g} {unit})"))
        elif not reach[0] - margin <= value <= reach[1] + margin:
            self.against.append(
                f"it holds from {reach[0] - margin:.4g} to {reach[1] + margin:.4g} {unit}, and the {what} is "
                f"{value:.4g} {unit}"
            )

    def standing(self) -> tuple[Applicability, tuple[str, ...]]:
        """With the reasons; those against come first."""
        verdict = Applicability.APPLIES
        if self.against or self.unknown:
            verdict = Applicability.DOES_NOT if self.against else Applicability.OPEN
        return verdict, (*self.against, *self.unknown)
