"""unity.json: a study of digs as a file, written whole and read with suspicion. Neither needs more than numpy."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from annulus_pipe.qualification.digs import Dig, DugKind
from annulus_pipe.qualification.line import StraightLine
from annulus_pipe.qualification.matching import SurveyPlace
from annulus_pipe.qualification.sizing import Sizing
from annulus_pipe.qualification.unity import Dug, DugPlace, NextDig, ToolClaim, Unity
from annulus_pipe.qualification.validation import ClaimJudgement, Proportion
from annulus_pipe.untrusted import mapping, number, one_line, parse_json, printable, read_file, shown, whole, within
from annulus_pipe.untrusted import text as raw_text
from annulus_pipe.vocabulary import AnnulusError

FORMAT = "annulus-unity/1"
FILE = "unity.json"
BYTES_MAX, LIST_MAX, TEXT_MAX, MM_MAX = 1 << 24, 10_000, 500, 1e9
DIG_SIZES = ("depth_mm", "depth_u_mm", "length_mm", "width_mm")


def to_dict(unity: Unity) -> dict[str, Any]:
    """The study as JSON has it: null where nothing can be told."""
    return {
        "format": FORMAT,
        "source": unity.source,
        "digs": unity.digs,
        "statement": unity.statement(),
        "claim": {
            "certainty": unity.claim.certainty,
            "basis": unity.claim.basis,
            "tolerances": [{"kind": kind, "tolerance_mm": _plain(mm)} for kind, mm in unity.claim.tolerances],
        },
        "shift_mm": unity.shift_mm,
        "shift_basis": unity.shift_basis,
        "judgement": unity.judgement.to_dict(),
        "sizing": unity.sizing.to_dict(),
        "line": None if unity.line is None else asdict(unity.line),
        "confirmed": unity.confirmed.to_dict(),
        "identified": unity.identified.to_dict(),
        "rows": [_plain(asdict(row)) for row in unity.rows],
        "next_digs": [_plain(asdict(one)) for one in unity.next_digs],
        "remarks": list(unity.remarks),
    }


def read_unity(path: Path) -> Unity:
    """A study's file. Raises AnnulusError, one line, for what is none."""
    try:
        return from_dict(mapping(parse_json(read_file(path, BYTES_MAX), BYTES_MAX), "unity"))
    except OSError as error:
        raise AnnulusError(f"{path}: {error.strerror or error}. Expected a file of `annulus unity`.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {one_line(str(error))}. Expected a file of `annulus unity`.") from None


def from_dict(found: Mapping[str, Any]) -> Unity:
    """Raises ValueError, one line. Nothing is judged again: a file is quoted as it was written."""
    if found.get("format") != FORMAT:
        raise ValueError(f"its format is {shown(found.get('format'))}, expected {FORMAT}")
    claim, line = mapping(found.get("claim"), "claim"), found.get("line")
    return Unity(
        _text(found, "source"),
        _text(found, "digs"),
        ToolClaim(
            within(claim.get("certainty"), "certainty", 0, 1),
            tuple(_tolerance(mapping(one, "a tolerance")) for one in _list(claim, "tolerances")),
            _text(claim, "basis"),
        ),
        number(found.get("shift_mm"), "shift_mm", MM_MAX),
        _text(found, "shift_basis"),
        tuple(_row(mapping(one, "a row")) for one in _list(found, "rows")),
        ClaimJudgement.from_dict(mapping(found.get("judgement"), "judgement")),
        Sizing.from_dict(mapping(found.get("sizing"), "sizing")),
        None if line is None else _line(mapping(line, "line")),
        Proportion.from_dict(mapping(found.get("confirmed"), "confirmed")),
        Proportion.from_dict(mapping(found.get("identified"), "identified")),
        tuple(_next(mapping(one, "a next dig")) for one in _list(found, "next_digs")),
        tuple(printable(raw_text(one, "a remark", TEXT_MAX)) for one in _list(found, "remarks")),
    )


def _tolerance(found: Mapping[str, Any]) -> tuple[str, float]:
    return _text(found, "kind"), _mm(found, "tolerance_mm")


def _row(found: Mapping[str, Any]) -> DugPlace:
    dig, place = mapping(found.get("dig"), "dig"), found.get("place")
    return DugPlace(
        Dig(
            whole(dig.get("line"), "line", 0, LIST_MAX),
            _text(dig, "name"),
            DugKind(_text(dig, "kind")),
            number(dig.get("z_mm"), "z_mm", MM_MAX),
            within(dig.get("clock_deg"), "clock_deg", -360.0, 360.0),
            *(_mm(dig, name) for name in DIG_SIZES),
        ),
        Dug(_text(found, "outcome")),
        None if place is None else _place(mapping(place, "place")),
        _maybe(found, "same_kind"),
        _mm(found, "error_mm"),
        _mm(found, "tolerance_mm"),
        _maybe(found, "within"),
    )


def _place(found: Mapping[str, Any]) -> SurveyPlace:
    return SurveyPlace(
        _text(found, "name"),
        _text(found, "kind"),
        number(found.get("z_mm"), "z_mm", MM_MAX),
        within(found.get("clock_deg"), "clock_deg", -360.0, 360.0),
        _mm(found, "length_mm"),
        _mm(found, "arc_deg"),
        _mm(found, "depth_mm"),
        _mm(found, "depth_k2_mm"),
        found.get("at_least") is True,
        found.get("undecided") is True,
    )


def _next(found: Mapping[str, Any]) -> NextDig:
    place = _place(mapping(found.get("place"), "place"))
    return NextDig(place, within(found.get("remains"), "remains", 0.0, 1.0), found.get("new_kind") is True)


def _line(found: Mapping[str, Any]) -> StraightLine:
    def value(name: str) -> float:
        return number(found.get(name), f"line.{name}", MM_MAX)

    return StraightLine(
        whole(found.get("n"), "n", 0, LIST_MAX),
        value("confidence"),
        value("intercept_mm"),
        value("intercept_k_mm"),
        value("slope"),
        value("slope_k"),
        value("scatter"),
        found.get("is_unity") is True,
    )


def _list(found: Mapping[str, Any], name: str) -> Sequence[Any]:
    value = found.get(name)
    if not isinstance(value, list) or len(value) > LIST_MAX:
        raise ValueError(f"{name} must be a list of at most {LIST_MAX}")
    return value


def _text(found: Mapping[str, Any], name: str) -> str:
    return printable(raw_text(found.get(name), name, TEXT_MAX))


def _mm(found: Mapping[str, Any], name: str) -> float:
    value = found.get(name)
    return math.nan if value is None else number(value, name, MM_MAX)


def _maybe(found: Mapping[str, Any], name: str) -> bool | None:
    value = found.get(name)
    if value is not None and not isinstance(value, bool):
        raise ValueError(f"{name} is {shown(value)}, expected true, false or null")
    return value


def _plain(value: Any) -> Any:
    """With null for NaN, all the way down."""
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value
