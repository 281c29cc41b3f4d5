"""`annulus burst show` and `annulus tai budget`: a pattern and its timing, a budget; in letters and as fields."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from annulus_pipe.controller import TICKS_PER_US, TRIGGER_TICKS
from annulus_pipe.link.codes import LimitCheck, Train, text
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.budget import (
    NEEDED_DB,
    SEQUENCES,
    Laminate,
    SingleSidedRig,
    budget,
    code_cost,
    warming_k_s,
)

CHIPS_A_ROW = 64


def fields(code: str, train: Train, findings: list[LimitCheck]) -> dict[str, Any]:
    pulses = train.pulses_ticks / TICKS_PER_US
    return {
        "code": code,
        "pattern": text(train.chips),
        "chips": len(train.chips),
        "ones": int(train.chips.sum()),
        "chip_us": train.chip_ticks / TICKS_PER_US,
        "burst_us": train.burst_ticks / TICKS_PER_US,
        "pulses_us": [{"start": float(start), "length": float(length)} for start, length in pulses],
        "repeat": train.repeat,
        "period_us": train.period_ticks / TICKS_PER_US,
        "trigger_us": [train.trigger_offset_ticks / TICKS_PER_US, TRIGGER_TICKS / TICKS_PER_US],
        "train_s": train.train_s,
        "duty": train.duty,
        "limits": [
            {"name": f.name, "value": f.value, "allowed": list(f.allowed), "unit": f.unit, "ok": f.ok} for f in findings
        ],
        "ok": all(finding.ok for finding in findings),
    }


def drawing(code: str, train: Train, findings: list[LimitCheck]) -> list[str]:
    """Rows of chips with the time at which each row begins, then the numbers."""
    lines = []
    for at in range(0, len(train.chips), CHIPS_A_ROW):
        row = "".join("█" if chip else "▁" for chip in train.chips[at : at + CHIPS_A_ROW])
        lines.append(f"{at * train.chip_ticks / TICKS_PER_US:>9.2f} us  {row}")
    burst, ones = train.burst_ticks / TICKS_PER_US, int(train.chips.sum())
    trigger = train.trigger_offset_ticks / TICKS_PER_US
    lines += [
        "",
        f"code             {code}: {len(train.chips)} chips of {train.chip_ticks / TICKS_PER_US:g} us, {ones} on,"
        f" {len(train.pulses_ticks)} pulses",
        f"burst            {burst:g} us, then dark to {train.period_ticks / TICKS_PER_US:g} us",
        f"trigger          {trigger:+g} us from chip 0, {TRIGGER_TICKS / TICKS_PER_US:g} us long",
        f"train            {train.repeat} bursts in {train.train_s:g} s",
    ]
    for f in findings:
        lines.append(f"{f.name:<16} {f.value:g} {f.unit} ({f.expected}){'' if f.ok else '  REFUSED'}")
    return lines


def picture(code: str, train: Train, out: Path) -> None:
    """Gate and trigger of one burst, chip by chip, and of the period they stand in."""
    from matplotlib.figure import Figure

    burst, period = train.burst_ticks / TICKS_PER_US, train.period_ticks / TICKS_PER_US
    trigger = train.trigger_offset_ticks / TICKS_PER_US
    edges = [(t / TICKS_PER_US, level) for t, level in train.edges_ticks()]
    gate = ([trigger - period, *(t for t, _ in edges), period + burst], [0, *(level for _, level in edges), 0])
    line = ([trigger - period, trigger, trigger + TRIGGER_TICKS / TICKS_PER_US, period + burst], [0, 1, 0, 0])
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    near, far = figure.subplots(2, 1, height_ratios=(2, 1))
    margin = 0.05 * burst + train.chip_ticks / TICKS_PER_US
    for axes, span in (
        (near, (min(-margin, trigger - margin), max(burst, trigger + 1) + margin)),
        (far, (-0.02 * period, period)),
    ):
        axes.step(gate[0], [1.3 + v for v in gate[1]], where="post", color="C3", label="microwave GP5")
        axes.step(*line, where="post", color="C0", label="digitizer trigger GP6")
        axes.set_xlim(*span)
        axes.set_yticks([0, 1, 1.3, 2.3], ["0", "1", "0", "1"])
        axes.set_xlabel("us after chip 0")
    if len(train.chips) <= 128:
        near.set_xticks([i * train.chip_ticks / TICKS_PER_US for i in range(len(train.chips) + 1)], minor=True)
        near.grid(axis="x", which="minor", alpha=0.3)
    near.set_ylim(-0.1, 3.1)
    near.legend(loc="upper right", ncols=2)
    near.set_title(f"{code}: {len(train.chips)} chips of {train.chip_ticks / TICKS_PER_US:g} us")
    far.set_title(f"period {period:g} us, duty {100 * train.duty:.3g} %", fontsize="medium")
    try:
        figure.savefig(out, dpi=150)
    except OSError as error:
        raise AnnulusError(f"{out}: cannot be written ({error.strerror}), expected a folder that takes it") from None


def budget_fields(rig: SingleSidedRig, depth_mm: float) -> dict[str, Any]:
    """Both kinds of defect at one depth, and every sequence, for a program and for `budget_lines`."""
    laminate = Laminate()
    budgets = [budget(rig, laminate, kind, depth_mm) for kind in ("delamination", "water")]
    costs = [code_cost(name, rig) for name in SEQUENCES]
    return {
        "depth_mm": depth_mm,
        "noise_pa_rthz": rig.noise_pa_rthz(),
        "needed_db": NEEDED_DB,
        "budgets": [asdict(one) for one in budgets],
        "codes": [
            asdict(cost)
            | {f"{one.kind}_s": cost.seconds_for(one.missing_db) for one in budgets}
            | {"water_warms_k_s": warming_k_s(rig, laminate, cost.ones * rig.pulse_s / cost.period_s)[1]}
            for cost in costs
        ],
    }


def budget_lines(fields: Mapping[str, Any]) -> list[str]:
    lines = []
    for one in fields["budgets"]:
        lines.append(f"{one['kind']} {one['depth_mm']:g} mm deep, one pulse, one shot")
        lines += [
            f"  {term['db']:+7.1f} dB{' Pa' if term['level'] else '   '}  {term['name']}: {term['source']}"
            for term in one["terms"]
        ]
        lines += [
            f"  {one['received_db']:+7.1f} dB Pa  at the receiver",
            f"  {one['noise_db']:+7.1f} dB Pa  its noise in the band: {1e6 * fields['noise_pa_rthz']:.2g} uPa/rtHz",
            f"  {one['missing_db']:+7.1f} dB     missing, to {fields['needed_db']:g} dB over the noise",
        ]
    lines.append(
        "sequence        ones  gain dB  beside dB  period ms  in equal time dB  a position: delamination, water"
    )
    lines += [
        f"{c['name']:<15} {c['ones']:4.0f} {c['gain_db']:8.1f} {c['sidelobe_db']:10.0f} {1e3 * c['period_s']:10.2f} "
        f"{c['rate_db']:17.1f}  {c['delamination_s']:.2g} s, {c['water_s']:.2g} s; "
        f"water warms {c['water_warms_k_s']:.2g} K/s"
        for c in fields["codes"]
    ]
    return lines
