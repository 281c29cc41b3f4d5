"""`annulus joint`: butt-fusion joints, from a CT volume to what may be said of them."""

import contextlib
import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from annulus_pipe.cli.show import Json, group, progress
from annulus_pipe.vocabulary import AnnulusError

app = group("Butt-fusion joints: beads, heat-affected zone and flaws from a CT volume, and what strengths go with.")
SENSE_NAMES = {1: "same", -1: "mirrored", 0: "undecided"}
DIAMETER_AGREES, WALL_AGREES = 0.03, 0.15  # of what ct.json says the pipe has
TWIN_FEED_MM_MIN = 30_000.0  # a bench that nobody waits for


def agree(ct: Path, volume: Any, said_mm: float | None, found_mm: float, what: str, part: float) -> None:
    """AnnulusError where a length of the volume is further from what its ct.json says than that part of it."""
    if said_mm is not None and abs(found_mm - said_mm) > part * said_mm:
        raise AnnulusError(
            f"{ct}: {what} is {found_mm:.2f} mm in the volume and {said_mm:g} mm in ct.json; is the voxel "
            f"size of {' x '.join(f'{v:g}' for v in volume.voxel_mm)} mm right?"
        )


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
    from annulus_pipe.wings.joints.measure import Parts, features, image, maps, summary
    from annulus_pipe.wings.joints.pictures import write_joint
    from annulus_pipe.wings.joints.volume_file import open_volume

    parts = Parts(inner_mm, of_mm)
    volume = open_volume(ct, voxel_mm)
    with progress() as report:
        try:
            joint = image(volume, parts, report)
        except AnnulusError as error:
            raise AnnulusError(str(error) if str(ct) in str(error) else f"{ct}: {error}") from None
    for expected, found, name, part in (
        (volume.outer_diameter_mm, 2 * joint.found.radius_mm, "outer diameter", DIAMETER_AGREES),
        (volume.wall_mm, joint.found.wall_mm, "wall", WALL_AGREES),
    ):
        agree(ct, volume, expected, found, f"the pipe's {name}", part)
    figures = summary(joint)
    named = features(joint)
    files = write_joint(out, named, maps(joint), figures)
    if as_json:
        voxels = {"form": volume.form, "shape": list(volume.shape), "voxel_mm": list(volume.voxel_mm)}
        print(
            json.dumps({"volume": voxels, **figures, "flaws": named["found"], "files": [str(file) for file in files]})
        )
        return
    _print(volume, figures, named["found"])
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
    stage: Annotated[
        str | None, typer.Option("--linear-stage", help="Serial port of what carries the probe along, GRBL 1.1.")
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
    from annulus_pipe.wings.joints.linear_stage import LinearStage
    from annulus_pipe.wings.joints.probe import Probe, SampleProbe, VisaProbe
    from annulus_pipe.wings.joints.scan import RasterPlan, log_of, scan

    given = [one is not None for one in (port, stage, probe)]
    if twin == any(given) or any(given) != all(given):
        raise AnnulusError("give --port, --linear-stage and --probe, or --twin alone")
    queries = {name: key for name, key in (("amplitude_mv", amplitude), ("phase_mv", phase)) if key}
    if not twin and not queries:
        raise AnnulusError("give --amplitude, --phase or both: what the probe is asked for")
    plan = RasterPlan(angles, from_mm, to_mm, step_mm, averages, settle_ms, steps_per_turn, step_us)
    notes: list[str] = []
    with contextlib.ExitStack() as stack:
        report = stack.enter_context(progress())
        if twin:
            from annulus_pipe.twin.real_time import serving
            from annulus_pipe.wings.joints.simulated import QUERIES, bench

            rig = stack.enter_context(serving(bench(steps_per_turn)))
            port, stage, probe, homed = rig.port_url, rig.stage_url, rig.probe_name, True
            queries = {name: query for query, name in QUERIES.items()}
            feed = TWIN_FEED_MM_MIN
        assert port is not None and stage is not None and probe is not None
        carried = stack.enter_context(LinearStage(stage, axis=axis, feed_mm_min=feed))
        if home:
            carried.home()
        meter: Probe = (
            SampleProbe(probe, sensor, queries) if probe.startswith(("ipc://", "tcp://")) else VisaProbe(probe, queries)
        )
        stack.callback(meter.close)
        try:
            done = scan(port, carried, meter, plan, out, resume=resume, homed=homed, say=notes.append, progress=report)
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
    import numpy as np

    from annulus_pipe.wings.joints.measure.raster import Raster, Surface, at_joint, place
    from annulus_pipe.wings.joints.pictures import write_scan
    from annulus_pipe.wings.joints.raster_file import read_joint, read_raster
    from annulus_pipe.wings.joints.strength_file import read_features

    joint, maps = read_joint(folder)
    phi, curves = read_features(folder / "features.json", ["zj", "W"])
    if len(phi) != len(maps["phi_deg"]) or not np.isfinite(curves["zj"]).all():
        raise AnnulusError(f"{folder / 'features.json'}: phi_deg or zj, expected as in maps.npz")
    angle, z, channels = read_raster(raster)
    surface = Surface(
        maps["z_mm"],
        maps["bead_out_mm"],
        maps["density"],
        float(np.mean(maps["outer_mm"] - maps["bead_out_mm"])),
        float(np.mean(curves["zj"])),
    )
    try:
        placed = place(Raster(np.radians(angle), z, np.stack(list(channels.values()))), surface)
    except AnnulusError as error:
        raise AnnulusError(f"{raster}: {error}") from None
    microwave: dict[str, Any] = {
        "raster": str(raster),
        "accepted": placed.accepted,
        "why_not": placed.why,
        "shift_deg": float(np.degrees(placed.shift)),
        "shift_sigma_deg": float(np.degrees(placed.shift_sigma)),
        "sense": SENSE_NAMES[placed.sense],
        "sense_along": SENSE_NAMES[placed.along],
        "best_sense": SENSE_NAMES[placed.best_sense],
        "best_sense_along": SENSE_NAMES[placed.best_along],
        "as_likely": [
            {"sense": SENSE_NAMES[sense], "sense_along": SENSE_NAMES[along], "shift_deg": float(np.degrees(shift))}
            for sense, along, shift in placed.others
        ],
        "joint_at_raster_z_mm": placed.raster_joint_mm,
        "joint_at_raster_z_sigma_mm": placed.raster_joint_sigma_mm,
        "blur_sigma_mm": {"round": placed.blur_mm[0], "along": placed.blur_mm[1]},
        "explained": placed.explained,
        "p": placed.p,
        "log_odds_of_angle": placed.odds,
        "gains": {
            name: dict(zip(("bead_mv_per_mm", "density_mv", "bead_and_lift_per_mm"), gains.tolist(), strict=True))
            for name, gains in zip(channels, placed.gains, strict=True)
        },
    }
    laid = {
        f"{part}_{name}": one
        for part, both in (("joint", placed.joint_mv), ("material", placed.material_mv))
        for name, one in zip(channels, both, strict=True)
    }
    if placed.accepted and placed.sense:
        microwave["phi_deg"] = phi
        microwave |= {name: at_joint(one, maps["z_mm"], curves["zj"]) for name, one in laid.items()}
    drawn = {"phi_deg": phi, "zj": curves["zj"], "W": curves["W"]}
    files = write_scan(folder, joint, microwave, drawn, maps, laid)
    if as_json:
        print(
            json.dumps(
                {k: v for k, v in microwave.items() if k != "phi_deg" and k not in laid} | {"files": [*map(str, files)]}
            )
        )
        return
    print(f"raster     {len(angle)} angles x {len(z)} z, {' and '.join(channels)}")
    print(
        f"lies at    shift {microwave['shift_deg']:.1f} deg, sigma {microwave['shift_sigma_deg']:.1f}; the joint at z "
        f"{placed.raster_joint_mm:.2f} mm of the raster, sigma {placed.raster_joint_sigma_mm:.2f}"
    )
    print(f"sense      of angle {microwave['sense']}, along the pipe {microwave['sense_along']}")
    for other in microwave["as_likely"]:
        print(
            f"as likely  shift {other['shift_deg']:.1f} deg, of angle {other['sense']}, "
            f"along the pipe {other['sense_along']}"
        )
    print(f"blur       {placed.blur_mm[0]:.1f} mm round the pipe, {placed.blur_mm[1]:.1f} mm along it (sigma)")
    print(f"explained  {100 * placed.explained:.0f} % of what varies with the angle; p of the search {placed.p:.3f}")
    print(f"accepted   {'yes' if placed.accepted else 'no: ' + placed.why}")
    if placed.accepted:
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
