"""What a head is, for whoever runs it: cameras, the window for flashes, lamps, job, calibration and its age."""

from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from annulus_pipe.controller import LAMP_DUTY_MAX_PERMILLE, LAMP_WIDTH_MAX_TICKS, TICKS_PER_US
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.daemon.controller_line import ControllerLine, lamp_numbers
from annulus_pipe.daemon.evidence import versions
from annulus_pipe.qualification.applicability import Applicability, HeadInUse
from annulus_pipe.storage.calibration_file import fingerprint
from annulus_pipe.untrusted import printable

NAMES_MAX = 32  # sections of a provenance, and names in one


def about(config: HeadConfig, line: ControllerLine | None) -> dict[str, Any]:
    """Plain types, as README.md lists them; what is not known is None or empty."""
    timing, calibration = config.timing, config.calibration
    standing, state = certificate_state(config)
    identity = line.head.identity if line is not None else None
    return {
        "version": versions()["annulus"],
        "cameras": [
            {
                "number": n,
                **{name: value for name, value in asdict(one).items() if isinstance(value, int | float | str)},
            }
            for n, one in enumerate(config.cameras)
        ],
        "timing": {"fps": timing.fps, "exposure_us": timing.exposure_us, "readout_us": timing.readout_us},
        "window": {"opens_us": timing.opens_us, "closes_us": timing.closes_us},
        "lamps": lamp_numbers(config.lamps),
        "limits": {
            "width_max_us": LAMP_WIDTH_MAX_TICKS / TICKS_PER_US,
            "duty_max_percent": LAMP_DUTY_MAX_PERMILLE / 10,
        },
        "job": config.job.to_dict(),
        "calibration": None
        if calibration is None
        else {
            "nominal_diameter_mm": 2 * calibration.pipe_radius_mm,
            "cameras": len(calibration.cameras),
            "provenance": _bounded(config.provenance),
            "age_days": _age_days(config.provenance),
        },
        "certificate": {"standing": standing, "text": state},
        "controller": None
        if line is None or identity is None
        else {
            "port": line.url,
            "protocol": identity.protocol,
            "boot": identity.boot,
            "commit": _ascii(identity.git),
            "board": _ascii(identity.board),
        },
        "record": None
        if config.record_folder is None
        else {"folder": str(config.record_folder), "codec": config.record.codec.value},
        "sensors": [{"kind": one.kind, "name": one.name} for one in config.sensors],
    }


def certificate_state(config: HeadConfig) -> tuple[Applicability | None, str]:
    """Whether the head's certificate speaks for it today, as far as no scan and no controller needs to be asked."""
    calibration = config.calibration
    use = HeadInUse(
        config.job.head,
        "" if calibration is None else fingerprint(calibration),
        "",
        versions()["annulus"],
        None if calibration is None else 2 * calibration.pipe_radius_mm,
        config.job.temperature_c,
        datetime.now(UTC).date(),
    )
    return config.qualification.state(use)


def _ascii(name: bytes) -> str:
    return printable(name.rstrip(b"\0").decode("ascii", "replace"))


def _bounded(provenance: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    sections = list(provenance.items())[:NAMES_MAX]
    return {name: dict(list(made.items())[:NAMES_MAX]) for name, made in sections}


def _age_days(provenance: Mapping[str, Mapping[str, Any]]) -> float | None:
    """Of its oldest section that says when it was made."""
    made = []
    for section in provenance.values():
        try:
            at = datetime.fromisoformat(str(section.get("utc", "")))
        except ValueError:
            continue
        made.append(at if at.tzinfo is not None else at.replace(tzinfo=UTC))
    return round((datetime.now(UTC) - min(made)).total_seconds() / 86400, 2) if made else None
