"""The certificate of a head: what a gauge study showed, for which head, as it was then, in which pipes, until when.

Numbers are percent of the inner diameter. A certificate speaks for a scan only if head, calibration, firmware,
software, diameter and temperature are those it names: `standing` says so, and says what of them nobody can tell.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import date, timedelta
from pathlib import Path
from typing import Any, TypeVar

from annulus_pipe.numeric.rounding import two_digits_up
from annulus_pipe.qualification.applicability import Applicability, HeadInUse, ScopeCheck
from annulus_pipe.qualification.precision import LIMIT, Interval
from annulus_pipe.qualification.signature import Signature, canonical
from annulus_pipe.untrusted import mapping, number, numbers, parse_json, read_file, shown, text, whole, within
from annulus_pipe.vocabulary import AnnulusError

FORMAT = "annulus-certificate/1"
FILE = "certificate.json"
SIZE_MAX = 4 << 20  # bytes: hundreds of runs take a tenth of it
ROWS_MAX, TEXT_MAX = 5000, 500
DIAMETER_MARGIN = 0.02  # of a diameter, beyond the outermost pieces: pipes of one nominal size differ by as much
YEARS = 2000, 2199  # of a day of issue; what holds from it ends a few years later
UNTIL_YEAR = 2209  # .. and no day of a certificate lies beyond
CLOCKS_APART = timedelta(days=1)  # a job's day is that of where its pipe lies, an issue's is UTC's
KELVIN_MARGIN = 5.0  # K beyond the coldest and warmest run: what thermometers and a pipe's length differ by
Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class CertificateScope:
    """What a certificate is valid for. calibration : its fingerprint. temperature_c : None where runs had none."""

    head: str
    calibration: str
    firmware: str
    software: str
    diameter_mm: tuple[float, float]
    temperature_c: tuple[float, float] | None
    issued: date
    until: date

    def standing(self, use: HeadInUse) -> tuple[Applicability, tuple[str, ...]]:
        """Whether it applies, and why not or what is not known; reasons against it come first."""
        found = ScopeCheck()
        if use.day is None:
            found.unknown.append("the day is not known")
        elif use.day > self.until:
            found.against.append(f"it lapsed on {self.until}")
        elif use.day < self.issued - CLOCKS_APART:
            found.against.append(f"it is of {self.issued}, after the day of the scan")
        found.same("head", self.head, use.head)
        found.same("calibration", self.calibration, use.calibration)
        found.same("firmware", self.firmware, use.firmware)
        found.same("software", self.software, use.software)
        margin = DIAMETER_MARGIN * self.diameter_mm[1]
        found.within("diameter", "mm", self.diameter_mm, margin, use.diameter_mm)
        found.within("temperature", "degC", self.temperature_c, KELVIN_MARGIN, use.temperature_c)
        return found.standing()


@dataclass(frozen=True, slots=True)
class CertifiedPiece:
    """A reference piece and what E691 says of its readings, mm. h, k : of each operator."""

    name: str
    diameter_mm: float
    k2_mm: float
    measured_by: str
    mean_mm: float
    s_r_mm: float
    s_R_mm: float
    h: tuple[float, ...]
    k: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """A contribution of the budget. u : percent of the diameter; share : of u squared; dof : None where infinite."""

    name: str
    u: float
    share: float
    dof: float | None
    kind: str
    source: str


@dataclass(frozen=True, slots=True)
class CertifiedRun:
    """A reading: of which run, whose, of which piece; error : percent. results : the first digits of its
    stations' SHA-256."""

    number: int
    operator: str
    piece: str
    repeat: int
    temperature_c: float | None
    diameter_mm: float
    error: float
    results: str


@dataclass(frozen=True, slots=True)
class Accuracy:
    """What was certified, percent of the diameter.

    U : what a diameter keeps in 19 of 20, bias included, as the study had it; u, dof, k : of its budget. U_drift : the
    same with what the head's optics may drift by until they are used, which the scans state. worst : the largest error
    of a run; worst_direction : of any one station's diameter in any direction.
    """

    bias: Interval
    s_r: Interval
    s_R: Interval
    u: float
    dof: float | None
    k: float
    U: float
    U_drift: float
    worst: float
    worst_direction: float
    per_kelvin: tuple[float, float] | None
    repeat_dof: float


@dataclass(frozen=True, slots=True)
class ProfilerForm:
    """The figures that owners ask laser profilers for (MoDOT TM-84, ASTM F3080): points a picture, the lens, and how
    round a round piece reads. lens : how the camera was calibrated, "" where nobody recorded it."""

    points_per_picture: float
    ovality_percent: float
    lens: str


@dataclass(frozen=True, slots=True)
class Certificate:
    """signature : None of one that nobody has signed yet. left_open : what none of the numbers covers."""

    title: str
    laboratory: str
    scope: CertificateScope
    operators: tuple[str, ...]
    repeats: int
    accuracy: Accuracy
    budget: tuple[BudgetRow, ...]
    pieces: tuple[CertifiedPiece, ...]
    form: ProfilerForm
    runs: tuple[CertifiedRun, ...]
    left_open: tuple[str, ...]
    signature: Signature | None = None

    @property
    def number(self) -> str:
        """What names it: the first digits of its content's SHA-256."""
        return hashlib.sha256(canonical(self.content())).hexdigest()[:12]

    @property
    def is_signed(self) -> bool:
        """Whether it is as whoever signed it left it."""
        return self.signature is not None and self.signature.holds(self.content())

    def statement(self, percent: float) -> str:
        """What a report quotes, one line. percent : U, of a scan that a reference section anchors, or U_drift."""
        bias, *limits = self.accuracy.bias.value, self.accuracy.s_r.value, self.accuracy.s_R.value
        repeatability, reproducibility = (two_digits_up(LIMIT * one) for one in limits)
        return (
            f"diameters keep ± {two_digits_up(percent)} % in 19 of 20, a bias of {bias:+.2g} % in it; "
            f"limits of repeatability {repeatability} %, of reproducibility {reproducibility} %"
        )

    def content(self) -> dict[str, Any]:
        """All of it but the signature, in plain types: what is signed."""
        data = {name: value for name, value in asdict(self).items() if name != "signature"}
        data["scope"] |= {"issued": self.scope.issued.isoformat(), "until": self.scope.until.isoformat()}
        plain: dict[str, Any] = json.loads(json.dumps(data, allow_nan=False))  # tuples become lists, as in the file
        return plain

    def to_dict(self) -> dict[str, Any]:
        signature = None if self.signature is None else self.signature.to_dict()
        return {"format": FORMAT, "number": self.number, "content": self.content(), "signature": signature}

    @classmethod
    def from_dict(cls, data: object) -> "Certificate":
        """Raises ValueError naming the key. Whether it is as it was signed, `is_signed` says."""
        top = mapping(data, "the certificate")
        if top.get("format") != FORMAT:
            raise ValueError(f"its format is {shown(top.get('format'))}, expected {FORMAT}")
        content = mapping(top.get("content"), "content")
        signature = None if top.get("signature") is None else Signature.from_dict(top["signature"])
        made = cls(
            _text(content, "title"),
            _text(content, "laboratory"),
            _scope(mapping(content.get("scope"), "scope")),
            tuple(_texts(content, "operators")),
            whole(content.get("repeats"), "repeats", 2, ROWS_MAX),
            _accuracy(mapping(content.get("accuracy"), "accuracy")),
            tuple(_rows(content, "budget", BudgetRow)),
            tuple(_rows(content, "pieces", CertifiedPiece)),
            _row(mapping(content.get("form"), "form"), "form", ProfilerForm),
            tuple(_rows(content, "runs", CertifiedRun)),
            tuple(_texts(content, "left_open")),
            signature,
        )
        if made.content() != content:  # a name that this version does not know would be under the signature, unread
            raise ValueError("holds what no certificate of this format has")
        return made


def read_certificate(path: Path) -> Certificate:
    """Raises AnnulusError, one line that names the file; also where somebody changed it after it was signed."""
    try:
        return parse_certificate(read_file(path, SIZE_MAX))
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a {FILE}.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}. Expected a {FILE} of `annulus certify issue`.") from None


def parse_certificate(data: bytes) -> Certificate:
    """The same of a file's bytes. Raises ValueError."""
    top = parse_json(data, SIZE_MAX)
    made = Certificate.from_dict(top)
    if made.signature is None:
        raise ValueError("nobody has signed it")
    if not made.is_signed:
        raise ValueError("it is not as it was signed: something in it was changed")
    if top.get("number") != made.number:
        raise ValueError(f"its number is {shown(top.get('number'))}, expected {made.number} by its content")
    return made


def _scope(section: Mapping[str, Any]) -> CertificateScope:
    warm = section.get("temperature_c")
    head, calibration, firmware, software = (
        _text(section, name, f"scope.{name}") for name in ("head", "calibration", "firmware", "software")
    )
    return CertificateScope(
        head,
        calibration,
        firmware,
        software,
        _pair(section.get("diameter_mm"), "scope.diameter_mm", 0.0, 1e5),
        None if warm is None else _pair(warm, "scope.temperature_c", -273.2, 1e3),
        _day(section, "issued"),
        _day(section, "until"),
    )


def _accuracy(section: Mapping[str, Any]) -> Accuracy:
    slope, dof = section.get("per_kelvin"), section.get("dof")

    def percent(name: str) -> float:
        return within(section.get(name), f"accuracy.{name}", 0.0, 1e6)

    def interval(name: str) -> Interval:
        part = mapping(section.get(name), f"accuracy.{name}")
        return Interval(*(number(part.get(end), f"accuracy.{name}.{end}") for end in ("value", "low", "high")))

    return Accuracy(
        bias=interval("bias"),
        s_r=interval("s_r"),
        s_R=interval("s_R"),
        u=percent("u"),
        dof=None if dof is None else within(dof, "accuracy.dof", 0.0, 1e12),
        k=percent("k"),
        U=percent("U"),
        U_drift=percent("U_drift"),
        worst=percent("worst"),
        worst_direction=percent("worst_direction"),
        per_kelvin=None if slope is None else _pair(slope, "accuracy.per_kelvin", -1e3, 1e3, rising=False),
        repeat_dof=within(section.get("repeat_dof"), "accuracy.repeat_dof", 0.0, 1e12),
    )


def _rows(content: Mapping[str, Any], name: str, kind: type[Row]) -> list[Row]:
    rows = content.get(name)
    if not isinstance(rows, list) or len(rows) > ROWS_MAX:
        raise ValueError(f"{name} must be a list of at most {ROWS_MAX}")
    return [_row(mapping(row, f"{name}[{i}]"), f"{name}[{i}]", kind) for i, row in enumerate(rows)]


def _row(section: Mapping[str, Any], what: str, kind: type[Row]) -> Row:
    """A record of texts, numbers, whole numbers and tuples of numbers, by its fields' types."""
    readers: Mapping[Any, Callable[[Any, str], Any]] = {
        str: lambda value, name: text(value, name, TEXT_MAX),
        int: lambda value, name: whole(value, name, 0, 1 << 31),
        float: lambda value, name: number(value, name, 1e9),
        float | None: lambda value, name: None if value is None else number(value, name, 1e12),
        tuple[float, ...]: lambda value, name: numbers(value, name, range(ROWS_MAX), 1e9),
    }
    values = {
        field.name: readers[field.type](section.get(field.name), f"{what}.{field.name}")
        for field in fields(kind)  # type: ignore[arg-type]
    }
    return kind(**values)


def _pair(value: object, what: str, low: float, high: float, *, rising: bool = True) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{what} is {shown(value)}, expected two numbers")
    first, last = (within(one, what, low, high) for one in value)
    if rising and last < first:
        raise ValueError(f"{what} ends at {last:g}, before it begins at {first:g}")
    return first, last


def _day(section: Mapping[str, Any], name: str) -> date:
    value = _text(section, name, f"scope.{name}")
    try:
        day = date.fromisoformat(value)
    except ValueError:
        raise ValueError(f"scope.{name} is {shown(value)}, expected a day, YYYY-MM-DD") from None
    if not YEARS[0] <= day.year <= UNTIL_YEAR:
        raise ValueError(f"scope.{name} is {shown(value)}, expected a year in {YEARS[0]}..{UNTIL_YEAR}")
    return day


def _text(section: Mapping[str, Any], name: str, what: str = "") -> str:
    return text(section.get(name), what or name, TEXT_MAX)


def _texts(content: Mapping[str, Any], name: str) -> Sequence[str]:
    rows = content.get(name)
    if not isinstance(rows, list) or len(rows) > ROWS_MAX:
        raise ValueError(f"{name} must be a list of at most {ROWS_MAX} texts")
    return [text(one, f"{name}[{i}]", TEXT_MAX) for i, one in enumerate(rows)]
