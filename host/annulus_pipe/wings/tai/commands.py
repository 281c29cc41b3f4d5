"""`annulus tai`: thermoacoustics, from coded bursts to an image."""

import contextlib
import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import ChipUs, Json, progress, verbs
from annulus_pipe.controller import BURST_REPEAT_MAX
from annulus_pipe.vocabulary import AnnulusError

app = verbs()

Code = Annotated[
    str, typer.Option(help="single, mpsl25, mpsl25-stuffed, barker13, manchester1, manchester2, or 0s and 1s.")
]
PowerKw = Annotated[float, typer.Option(help="Of the microwave source, peak, kW.")]
Standoff = Annotated[float, typer.Option(help="Receivers to the plate, mm of air.")]
ReceiverDb = Annotated[float, typer.Option(help="The receiver's noise over air's thermal noise at its face, dB.")]


@app.command(
    "simulate",
    epilog="Example: annulus tai simulate --phantom wires --code mpsl25-stuffed --noise 0.05 -o raw.hdf5 && "
    "annulus tai simulate --single-sided -o plate.hdf5",
)
def simulate_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write: .hdf5 (IPASC) or .npz.")],
    phantom: Annotated[str, typer.Option(help="inclusions, core, wires, shapes.")] = "inclusions",
    code: Code = "mpsl25-stuffed",
    chip_us: ChipUs = 0.5,
    positions: Annotated[int, typer.Option(min=3, max=1024, help="Angles of the turntable.")] = 50,
    radius_mm: Annotated[
        float, typer.Option(min=1.0, max=500.0, help="Receiver to the axis of the turntable, mm.")
    ] = 25.0,
    rate_mhz: Annotated[float, typer.Option(min=0.5, max=1000.0, help="Sampling rate, MHz.")] = 25.0,
    sound_speed: Annotated[float, typer.Option(min=300.0, max=6000.0, help="m/s.")] = 1480.0,
    noise: Annotated[float, typer.Option(min=0.0, help="Rms of one shot, in pressures of one pulse.")] = 0.02,
    averages: Annotated[int, typer.Option(min=1, max=1_000_000, help="Shots averaged at each angle.")] = 1,
    spike: Annotated[float, typer.Option(min=0.0, help="Coupling of the microwave into the receiver.")] = 0.0,
    band_mhz: Annotated[float, typer.Option(min=0.0, help="Centre of the transducer, MHz; 0 hears everything.")] = 2.25,
    bandwidth: Annotated[
        float, typer.Option(min=0.05, max=1.9, help="Its width at -6 dB, as part of the centre.")
    ] = 0.7,
    aperture_mm: Annotated[float, typer.Option(min=0.0, max=100.0, help="Width of the receiver's face, mm.")] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise.")] = 1,
    single_sided: Annotated[
        bool, typer.Option("--single-sided", help="A plate of glass and epoxy from one side, through air, instead.")
    ] = False,
    plate: Annotated[
        Path | None, typer.Option(help="Its defects, TOML: [[delamination]] and [[water]]. Default: one delamination.")
    ] = None,
    sequence: Annotated[
        str, typer.Option(help="Of a plate: single, mpsl25-stuffed, manchester, golay64, golay128, m127, m255.")
    ] = "manchester",
    seconds: Annotated[float, typer.Option(help="Of a plate: time a position, s.")] = 35.0,
    power_kw: PowerKw = 5.0,
    standoff_mm: Standoff = 20.0,
    receiver_db: ReceiverDb = 20.0,
) -> None:
    """One turn of the turntable about a known sample, with real propagation, receiver and noise.

    With --single-sided: 51 positions before one face of a plate (`annulus tai budget` has its noise). What is in the
    plate goes into FILE.truth.json beside the shots, which do not have it.
    """
    if single_sided:
        _simulate_plate(out, plate, sequence, seconds, (power_kw, standoff_mm, receiver_db), seed)
        return
    if plate is not None:
        raise AnnulusError("--plate goes with --single-sided")
    from annulus_pipe.wings.tai.acoustic_file import save_acoustic
    from annulus_pipe.wings.tai.measure.confinement import confinement
    from annulus_pipe.wings.tai.measure.phantoms import phantom as named
    from annulus_pipe.wings.tai.measure.phantoms import smallest_mm
    from annulus_pipe.wings.tai.simulate import Setup, simulate

    setup = Setup(
        code,
        1e-6 * chip_us,
        radius_mm,
        positions,
        1e6 * rate_mhz,
        sound_speed,
        1.0,
        noise,
        averages,
        (1e6 * band_mhz, bandwidth) if band_mhz else None,
        aperture_mm,
        spike,
        seed,
    )
    for warning in confinement(smallest_mm(named(phantom)), 1e-6 * chip_us, sound_speed).warnings:
        print(f"warning    {warning}")
    with progress() as report:
        record = simulate(named(phantom), setup, report)
    save_acoustic(out, record)
    print(f"{len(record.signals)} positions of {record.signals.shape[1]} samples  {out}")


def _simulate_plate(
    out: Path, plate: Path | None, sequence: str, seconds: float, rig: tuple[float, float, float], seed: int
) -> None:
    from annulus_pipe.wings.tai import single_sided
    from annulus_pipe.wings.tai.measure.budget import SingleSidedRig

    single_sided.require_plate_name(out)
    power_kw, standoff_mm, receiver_db = rig
    setup = SingleSidedRig(power_w=1e3 * power_kw, standoff_mm=standoff_mm, receiver_db=receiver_db)
    sample = single_sided.read_plate(plate) if plate else single_sided.EXAMPLE
    with progress() as report:
        record = single_sided.simulate_plate(sample, setup, sequence, seconds, seed, report)
    single_sided.save_plate(out, record)
    truth = out.with_suffix(".truth.json")
    single_sided.save_truth(truth, sample)
    bursts, positions, samples = record.shots.shape
    print(f"{positions} positions, {bursts} x {record.averages} bursts of {samples} samples  {out}")
    print(f"truth      {truth}")


@app.command(
    "acquire",
    epilog="Example: annulus tai acquire --port /dev/ttyACM0 --scope TCPIP::192.168.1.20::5025::SOCKET "
    "--averages 64 -o raw.hdf5. Without hardware: annulus tai acquire --twin -o raw.hdf5",
)
def acquire_command(
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write: .hdf5 (IPASC) or .npz.")],
    port: Annotated[
        str | None, typer.Option(help="Serial port of the controller: /dev/ttyACM0, a pty, socket://host:port.")
    ] = None,
    scope: Annotated[
        str | None, typer.Option(help="VISA name of the digitizer: TCPIP::host::5025::SOCKET, TCPIP::host::INSTR.")
    ] = None,
    twin: Annotated[bool, typer.Option("--twin", help="On the twin's rig, with the controller's own code.")] = False,
    phantom: Annotated[str, typer.Option(help="Of the twin: inclusions, core, wires, shapes.")] = "inclusions",
    code: Code = "mpsl25-stuffed",
    chip_us: ChipUs = 0.5,
    angles: Annotated[int, typer.Option(min=1, max=1024, help="Over one turn of the turntable.")] = 50,
    averages: Annotated[int, typer.Option(min=1, max=BURST_REPEAT_MAX, help="Bursts at each angle.")] = 16,
    period_us: Annotated[float, typer.Option(help="Chip 0 to chip 0, us.")] = 1000.0,
    trigger_offset_us: Annotated[
        float, typer.Option(help="Digitizer trigger after chip 0, us; may be negative.")
    ] = 0.0,
    radius_mm: Annotated[
        float, typer.Option(min=1.0, max=500.0, help="Receiver to the axis of the turntable, mm.")
    ] = 25.0,
    sound_speed: Annotated[float, typer.Option(min=300.0, max=6000.0, help="m/s.")] = 1480.0,
    rate_mhz: Annotated[float, typer.Option(min=0.1, max=5000.0, help="Sampling rate at least, MHz.")] = 10.0,
    duration_us: Annotated[
        float | None, typer.Option(min=1.0, max=1e6, help="Of a record, us. Default: the way across and the code.")
    ] = None,
    range_v: Annotated[float, typer.Option(help="Full scale of the digitizer, V.")] = 0.08,
    channel: Annotated[int, typer.Option(min=1, max=4, help="Of the digitizer; the trigger goes to EXT.")] = 1,
    arm_ms: Annotated[
        float, typer.Option(min=0.0, max=5000.0, help="The digitizer takes to wait for triggers.")
    ] = 50.0,
    steps_per_turn: Annotated[int, typer.Option(min=3, max=1_000_000, help="Of the turntable.")] = 400,
    step_us: Annotated[float, typer.Option(min=100.0, max=1e6, help="Step to step, us.")] = 1000.0,
    encoder: Annotated[
        int, typer.Option(min=0, help="Counts a turn of an encoder on the turntable; 0: there is none.")
    ] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the file: shoot what it has not yet.")] = False,
    homed: Annotated[
        bool, typer.Option("--homed", help="With --resume: the turntable was put back to its first angle by hand.")
    ] = False,
    as_json: Json = False,
) -> None:
    """One turn of the turntable: burst and record at every angle. The microwave is armed for each shot by itself.

    The file is whole after every shot; Ctrl-C, a fault or a lost digitizer ends the sweep with what it has (status not
    0), --resume goes on. A fault has to be cleared first (`annulus head clear`).
    """
    from annulus_pipe.wings.tai.acquire import SweepPlan, acquire
    from annulus_pipe.wings.tai.digitizer import ScopeDigitizer

    if twin == (port is not None or scope is not None) or (port is None) != (scope is None):
        raise AnnulusError("give --port and --scope, or --twin alone")
    plan = SweepPlan(
        code,
        chip_us,
        angles,
        averages,
        period_us,
        trigger_offset_us,
        radius_mm,
        sound_speed,
        rate_mhz,
        duration_us,
        range_v,
        steps_per_turn,
        step_us,
        encoder,
    )
    notes: list[str] = []
    with contextlib.ExitStack() as stack:
        report = stack.enter_context(progress())
        if twin:
            from annulus_pipe.twin.real_time import serving
            from annulus_pipe.wings.tai.simulated.rig import rig_named

            rig = stack.enter_context(
                serving(rig_named(phantom, radius_mm, sound_speed, steps_per_turn, progress=report))
            )
            port, scope, homed = rig.port_url, rig.scope_name, True
        assert port is not None and scope is not None
        digitizer = stack.enter_context(ScopeDigitizer(scope, channel=channel, settle_s=1e-3 * arm_ms))
        try:
            done = acquire(port, digitizer, plan, out, resume=resume, homed=homed, say=notes.append, progress=report)
        finally:
            stack.close()
            for note in notes:
                print(f"note       {note}", file=sys.stderr)
    if as_json:
        print(json.dumps(done.to_dict()))
        return
    for finding in done.findings:
        print(f"warning    {finding}")
    print(
        f"shot       {done.shot} of {done.positions} angles in {done.seconds:.1f} s, {done.retries} shots again, "
        f"{done.sampling_rate_hz / 1e6:.4g} MHz"
    )
    print(f"sweep      {out}")


@app.command("decode", epilog="Example: annulus tai decode raw.hdf5 -o decoded.hdf5")
def decode_command(
    source: Annotated[Path, typer.Argument(help="Raw sweep: .hdf5 (IPASC) or .npz.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write.")],
    second: Annotated[Path | None, typer.Option(help="The pair's second sweep (manchester2).")] = None,
    template: Annotated[Path | None, typer.Option(help="From `annulus burst design -o`; default: minimax.")] = None,
    as_json: Json = False,
) -> None:
    """Compress a coded sweep into what one pulse would have been heard as."""
    from annulus_pipe.wings.tai.decode import decode_file

    answer = decode_file(source, out, second, template)
    if as_json:
        print(json.dumps(answer))
        return
    if answer["detected_code"]:
        print(f"warning    it sounds like {answer['detected_code']}, not {answer['code']}")
    if "psr" in answer:
        print(
            f"template   {answer['code']}: sidelobes 1/{answer['psr']:.1f}, {answer['gain_db']:.2f} dB over one pulse"
        )
    print(f"decoded    {out}")


@app.command(
    "image",
    epilog="Example: annulus tai image raw.hdf5 -o result --search 1400 1600 --band 0.3 3 --region -8 8 -8 8. "
    "Takes IPASC .hdf5, or .npz with signals "
    "[positions, samples], angles_deg, radius_mm, sampling_rate_hz, and if known t0_s, sound_speed_m_s.",
)
def image_command(
    source: Annotated[Path, typer.Argument(help="Sweep, raw or decoded: .hdf5 (IPASC) or .npz.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for image.npz and image.png; made if need be.")],
    method: Annotated[str, typer.Option(help="time-reversal, or back-projection for a quick look.")] = "time-reversal",
    pixel_mm: Annotated[float | None, typer.Option(help="Default: as fine as the sound's band.")] = None,
    sound_speed: Annotated[float | None, typer.Option(help="m/s. Default: as recorded, else water.")] = None,
    search: Annotated[
        tuple[float, float] | None, typer.Option(help="Find the speed of sound between these, m/s.")
    ] = None,
    refine: Annotated[int, typer.Option(min=0, max=50, help="Neumann refinements at most.")] = 0,
    nonnegative: Annotated[
        bool, typer.Option("--nonnegative", help="While refining; not for band-limited sound.")
    ] = False,
    object_radius_mm: Annotated[
        float | None, typer.Option(help="The sample lies within. Default: 0.85 of the circle.")
    ] = None,
    template: Annotated[Path | None, typer.Option(help="For a coded sweep, from `annulus burst design -o`.")] = None,
    sound: Annotated[
        str | None,
        typer.Option(
            help="space (of small parts, as real sound is) or plane (of long ones, and the twin's). Default: as "
            "recorded, else as receivers agree better."
        ),
    ] = None,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Use only the sound between these, MHz. Example: --band 0.3 3 takes hum and hiss away."),
    ] = None,
    region: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            metavar="X0 X1 Y0 Y1",
            help="Show only this part, mm, and search the speed in it. Example: --region -8 8 -5 5.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """The sample's absorbed power from the sound around it.

    --search finds the speed of sound at which receivers agree, and says what it would be were the sound of the other
    kind (--sound). A receiver that agrees with no other is named and left out. Single-sided shots of a plate are known
    by themselves: what is found is listed with kind, place, depth, width and their sigma, and options have no say.
    """
    from annulus_pipe.wings.tai import single_sided

    if single_sided.is_plate(source):
        found = single_sided.image_plate(source, out)
        print(json.dumps(found) if as_json else "\n".join(single_sided.plate_lines(found)))
        if not as_json:
            print(f"image      {out / 'image.png'}, {out / 'image.npz'}")
        return
    from annulus_pipe.wings.tai.image import ImageSettings, make_image
    from annulus_pipe.wings.tai.measure.imaging import Region

    if method not in ("time-reversal", "back-projection"):
        raise AnnulusError(f"--method {method!r}: expected time-reversal or back-projection")
    if sound not in (None, "space", "plane"):
        raise AnnulusError(f"--sound {sound!r}: expected space or plane")
    if search is not None and sound_speed is not None:
        raise AnnulusError("--search and --sound-speed: give one of them")
    settings = ImageSettings(
        method,  # type: ignore[arg-type]
        pixel_mm,
        sound_speed,
        search,
        (1e6 * band[0], 1e6 * band[1]) if band else None,
        sound,  # type: ignore[arg-type]
        Region(*region) if region else None,
        object_radius_mm,
        refine,
        nonnegative,
    )
    with progress() as report:
        result = make_image(source, out, settings, template, report)
    if as_json:
        print(json.dumps(result.to_dict()))
        return
    for finding in result.findings:
        print(f"note       {finding}")
    for start, stop in result.holes_deg:
        print(f"hole       nothing was heard from {start:.1f} to {stop:.1f} deg")
    print(f"method     {result.method}, {result.positions - len(result.excluded)} of {result.positions} positions")
    how = "found" if result.sound_speed_searched else "taken"
    print(f"speed      {result.sound_speed_m_s:.1f} m/s ({how})")
    print(f"pixel      {result.pixel_mm:.3f} mm, {result.size[0]} x {result.size[1]}")
    print(f"image      {out / 'image.png'}, {out / 'image.npz'}")


@app.command("budget", epilog="Example: annulus tai budget --depth-mm 8 --standoff-mm 20")
def budget_command(
    depth_mm: Annotated[float, typer.Option(help="Of the defect, below the face, mm.")] = 8.0,
    power_kw: PowerKw = 5.0,
    standoff_mm: Standoff = 20.0,
    receiver_db: ReceiverDb = 20.0,
    as_json: Json = False,
) -> None:
    """What single-sided sound through air has to make up, in dB, each term with its source; what codes make of it.

    Of a delamination and of a water pocket (1 mm thick), both 12 mm wide, in a plate of 20 mm of glass and epoxy.
    """
    from annulus_pipe.wings.tai import show
    from annulus_pipe.wings.tai.measure.budget import SingleSidedRig

    rig = SingleSidedRig(power_w=1e3 * power_kw, standoff_mm=standoff_mm, receiver_db=receiver_db)
    fields = show.budget_fields(rig, depth_mm)
    print(json.dumps(fields) if as_json else "\n".join(show.budget_lines(fields)))
