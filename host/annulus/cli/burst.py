"""`annulus burst`: patterns of the microwave source."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from annulus.cli.show import Json, group
from annulus.thermoacoustic.codes import CODES, TRIGGER_TICKS, Finding, Limits, Train, pattern, text
from annulus.vocabulary import TICK_S, TICKS_PER_US, AnnulusError

app = group("On/off patterns of the microwave source.")

CHIPS_A_ROW = 64
PICTURES = (".png", ".svg", ".pdf")


@app.callback()
def _burst() -> None:
    """A noun with verbs, also while there is one verb."""


def compiled_limits() -> Limits:
    """What the controller enforces, from the same file it was generated from."""
    from annulus.link import messages as m

    ns = round(TICK_S * 1e9)
    return Limits(
        (m.CHIP_MIN_TICKS, m.CHIP_MAX_TICKS),
        (m.MICROWAVE_PULSE_MIN_NS // ns, m.MICROWAVE_PULSE_MAX_NS // ns),
        m.MICROWAVE_DUTY_MAX_PERMILLE,
        m.TICK_HZ,
    )


@app.command("show", epilog="Example: annulus burst show mpsl25-stuffed --chip-us 0.5 -o mpsl25.svg")
def show(
    code: Annotated[str, typer.Argument(help=f"{', '.join(CODES)}, or any text of 0 and 1.")],
    chip_us: Annotated[float, typer.Option(min=0.01, max=1000.0, help="Length of a chip, us.")] = 0.5,
    repeat: Annotated[int, typer.Option(min=1, max=65535, help="Bursts.")] = 1,
    period_us: Annotated[float, typer.Option(min=0.01, max=1e7, help="Chip 0 to chip 0, us.")] = 1000.0,
    trigger_offset_us: Annotated[
        float, typer.Option(min=-1e7, max=1e7, help="Digitizer trigger after chip 0, us; may be negative.")
    ] = 0.0,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Picture as well: .png, .svg or .pdf.")] = None,
    as_json: Json = False,
) -> None:
    """Draw a pattern and its timing, and say what the controller's limits say to it.

    Needs no controller. Status 1 for a train that it would refuse.
    """
    if out is not None and out.suffix.lower() not in PICTURES:
        raise AnnulusError(f"{out}: expected a name that ends in {', '.join(PICTURES)}")
    ticks = {
        name: round(us * TICKS_PER_US)
        for name, us in (
            ("chip_ticks", chip_us),
            ("period_ticks", period_us),
            ("trigger_offset_ticks", trigger_offset_us),
        )
    }
    train = Train(pattern(code), repeat=repeat, **ticks)
    findings = train.findings(compiled_limits())
    refused = [finding for finding in findings if not finding.ok]
    if as_json:
        print(json.dumps(_fields(code, train, findings)))
    else:
        print("\n".join(_drawing(code, train, findings)))
    if out is not None:
        _picture(code, train, out)
        if not as_json:
            print(f"picture          {out}")
    if refused:
        raise AnnulusError(
            "the controller would refuse this: "
            + "; ".join(f"{f.name} {f.value:g} {f.unit}, expected {_range(f)}" for f in refused)
        )


def _fields(code: str, train: Train, findings: list[Finding]) -> dict[str, Any]:
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


def _range(finding: Finding) -> str:
    low, high = finding.allowed
    return f"{high:g} {finding.unit} at most" if low == 0 else f"{low:g}..{high:g} {finding.unit}"


def _drawing(code: str, train: Train, findings: list[Finding]) -> list[str]:
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
        lines.append(f"{f.name:<16} {f.value:g} {f.unit} ({_range(f)}){'' if f.ok else '  REFUSED'}")
    return lines


def _picture(code: str, train: Train, out: Path) -> None:
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


@app.command("design", epilog="Example: annulus burst design --code mpsl25-stuffed --taps 150 -o template.json")
def design_command(
    code: Annotated[str, typer.Option(help=f"{', '.join(CODES)}, or any text of 0 and 1.")] = "mpsl25-stuffed",
    taps: Annotated[int, typer.Option(min=1, max=2000, help="Length of the template, chips.")] = 150,
    method: Annotated[str, typer.Option(help="minimax, least-squares, matched.")] = "minimax",
    chip_us: Annotated[float, typer.Option(min=0.1, max=30.0, help="Length of a chip, us.")] = 0.5,
    transducer: Annotated[
        Path | None,
        typer.Option(help="Measured pulse: CSV of time_us,amplitude. The template then fits what it hears."),
    ] = None,
    samples_per_chip: Annotated[int, typer.Option(min=2, max=20, help="Taps a chip, behind a transducer.")] = 5,
    guard_chips: Annotated[float, typer.Option(min=0.0, max=20.0, help="Beside the peak, no sidelobe.")] = 2.0,
    gain_floor_db: Annotated[float, typer.Option(help="Least gain over one pulse, behind a transducer.")] = 7.6,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="template.json, and a picture beside it.")] = None,
    as_json: Json = False,
) -> None:
    """The decoding filter of a code: sidelobes, noise gain, and what averaging in the same time would give."""
    from annulus.tai.design import design_template

    if method not in ("minimax", "least-squares", "matched"):
        raise AnnulusError(f"--method {method!r}: expected minimax, least-squares or matched")
    answer = design_template(
        code, taps, method, 1e-6 * chip_us, transducer, samples_per_chip, guard_chips, gain_floor_db, out
    )
    if as_json:
        print(json.dumps(answer))
        return
    print(f"code       {answer['pattern']} ({answer['ones']} pulses of {chip_us:g} us)")
    print(f"template   {len(answer['template'])} taps, {answer['method']}")
    print(f"sidelobes  1/{answer['psr']:.1f} of the peak" + (f", beyond +-{guard_chips:g} chips" if transducer else ""))
    print(
        f"gain       {answer['gain_db']:.2f} dB over one pulse; no filter gains more than {answer['ceiling_db']:.2f} dB"
    )
    print(
        f"averaging  as many shots: 0 dB; as much energy, {answer['ones']} shots: "
        f"{answer['averaging_same_energy_db']:.2f} dB"
    )
    if out is not None:
        print(f"written    {out}, {out.with_suffix('.png')}")
