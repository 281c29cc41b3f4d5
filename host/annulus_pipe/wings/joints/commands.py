"""`annulus joint`: butt-fusion joints, from a CT volume to what may be said of them."""

import contextlib
import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from annulus_pipe.cli.show import Json, progress, verbs
from annulus_pipe.vocabulary import AnnulusError

app = verbs()


@app.command("image", epilog="Example: annulus joint image joint-7/ct.tif -o joint-7/result")
def image_command(
    ct: Annotated[
        Path, typer.Argument(help="TIFF stack, .npy, or folder of a DICOM series or TIFF slices; ct.json beside it.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; made if need be.")],
    voxel_mm: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="Z Y X", help="Size of a voxel, mm, in place of ct.json's."),
    ] = None,
    inner_mm: Annotated[
        float, typer.Option(min=0.1, help="Middle part of the wall whose density is taken, mm of --of-mm.")
    ] = 4.0,
    of_mm: Annotated[float, typer.Option(min=0.1, help="The wall that --inner-mm is a part of, mm.")] = 5.6,
    as_json: Json = False,
) -> None:
    """Beads, hi-lo, thickness, heat-affected zone and flaws of a joint, by angle.

    Writes features.json (by angle, with sigma), maps.npz and pictures. Density is relative to the plain wall of the
    same volume, which has to be seen on both sides of the joint. No CT of a PE joint is public: this is
    proven on simulated ones.
    """
    from annulus_pipe.wings.joints.ct import image_joint
    from annulus_pipe.wings.joints.measure import Parts

    with progress() as report:
        volume, figures, flaws, files = image_joint(ct, out, voxel_mm, Parts(inner_mm, of_mm), report)
    if as_json:
        voxels = {"form": volume.form, "shape": list(volume.shape), "voxel_mm": list(volume.voxel_mm)}
        print(json.dumps({"volume": voxels, **figures, "flaws": flaws, "files": [str(file) for file in files]}))
        return
    _print(volume, figures, flaws)
    print(f"files      {', '.join(str(file) for file in files)}")


@app.command(
    "scan",
    epilog="Example: annulus joint scan --port /dev/ttyACM0 --linear-stage /dev/ttyUSB0 --probe "
    'TCPIP::192.168.1.30::5025::SOCKET --amplitude "MEAS:VOLT:DC? (@101)" --to-mm 40 -o joint-7/microwave.npz. '
    "Without hardware: annulus joint scan --twin --angles 20 --step-mm 2 -o microwave.npz",
)
def scan_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="Raster to write, .npz; its points beside it as they come.")],
    port: Annotated[
        str | None, typer.Option(help="Serial port of the controller, whose turntable turns the pipe.")
    ] = None,
    linear_stage: Annotated[
        str | None, typer.Option(help="Serial port of what carries the probe along, GRBL 1.1.")
    ] = None,
    axis: Annotated[str, typer.Option(help="Of the linear stage: X, Y or Z.")] = "X",
    feed: Annotated[float, typer.Option(min=1.0, max=1e5, help="Of the linear stage, mm/min.")] = 600.0,
    probe: Annotated[
        str | None, typer.Option(help="VISA name of the detector, or address of samples: ipc://PATH, tcp://HOST:PORT.")
    ] = None,
    sensor: Annotated[str, typer.Option(help="Which sensor of the samples.")] = "probe",
    amplitude: Annotated[
        str | None, typer.Option(help="Channel of amplitude: query that answers volts, or a sample's value.")
    ] = None,
    phase: Annotated[str | None, typer.Option(help="Channel of phase: the same.")] = None,
    twin: Annotated[bool, typer.Option("--twin", help="On the twin's bench, with the controller's own code.")] = False,
    angles: Annotated[int, typer.Option(min=3, max=4096, help="Over one turn of the pipe.")] = 100,
    from_mm: Annotated[float, typer.Option(help="First place of the linear stage, mm.")] = 0.0,
    to_mm: Annotated[float, typer.Option(help="Last place of the linear stage, mm.")] = 40.0,
    step_mm: Annotated[float, typer.Option(help="From place to place, mm.")] = 0.5,
    averages: Annotated[int, typer.Option(min=1, max=10_000, help="Readings at each point.")] = 4,
    settle_ms: Annotated[float, typer.Option(min=0.0, max=1e4, help="Waited where it stands, ms.")] = 20.0,
    steps_per_turn: Annotated[int, typer.Option(min=3, max=1_000_000, help="Of the turntable.")] = 400,
    step_us: Annotated[float, typer.Option(min=100.0, max=1e6, help="Step to step, us.")] = 1000.0,
    home: Annotated[bool, typer.Option("--home", help="Drive the linear stage to its switch first.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on: measure what its points have not yet.")] = False,
    homed: Annotated[
        bool, typer.Option("--homed", help="With --resume: turntable and stage were put back to where they began.")
    ] = False,
    as_json: Json = False,
) -> None:
    """A near-field probe over a joint, angle by angle along the pipe.

    Every point is on the disk before the next; Ctrl-C, a lost probe or a stage in alarm ends the scan with what it has
    (status not 0), --resume goes on. `annulus joint register` lays the raster on the joint's CT.
    """
    from annulus_pipe.wings.joints.bench import Addresses, opened_bench, twin_bench
    from annulus_pipe.wings.joints.scan import RasterPlan, log_of, scan

    given = [one is not None for one in (port, linear_stage, probe)]
    if twin == any(given) or any(given) != all(given):
        raise AnnulusError("give --port, --linear-stage and --probe, or --twin alone")
    queries = {name: key for name, key in (("amplitude_mv", amplitude), ("phase_mv", phase)) if key}
    if not twin and not queries:
        raise AnnulusError("give --amplitude, --phase or both: what the probe is asked for")
    plan = RasterPlan(angles, from_mm, to_mm, step_mm, averages, settle_ms, steps_per_turn, step_us)
    notes: list[str] = []
    with contextlib.ExitStack() as stack:
        report = stack.enter_context(progress())
        if port is None or linear_stage is None or probe is None:
            bench = stack.enter_context(twin_bench(steps_per_turn, axis, home=home))
        else:
            at = Addresses(port, linear_stage, probe, sensor, queries)
            bench = stack.enter_context(opened_bench(at, axis, feed, home=home))
        try:
            done = scan(*bench, plan, out, resume=resume, homed=homed or twin, say=notes.append, progress=report)
        except KeyboardInterrupt:
            notes.append(f"stopped; what was measured is in {log_of(out)}, --resume goes on")
            raise
        finally:
            stack.close()
            for note in notes:
                print(f"note       {note}", file=sys.stderr)
    if as_json:
        print(json.dumps(done.to_dict() | {"raster": str(out), "points_file": str(log_of(out))}))
        return
    print(f"scanned    {done.measured} of {done.points} points in {done.seconds:.1f} s, {done.retries} readings again")
    print(f"raster     {out}: {plan.angles} angles x {len(plan.z_mm)} z, mV; its points in {log_of(out)}")


@app.command("register", epilog="Example: annulus joint register joint-7/result joint-7/microwave.npz")
def register_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that `annulus joint image` wrote.")],
    raster: Annotated[
        Path,
        typer.Argument(
            help=".npz of a probe outside the pipe: amplitude_mv and phase_mv, or one of them, each (angle, z); "
            "angle_deg, one whole turn in even steps; z_mm, rising."
        ),
    ],
    as_json: Json = False,
) -> None:
    """Lays a near-field probe's raster on the joint's CT: at what angle, which way round, and what it says beyond.

    The raster less its plain wall is explained by the CT's bead outside and density, blurred by the aperture; nothing
    is left to choose. Adds `microwave` to features.json, writes scan.npz (maps on the CT's grid: `joint` over plain
    wall, `material` with the bead's share taken out) and scan.png. `accepted` is not proof: rasters of other joints
    that had one cold sector too were accepted in 11 of 80 simulated cases, in one set of 20 in 5.
    """
    from annulus_pipe.wings.joints.register import register

    angles, places, channels, figures, files = register(folder, raster)
    if as_json:
        print(json.dumps(figures | {"files": [*map(str, files)]}))
        return
    blur = figures["blur_sigma_mm"]
    print(f"raster     {angles} angles x {places} z, {' and '.join(channels)}")
    print(
        f"lies at    shift {figures['shift_deg']:.1f} deg, sigma {figures['shift_sigma_deg']:.1f}; the joint at z "
        f"{figures['joint_at_raster_z_mm']:.2f} mm of the raster, sigma {figures['joint_at_raster_z_sigma_mm']:.2f}"
    )
    print(f"sense      of angle {figures['sense']}, along the pipe {figures['sense_along']}")
    for other in figures["as_likely"]:
        print(
            f"as likely  shift {other['shift_deg']:.1f} deg, of angle {other['sense']}, "
            f"along the pipe {other['sense_along']}"
        )
    print(f"blur       {blur['round']:.1f} mm round the pipe, {blur['along']:.1f} mm along it (sigma)")
    print(
        f"explained  {100 * figures['explained']:.0f} % of what varies with the angle; p of the search "
        f"{figures['p']:.3f}"
    )
    print(f"accepted   {'yes' if figures['accepted'] else 'no: ' + figures['why_not']}")
    if figures["accepted"]:
        print("           no proof: of joints that have one cold sector too, one in eight passes for this one")
    print(f"files      {', '.join(str(file) for file in files)}")


@app.command("report", epilog="Example: annulus joint report joint-7/result")
def report_command(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of `annulus joint image`; of `register` and `correlate` too.")
    ],
    as_json: Json = False,
) -> None:
    """One page of a joint that opens and prints anywhere: what was measured, what it can and cannot say.

    Takes in what `register` and `correlate` have added to the folder.
    """
    from annulus_pipe.wings.joints.page import write_joint_page

    page = write_joint_page(folder)
    print(json.dumps({"report": str(page)}) if as_json else f"report     {page}")


def _print(volume: Any, figures: dict[str, Any], found: list[dict[str, Any]]) -> None:
    def span(name: str) -> str:
        median, least, greatest = (figures[name][key] for key in ("median", "least", "greatest"))
        return "not told" if median is None else f"{median:.2f} ({least:.2f} to {greatest:.2f})"

    sizes = " x ".join(str(n) for n in volume.shape), " x ".join(f"{v:.4g}" for v in volume.voxel_mm)
    print(f"volume     {volume.form}, {sizes[0]} voxels (z, y, x) of {sizes[1]} mm")
    print(
        f"pipe       outer diameter {figures['outer_diameter_mm']:.2f} mm, wall {span('wall_mm')} mm, "
        f"leaning {figures['lean_deg']:.2f} deg, joint at z {figures['joint_z_mm']:.2f} mm"
    )
    print(f"bead out   height {span('bead_out_height_mm')} mm, width {span('bead_out_width_mm')} mm")
    print(f"bead in    height {span('bead_in_height_mm')} mm, width {span('bead_in_width_mm')} mm")
    aside = figures["hilo_mm"]
    print(
        f"hi-lo      axes {aside['axes_aside']:.3f} mm aside, greatest step outside "
        f"{aside['greatest_outside']:.3f} mm at {aside['at_deg']:.0f} deg, sigma {aside['sigma']:.3f} mm"
    )
    print(f"T          {span('T_mm')} mm, sigma {figures['T_sigma_mm']:.3f} mm")
    sigma = figures["W_sigma_mm"]
    print(f"W          {span('W_mm')} mm" + ("" if sigma is None else f", sigma {sigma:.3f} mm"))
    print(f"zone       density {span('zone_density_percent')} % of plain wall's")
    for flaw in found:
        print(
            f"{flaw['kind']:<10} at {flaw['phi_deg']:.1f} deg, {flaw['rho']:.2f} mm from the axis, "
            f"{flaw['from_joint_mm']:+.2f} mm from the joint, {flaw['snr']:.0f} sigma"
        )
    if not found:
        print("flaws      none seen in the wall; beads and the skin within two voxels are not looked at")
    for key, word in (("angles_without_zone", "zone"), ("angles_without_bead", "bead")):
        if figures[key]:
            print(f"note       {figures[key]} angles without a {word} that can be told")
