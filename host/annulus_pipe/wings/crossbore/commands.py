"""`annulus bore`: cross bores, where a pipe was drilled through a sewer."""

import json
import math
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, progress, verbs

app = verbs()


@app.command("detect", epilog="Example: annulus bore detect pipe-12.csv.gz -o pipe-12.json")
def detect_command(
    log: Annotated[Path, typer.Argument(help="The head's log: CSV, plain or gzipped.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Detections as JSON; a picture beside it, .png.")
    ] = None,
    air_pf: Annotated[
        float | None, typer.Option(min=0.01, max=1000, help="What a sector of this head reads in its pipe in air, pF.")
    ] = None,
    coupling_ff: Annotated[
        float | None, typer.Option(min=1, max=10_000, help="What a coupling takes off each sector of this head, fF.")
    ] = None,
    joint_mm: Annotated[
        list[float] | None, typer.Option(help="Where the ring sensor saw a joint, by the log's odometer, mm; again.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Where a log shows a sewer: air, water or half of each, with direction and length; and what else stands out.

    Water reads like moist soil: it is told in dry soil, or where the log has loss columns, and how much of the log that
    is is said. What no wall can give (a chip that froze, a loose wire) is no reading: such stretches are listed, and no
    bore is called there. The head's pose (off_x_mm, off_y_mm), where there, takes lift-off out.
    """
    from annulus_pipe.wings.crossbore.detected import detect_in_log
    from annulus_pipe.wings.crossbore.measure import likely
    from annulus_pipe.wings.crossbore.picture import clock

    account, grid, has_loss, summary, files = detect_in_log(log, out, air_pf, coupling_ff, joint_mm or ())
    if as_json:
        print(json.dumps(summary, allow_nan=False))
        return
    print(
        f"log        {account.length_mm / 1000:.1f} m; not seen {account.unseen_mm / 1000:.2f} m, "
        f"{grid.unread} rows without a reading, {grid.spikes} spikes left out"
    )
    print(f"ends       the first and last {account.ends_mm / 1000:.2f} m are not judged")
    lift = "no pose in the log: lift-off stays in" if grid.lift_ff_mm is None else f"{grid.lift_ff_mm:.0f} fF a mm"
    print(f"lift-off   {lift}")
    if account.wanders:
        print("wanders    the head stood off the axis by millimetres: only what is alike all round is called a bore")
    for gap in account.gaps:
        print(f"no reading {gap}")
    for one in account.indications:
        sure = f", {100 * likely(one):.0f} %" if one.odds else ""
        way = (
            "all round"
            if not math.isfinite(one.phi_deg)
            else (f"{one.phi_deg:.0f} deg ({clock(one.phi_deg)}), k=2 {2 * one.phi_sigma_deg:.0f} deg")
        )
        print(f"{one.kind:<10} at {one.odometer_mm / 1000:.3f} m, {one.extent_mm:.0f} mm long, {way}{sure}")
    if not account.bores:
        print("bores      none of those that can be told here")
    blind = account.length_mm - account.water_told_mm
    if blind > 1000:
        why = "not seen" if has_loss else "no loss in the log, and soil reads like water"
        print(f"water      cannot be told on {blind / 1000:.1f} m: {why}")
    if files:
        print(f"files      {', '.join(str(file) for file in files)}")


@app.command("simulate", epilog="Example: annulus bore simulate pipe.csv.gz --length-m 120 --seed 3 --pose --loss")
def simulate_command(
    log: Annotated[Path, typer.Argument(help="Log to write, .csv or .csv.gz; its truth beside it, .truth.json.")],
    length_m: Annotated[float, typer.Option(min=10.0, max=2000.0, help="Of pipe, m.")] = 60.0,
    bores: Annotated[int, typer.Option(min=0, max=200, help="Sewers through it or half into it.")] = 4,
    near: Annotated[int, typer.Option(min=0, max=200, help="Sewers beside it, 15 to 80 mm away.")] = 2,
    soil: Annotated[
        list[float] | None,
        typer.Option(min=1.5, max=60, help="Relative permittivity, again for more soils. Default: 15, 4, 22."),
    ] = None,
    pose: Annotated[bool, typer.Option("--pose", help="With the head's offset from the axis.")] = False,
    loss: Annotated[bool, typer.Option("--loss", help="With the sectors' loss.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="The same seed, the same log.")] = 0,
) -> None:
    """A log of the twin's pipe, with couplings, beads, hollows, lost rows, slips and drift, and its truth."""
    from annulus_pipe.wings.crossbore.ground import SOILS, simulate_log

    truth = simulate_log(log, length_m, seed, tuple(soil or SOILS), bores, near, pose, loss)
    print(f"files      {log}, {truth}")


@app.command("model", epilog="Example: annulus bore model -o bore-model --soil-eps 20 --soil-sigma 0.01")
def model_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; made if need be.")] = Path(
        "bore-model"
    ),
    soil_eps: Annotated[float, typer.Option(min=1.0, max=80.0, help="Relative permittivity of the soil.")] = 20.0,
    soil_sigma: Annotated[float, typer.Option(min=0.0, max=10.0, help="Conductivity of the soil, S/m.")] = 0.0,
    as_json: Json = False,
) -> None:
    """The head's electrostatic field: Figures 10.3 and 10.5, depth and shield, and the source's pipes A, B and C.

    Writes model.json, field.png, passing.png and bores.png, in about 40 s. Beside stand the numbers of a prototype's
    field. The source gives no size of the electrodes: theirs were chosen among 18 to come near those numbers.
    """
    from annulus_pipe.wings.crossbore.measure.elements import permittivity
    from annulus_pipe.wings.crossbore.measure.model import model
    from annulus_pipe.wings.crossbore.model_picture import write_model

    with progress() as report:
        found = model(permittivity(soil_eps, soil_sigma), report)
    figures = found.figures
    maps = {name: (one.points_mm, one.v_m) for name, one in found.maps.items()}
    files = write_model(out, figures, found.curves, maps)
    if as_json:
        print(json.dumps({**figures, "files": [str(file) for file in files]}))
        return
    along, off = figures["along"], figures["along_shield_off"]
    print(
        f"circuit    differential {figures['swing_ff']:+.0f} fF from air to soil, single-ended mutual "
        f"{1000 * (along['soil']['mutual_pf'] - along['air']['mutual_pf']):+.0f} fF"
    )
    print(
        f"shield     {along['air']['differential_pf']:.2f} pF stand in air, {off['air']['differential_pf']:.2f} pF "
        "with the shield at earth"
    )
    print(
        f"depth      half of the swing within {figures['half_depth_mm']:.1f} mm of the wall "
        f"(prototype's {figures['half_depth_prototype_mm']:g} mm)"
    )
    lift = figures["lift"]
    print(
        f"lift       {lift['off_mm']:g} mm off the axis is {100 * lift['of_swing']:.0f} % of the swing "
        f"(prototype's {100 * lift['of_swing_prototype']:.0f} %)"
    )
    for row in figures["bores"]:
        measured = ""
        if "prototype_ff" in row:
            theirs = " / ".join("-" if one is None else f"{one:+.0f}" for one in row["prototype_ff"])
            measured = f" (prototype's {theirs})"
        change = " / ".join(f"{one:+.1f}" for one in row["change_ff"])
        print(f"pipe {row['pipe']}     {row['case']}, {row['fill']}: {change} fF{measured}")
    print(f"files      {', '.join(str(file) for file in files)}")
