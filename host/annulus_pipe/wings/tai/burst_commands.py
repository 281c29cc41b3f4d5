"""`annulus burst`: patterns of the microwave source."""

import json
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import ChipUs, Json, progress, verbs
from annulus_pipe.controller import CHIPS_MAX, CODES
from annulus_pipe.vocabulary import AnnulusError

app = verbs()

CODE = f"{', '.join(CODES)}, or any text of 0 and 1."
PICTURES = (".png", ".svg", ".pdf")


@app.command("show", epilog="Example: annulus burst show mpsl25-stuffed --chip-us 0.5 -o mpsl25.svg")
def show_command(
    code: Annotated[str, typer.Argument(help=CODE)],
    chip_us: Annotated[float, typer.Option(help="Length of a chip, us.")] = 0.5,
    repeat: Annotated[int, typer.Option(help="Bursts.")] = 1,
    period_us: Annotated[float, typer.Option(help="Chip 0 to chip 0, us.")] = 1000.0,
    trigger_offset_us: Annotated[
        float, typer.Option(help="Digitizer trigger after chip 0, us; may be negative.")
    ] = 0.0,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Picture as well: .png, .svg or .pdf.")] = None,
    as_json: Json = False,
) -> None:
    """Draw a pattern and its timing, and say what the controller's limits say to it.

    Needs no controller. Status 1 for a train that it would refuse.
    """
    from annulus_pipe.link.codes import train_from_us
    from annulus_pipe.wings.tai import show

    if out is not None and out.suffix.lower() not in PICTURES:
        raise AnnulusError(f"{out}: expected a name that ends in {', '.join(PICTURES)}")
    train = train_from_us(
        code, chip_us=chip_us, repeat=repeat, period_us=period_us, trigger_offset_us=trigger_offset_us
    )
    findings = train.findings()
    if as_json:
        print(json.dumps(show.fields(code, train, findings)))
    else:
        print("\n".join(show.drawing(code, train, findings)))
    if out is not None:
        show.picture(code, train, out)
        if not as_json:
            print(f"picture          {out}")
    train.check()


@app.command("design", epilog="Example: annulus burst design --code mpsl25-stuffed --taps 150 -o template.json")
def design_command(
    code: Annotated[str, typer.Option(help=CODE)] = "mpsl25-stuffed",
    taps: Annotated[int, typer.Option(min=1, max=2000, help="Length of the template, chips.")] = 150,
    method: Annotated[str, typer.Option(help="minimax, least-squares, matched.")] = "minimax",
    chip_us: ChipUs = 0.5,
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
    from annulus_pipe.wings.tai.design import design_template

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


@app.command("search", epilog="Example: annulus burst search --length 31 --restarts 100")
def search_command(
    length: Annotated[int, typer.Option(min=2, max=CHIPS_MAX, help="Chips.")],
    bipolar: Annotated[
        bool, typer.Option("--bipolar", help="+1/-1 code of least peak sidelobe, every one looked at: up to 28 chips.")
    ] = False,
    restarts: Annotated[int, typer.Option(min=1, max=10_000, help="On/off: random codes to climb from.")] = 40,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    as_json: Json = False,
) -> None:
    """Codes of other lengths: on/off ones that lose least in their decoding filter, or bipolar ones."""
    from annulus_pipe.link.codes import text
    from annulus_pipe.wings.tai.measure.search import best_on_off, least_peak_sidelobe

    if bipolar:
        code, lobe = least_peak_sidelobe(length)
        signs = "".join("+" if chip > 0 else "-" for chip in code)
        answer: dict[str, object] = {"code": signs, "peak_sidelobe": lobe, "peak": length, "proven": True}
    else:
        with progress() as report:
            chips, gain = best_on_off(length, seed, restarts, lambda done, of: report("codes", done, of))
        answer = {"code": text(chips), "ones": int(chips.sum()), "gain_db": gain, "proven": False}
    if as_json:
        print(json.dumps(answer))
    elif bipolar:
        print(
            f"{answer['code']}  peak {length}, highest sidelobe {answer['peak_sidelobe']}: no code of {length} has less"
        )
    else:
        print(f"{answer['code']}  {answer['ones']} on, {answer['gain_db']:.2f} dB over one pulse without any sidelobe")
