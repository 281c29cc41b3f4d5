"""What a report may state of a head: the words of its certificate and of its study of detection, and of nothing else.

quoted = Qualification(certificate, study).quoted(use, anchored=False)
quoted.accuracy.text        # "diameters keep ± 0.13 % ..", or "not established: .."
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from annulus_pipe.qualification.applicability import Applicability, HeadInUse
from annulus_pipe.qualification.certificate import Certificate, parse_certificate, read_certificate
from annulus_pipe.qualification.pod import Detectability, read_pod
from annulus_pipe.qualification.signature import canonical
from annulus_pipe.qualification.trials import KINDS

Read = TypeVar("Read")

NOTHING = "not established"
DETECTION = "probability of detection, of identification, sizes of defects, false calls"


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
    """accuracy : of diameters; percent : what they keep in 19 of 20, None where that is not established. detection : of
    each kind of defect that was laid, and of false calls; of none where nothing was."""

    accuracy: Quotation = field(default_factory=Quotation)
    percent: float | None = None
    detection: tuple[tuple[str, Quotation], ...] = ((DETECTION, Quotation()),)

    def to_dict(self) -> dict[str, Any]:
        return {
            "accuracy": self.accuracy.to_dict() | {"percent": self.percent},
            "detection": [{"of": what} | one.to_dict() for what, one in self.detection],
        }

    @property
    def rows(self) -> tuple[tuple[str, Quotation], ...]:
        """All of them, by what they are of."""
        return (("diameters", self.accuracy), *self.detection)


@dataclass(frozen=True, slots=True)
class Qualification:
    """The files that a head has."""

    certificate: Certificate | None = None
    pod: Detectability | None = None

    @classmethod
    def read(cls, certificate: Path | None = None, pod: Path | None = None) -> "Qualification":
        """Raises AnnulusError, one line, for a file that is none, or a certificate that was changed."""
        return cls(
            None if certificate is None else read_certificate(certificate), None if pod is None else read_pod(pod)
        )

    @classmethod
    def recorded(cls, data: object) -> "Qualification":
        """As a recording's configuration has it, whoever wrote it: none of what was changed or is malformed."""
        found = data if isinstance(data, Mapping) else {}
        return cls(
            _unless_wrong(lambda: parse_certificate(canonical(found["certificate"]))),
            _unless_wrong(lambda: Detectability.from_dict(found["pod"])),
        )

    def to_dict(self) -> dict[str, Any]:
        """For a recording's configuration."""
        files = {"certificate": self.certificate, "pod": self.pod}
        return {name: file.to_dict() for name, file in files.items() if file is not None}

    def over(self, other: "Qualification") -> "Qualification":
        """Itself, and of the other what it lacks."""
        return Qualification(self.certificate or other.certificate, self.pod or other.pod)

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
        stated = QuotedStatements()
        if self.certificate is not None:
            scope, accuracy = self.certificate.scope, self.certificate.accuracy
            whose = f" of {self.certificate.laboratory}" if self.certificate.laboratory else ""
            source = f"certificate {self.certificate.number}{whose}, {scope.issued} to {scope.until}"
            percent = accuracy.U if anchored else accuracy.U_drift
            quoted = _quotation(self.certificate.statement(percent), source, scope.standing(use))
            applies = quoted.standing is not Applicability.DOES_NOT
            stated = replace(stated, accuracy=quoted, percent=percent if applies else None)
        if self.pod is not None:
            study, standing = self.pod, self.pod.standing(use)
            source = (
                f"study of detection of {study.created[:10]}, {len(study.pulls)} pull{'s' * (len(study.pulls) != 1)}"
            )
            lines = [(f"detection of {kind}", "; ".join(study.statement(kind))) for kind in KINDS]
            lines.append(("false calls", study.false_calls.statement().removeprefix("false calls: ")))
            stated = replace(
                stated, detection=tuple((what, _quotation(text, source, standing)) for what, text in lines)
            )
        return stated


def _quotation(text: str, source: str, standing: tuple[Applicability, tuple[str, ...]]) -> Quotation:
    """None of the numbers where they do not apply."""
    verdict, reasons = standing
    return Quotation(f"{NOTHING}: {reasons[0]}" if verdict is Applicability.DOES_NOT else text, source, *standing)


def _unless_wrong(read: Callable[[], Read]) -> Read | None:
    try:
        return read()
    except (ValueError, TypeError, LookupError):
        return None
