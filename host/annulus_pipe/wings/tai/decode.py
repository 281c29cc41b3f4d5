"""Coded records to what one pulse would have given; the template file."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.controller import CODES
from annulus_pipe.link.codes import pattern, text
from annulus_pipe.untrusted import parse_json, read_file
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, load_acoustic, save_acoustic
from annulus_pipe.wings.tai.measure.sweep import Sweep
from annulus_pipe.wings.tai.measure.templates import TAPS_MAX, Template, decode, decode_pair, design

FORMAT = "annulus-template/1"
SIZE_MAX = 1 << 20  # bytes of a template file
# times: another code that makes so much sharper peaks is what was really sent. Guards:
# test_a_record_that_names_the_wrong_code_is_heard_out, test_another_code_than_was_asked_for_is_heard
SHARPER = 1.5


def save_template(path: Path, template: Template, chip_s: float) -> None:
    path.write_text(json.dumps(template_to_dict(template, chip_s), indent=1) + "\n")


def template_to_dict(template: Template, chip_s: float) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "pattern": template.code,
        "template": [float(tap) for tap in template.taps],
        "psr": template.psr,
        "gain_db": template.gain_db,
        "ceiling_db": template.ceiling_db,
        "peak": template.peak,
        "taps_spacing_chips": template.spacing,
        "delay_chips": template.delay,
        "guard_chips": template.guard_chips,
        "method": template.method,
        "chip_us": 1e6 * chip_s,
    }


def load_template(path: Path) -> Template:
    """Raises AnnulusError naming the key that is wrong."""
    try:
        data = parse_json(read_file(path, SIZE_MAX), SIZE_MAX)
    except FileNotFoundError:
        raise AnnulusError(f"{path}: no such file") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}") from None
    if not isinstance(data, Mapping) or data.get("format") != FORMAT:
        raise AnnulusError(f'{path}: expected "format": "{FORMAT}", as `annulus burst design -o` writes')
    try:
        chips = pattern(str(data["pattern"]))
        taps = np.array(data["template"], float)
        numbers = {
            key: float(data[key])
            for key in ("psr", "gain_db", "ceiling_db", "taps_spacing_chips", "delay_chips", "guard_chips")
        }
        peak = int(data["peak"])
    except (KeyError, TypeError, ValueError) as error:
        raise AnnulusError(f"{path}: {error} is missing or no number") from None
    if taps.ndim != 1 or not 1 <= len(taps) <= TAPS_MAX or not np.isfinite(taps).all():
        raise AnnulusError(f"{path}: template must be 1..{TAPS_MAX} finite numbers")
    if not (
        0 < numbers["taps_spacing_chips"] <= 1 and 0 <= numbers["delay_chips"] < 1e4 and math.isfinite(numbers["psr"])
    ):
        raise AnnulusError(f"{path}: taps_spacing_chips, delay_chips or psr is out of range")
    return Template(
        text(chips),
        taps,
        numbers["taps_spacing_chips"],
        peak,
        np.zeros(0),
        numbers["psr"],
        numbers["gain_db"],
        numbers["ceiling_db"],
        numbers["guard_chips"],
        data.get("method", "minimax"),
        numbers["delay_chips"],
    )


def decode_file(source: Path, out: Path, second: Path | None, template: Path | None) -> dict[str, Any]:
    """Decodes a raw sweep (with `second`, a pair) into `out`; what was sent, what it sounds like, and of a template its
    sidelobes and gain. AnnulusError as `decode_record`, and where the sweep does not say what was sent."""
    record = load_acoustic(source)
    if not record.code:
        raise AnnulusError(f"{source}: does not say what was sent; expected a raw sweep with its code")
    answer: dict[str, Any] = {"code": code_name(record.code), "detected_code": detected_code(record)}
    if second is not None:
        decoded = decode_records(record, load_acoustic(second))
    else:
        decoded, used = decode_record(record, load_template(template) if template else None)
        if used is not None:
            answer |= {"psr": used.psr, "gain_db": used.gain_db, "ceiling_db": used.ceiling_db}
    save_acoustic(out, decoded)
    return answer


def decode_record(record: AcousticRecord, template: Template | None = None) -> tuple[AcousticRecord, Template | None]:
    """The record with its code compressed; sample 0 then stands at the middle of the pulse.

    A record of a single pulse is only shifted there. Without a template the minimax design of its code is used.

    Raises AnnulusError where the template is for another code than the record's.
    """
    if record.chip_s is None or not record.code:
        if template is None:
            return record, None
        raise AnnulusError("the record does not say what was sent, so nothing can be decoded")
    if "1" not in record.code.strip("0") or record.code.strip("0") == "1":
        if template is not None and template.code != record.code:
            raise AnnulusError("the record is of a single pulse, the template is for a code")
        return replace(record, t0_s=record.t0_s - 0.5 * record.chip_s, code="", extra=_from(record)), None
    if template is not None and template.code != record.code:
        raise AnnulusError(
            f"the template is for {code_name(template.code)}, the record was shot with {code_name(record.code)}: "
            f"design one for {code_name(record.code)} with `annulus burst design`"
        )
    used = design(pattern(record.code), 3 * len(record.code)) if template is None else template
    bad = np.asarray(~np.isfinite(record.signals).all(axis=1), np.bool_)
    clean = np.where(bad[:, None], 0.0, record.signals)
    signals = decode(clean, record.sampling_rate_hz, used, record.chip_s)
    signals[bad] = np.nan  # named and left out by whoever looks at the sweep
    return replace(record, signals=signals.astype(np.float32), code="", extra=_from(record)), used


def decode_records(first: AcousticRecord, second: AcousticRecord) -> AcousticRecord:
    """A complementary Manchester pair, one sweep each."""
    codes = [CODES["manchester1"], CODES["manchester2"]]
    if [first.code, second.code] != codes:
        raise AnnulusError("a pair must be a sweep with manchester1 and one with manchester2, in this order")
    if (
        first.signals.shape != second.signals.shape
        or first.sampling_rate_hz != second.sampling_rate_hz
        or not np.allclose(first.angles_deg, second.angles_deg)
        or first.chip_s != second.chip_s
        or first.chip_s is None
    ):
        raise AnnulusError("the two sweeps of a pair must agree in positions, samples, sampling rate and chip")
    signals = decode_pair(
        [first.signals, second.signals], first.sampling_rate_hz, [pattern(code) for code in codes], first.chip_s
    )
    return replace(first, signals=signals.astype(np.float32), code="", extra=_from(first))


def detected_code(record: AcousticRecord) -> str | None:
    """The built-in code that was sent by the sound of it, where that is clearly not the one the record names."""
    if record.chip_s is None or not record.code:
        return None
    kept = record.signals[np.isfinite(record.signals).all(axis=1)][:: max(1, len(record.signals) // 8)]
    if not len(kept) or not np.any(kept):
        return None
    chip_s, longest = record.chip_s, max(len(bits) for bits in (*CODES.values(), record.code))
    samples = kept.shape[1] + math.ceil(2 * longest * chip_s * record.sampling_rate_hz)
    spectrum = np.fft.rfft(kept - kept.mean(axis=1, keepdims=True), samples, axis=1)
    frequency = np.fft.rfftfreq(samples, 1 / record.sampling_rate_hz)

    def sharpness(bits: str) -> float:
        """Peak over rms behind the code's Wiener filter: quick, and good enough to tell codes apart."""
        on = np.flatnonzero(pattern(bits))
        sent = np.exp(-2j * math.pi * np.outer(frequency * chip_s, on)).sum(axis=1)
        out = np.fft.irfft(spectrum * np.conj(sent) / (np.abs(sent) ** 2 + 0.1 * len(on)), samples, axis=1)
        return float(np.median(np.abs(out).max(axis=1) / np.sqrt((out**2).mean(axis=1))))

    named = sharpness(record.code)
    others = {name: sharpness(bits) for name, bits in CODES.items() if bits != record.code}
    best = max(others, key=lambda name: others[name])
    return best if others[best] > SHARPER * named else None


def code_name(bits: str) -> str:
    return next((name for name, code in CODES.items() if code == bits), bits if len(bits) < 40 else f"{bits[:37]}..")


def sweep_of(record: AcousticRecord, sound_speed_m_s: float | None = None) -> Sweep:
    """The record as the methods take it. Speed of sound: as given, else as recorded, else water's 1480 m/s."""
    speed = sound_speed_m_s or record.sound_speed_m_s or 1480.0
    return Sweep(
        record.signals.astype(np.float64),
        record.angles_deg,
        record.radius_mm,
        record.sampling_rate_hz,
        record.t0_s,
        speed,
    )


def _from(record: AcousticRecord) -> dict[str, str | float]:
    return {**record.extra, "decoded_from": code_name(record.code)}
