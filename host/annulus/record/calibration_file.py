"""calibration.json on disk."""

import json
import os
from pathlib import Path

from annulus.geometry.calibration import Calibration
from annulus.vocabulary import AnnulusError

SIZE_MAX = 4 << 20  # per-direction fine-tuning of a dozen rings stays far below


def load_calibration(path: Path) -> Calibration:
    """The calibration in a file of format annulus-calibration/1. Raises AnnulusError naming file and key."""
    try:
        with path.open("rb") as file:
            data = file.read(SIZE_MAX + 1)
    except FileNotFoundError:
        raise AnnulusError(f"{path}: no such file. Expected the calibration.json of the head that scanned.") from None
    except IsADirectoryError:
        raise AnnulusError(f"{path}: is a folder. Expected a calibration.json.") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a calibration.json.") from None
    if len(data) > SIZE_MAX:
        raise AnnulusError(f"{path}: larger than {SIZE_MAX >> 20} MiB. Expected a calibration.json.")
    try:
        return Calibration.from_dict(json.loads(data.decode("utf-8-sig")))
    except json.JSONDecodeError as error:
        raise AnnulusError(
            f"{path}: line {error.lineno}: not JSON ({error.msg}). Expected a calibration.json."
        ) from None
    except UnicodeDecodeError:
        raise AnnulusError(f"{path}: not a text file. Expected a calibration.json.") from None
    except (ValueError, RecursionError) as error:
        raise AnnulusError(f"{path}: {str(error) or 'too deeply nested'}.") from None


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Write the file whole or not at all. Raises AnnulusError when it cannot be written."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_text(json.dumps(calibration.to_dict(), indent=1) + "\n", encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise AnnulusError(f"{path}: cannot be written ({error.strerror}).") from None
