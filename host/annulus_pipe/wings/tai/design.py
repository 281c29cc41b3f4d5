"""`annulus burst design`: a template, its file, its picture, and the comparison that keeps it honest."""

import csv
import io
import math
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.link.codes import pattern
from annulus_pipe.storage.numbers import read_bounded, require_cells
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.decode import code_name, save_template, template_to_dict
from annulus_pipe.wings.tai.measure.templates import Method, Template, Transducer, design

CSV_MAX = 64 << 20  # bytes of a transducer's file. Unguarded: only keeps a wrong file from filling the memory


def design_template(
    code: str,
    taps: int,
    method: str,
    chip_s: float,
    transducer: Path | None,
    samples_per_chip: int,
    guard_chips: float,
    gain_floor_db: float,
    out: Path | None,
) -> dict[str, Any]:
    """Designs, writes `out` (JSON) and a picture beside it, and says what averaging would give instead.

    The comparison has both arms in the same noise behind the filter that is best for each. A coded shot takes the place
    of one single shot: with as many shots averaged, its gain is what it says. With as much microwave energy instead, as
    many single shots can be averaged as the code has pulses.
    """
    chips = pattern(code)
    chosen: Method = method  # type: ignore[assignment]
    if transducer is None:
        template = design(chips, taps, chosen, chip_s=chip_s)
    else:
        template = design(
            chips,
            taps,
            chosen,
            transducer=load_transducer(transducer),
            samples_per_chip=samples_per_chip,
            chip_s=chip_s,
            guard_chips=guard_chips,
            gain_floor_db=None if chosen == "matched" else gain_floor_db,
        )
    ones = int(chips.sum())
    answer = template_to_dict(template, chip_s)
    answer |= {
        "ones": ones,
        "averaging_same_shots_db": 0.0,
        "averaging_same_energy_db": template.averages_db(ones),
        "shots_to_match": math.ceil(10 ** (template.gain_db / 10)),
    }
    if out is not None:
        save_template(out, template, chip_s)
        picture(template, chip_s, out.with_suffix(".png"))
    return answer


def load_transducer(path: Path) -> Transducer:
    """CSV with a heading: time_us, amplitude, evenly spaced. Raises AnnulusError naming the row."""
    times, values = [], []
    try:
        text = read_bounded(path, CSV_MAX).decode("utf-8-sig")
        rows = csv.DictReader(io.StringIO(text, newline=""))
        for number, row in enumerate(rows, start=2):
            try:
                require_cells(row, len(set(rows.fieldnames or ())))
            except ValueError as error:
                raise AnnulusError(f"{path}: row {number}: {error}") from None
            try:
                times.append(float(row["time_us"]))
                values.append(float(row["amplitude"]))
            except (KeyError, ValueError):
                raise AnnulusError(f"{path}: row {number}: expected numbers in time_us and amplitude") from None
    except UnicodeDecodeError:
        raise AnnulusError(f"{path}: not a CSV file of time_us and amplitude") from None
    except csv.Error as error:
        raise AnnulusError(f"{path}: line {rows.line_num}: {error}") from None
    at, pulse = np.array(times), np.array(values)
    if len(at) < 8 or not (np.isfinite(at).all() and np.isfinite(pulse).all()):
        raise AnnulusError(f"{path}: {len(at)} rows, expected at least 8 finite ones")
    step = np.diff(at)
    if step.min() <= 0 or np.ptp(step) > 0.01 * step.mean():
        raise AnnulusError(f"{path}: time_us must rise in even steps")
    return Transducer(pulse, 1e6 / float(step.mean()))


def picture(template: Template, chip_s: float, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (top, middle, bottom) = plt.subplots(3, 1, figsize=(8.5, 7.5), layout="constrained")
    chips = pattern(template.code)
    edges = np.arange(len(chips) + 1) * chip_s * 1e6
    top.stairs(chips, edges, fill=True, color="tab:red")
    top.set(
        xlabel="time, us",
        ylabel="source on",
        yticks=[0, 1],
        title=f"{code_name(template.code)}: pattern",
        xlim=(0, edges[-1]),
    )
    at = np.arange(len(template.taps)) * template.spacing * chip_s * 1e6
    middle.vlines(at, 0, template.taps, color="tab:blue", lw=1)
    middle.axhline(0, color="0.6", lw=0.5)
    middle.set(xlabel="time, us", ylabel="tap", title=f"template: {len(template.taps)} taps, {template.method}")
    level = 20 * np.log10(np.maximum(np.abs(template.output), 1e-5))
    away = (np.arange(len(level)) - template.peak) * template.spacing * chip_s * 1e6
    bottom.plot(away, level, color="tab:green", lw=0.9)
    bottom.axhline(-20 * math.log10(template.psr), color="0.5", lw=0.8, ls="--")
    bottom.set(
        xlabel="time from the peak, us",
        ylabel="decoded, dB",
        ylim=(-70, 3),
        title=f"highest sidelobe 1/{template.psr:.1f}, gain {template.gain_db:.2f} dB of {template.ceiling_db:.2f} dB",
    )
    figure.savefig(path, dpi=130)
    plt.close(figure)
