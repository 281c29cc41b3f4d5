"""What a report may state of a head: the words of its certificate and of its study of detection, and of nothing else.

quoted = Qualification(certificate, study).quoted(use, anchored=False)
quoted.accuracy.text        # "diameters keep ± 0.13 % ..", or "not established: .."
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from annulus_pipe.qualification.certificate import (
    Applicability,
    Certificate,
    HeadInUse,
    parse_certificate,
    read_certificate,
)
from annulus_pipe.qualification.signature import canonical

NOTHING = "not established"


@dataclass(frozen=True, slots=True)
class Quotation:
    """A statement, whose it is, and whether it speaks for where it is quoted; without a file there is neither."""

    text: str = NOTHING
    source: str = ""
    standing: Applicability | None = None
    reasons: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        return {
            "text": self.text,
            "source": self.source or None,
            "standing": None if self.standing is None else str(self.standing),
            "reasons": list(self.reasons),
        }

    @property
    def line(self) -> str:
        """All of it in one line."""
        open_points = f" (if it is so: {'; '.join(self.reasons)})" if self.standing is Applicability.OPEN else ""
        return f"{self.text}{open_points}" + (f" [{self.source}]" if self.source else "")


@dataclass(frozen=True, slots=True)
class QuotedStatements:
    """accuracy : of diameters; percent : what they keep in 19 of 20, None where that is not established."""

    accuracy: Quotation = field(default_factory=Quotation)
    percent: float | None = None

    def to_dict(self) -> dict[str, Any]:
        return {"accuracy": self.accuracy.to_dict() | {"percent": self.percent}}


@dataclass(frozen=True, slots=True)
class Qualification:
    """The files that a head has."""

    certificate: Certificate | None = None

    @classmethod
    def read(cls, certificate: Path | None) -> "Qualification":
        """Raises AnnulusError, one line, for a file that is none or was changed."""
        return cls(None if certificate is None else read_certificate(certificate))

    @classmethod
    def recorded(cls, data: object) -> "Qualification":
        """As a recording's configuration has it, whoever wrote it: none of what was changed or is malformed."""
        found = data.get("certificate") if isinstance(data, Mapping) else None
        try:
            return cls(None if found is None else parse_certificate(canonical(found)))
        except (ValueError, TypeError):
            return cls()

    def to_dict(self) -> dict[str, Any]:
        """For a recording's configuration."""
        return {} if self.certificate is None else {"certificate": self.certificate.to_dict()}

    def over(self, other: "Qualification") -> "Qualification":
        """Itself, and of the other what it lacks."""
        return Qualification(self.certificate or other.certificate)

    def state(self, use: HeadInUse) -> tuple[Applicability | None, str]:
        """For who looks at a head before a scan: whether its certificate speaks for it today, one line."""
        if self.certificate is None:
            return None, f"none: reports say {NOTHING!r} of what diameters keep"
        standing, reasons = self.certificate.scope.standing(use)
        named = f"{self.certificate.number}, until {self.certificate.scope.until}"
        if standing is Applicability.APPLIES:
            return standing, named
        return standing, f"{named}: {standing}: {'; '.join(reasons)}"

    def quoted(self, use: HeadInUse, *, anchored: bool) -> QuotedStatements:
        """What a report of such a scan states. anchored : a reference section in the scan says what drifted."""
        if self.certificate is None:
            return QuotedStatements()
        certificate, accuracy = self.certificate, self.certificate.accuracy
        standing, reasons = certificate.scope.standing(use)
        whose = f" of {certificate.laboratory}" if certificate.laboratory else ""
        scope = certificate.scope
        source = f"certificate {certificate.number}{whose}, {scope.issued} to {scope.until}"
        if standing is Applicability.DOES_NOT:
            return QuotedStatements(Quotation(f"{NOTHING}: {reasons[0]}", source, standing, reasons))
        percent = accuracy.U if anchored else accuracy.U_drift
        return QuotedStatements(Quotation(certificate.statement(percent), source, standing, reasons), percent)
