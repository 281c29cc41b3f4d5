"""`annulus calibrate`: the camera, the rings, the paint; every answer goes into one calibration.json."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from annulus_pipe.cli.show import Json, progress, verbs
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.calibrate.camera import CameraCalibration

app = verbs()


@app.command("camera", epilog="Example: annulus calibrate camera target/*.jpg --square-mm 25 -o head-7.json")
def camera(
    images: Annotated[list[Path], typer.Argument(help="Photographs of a flat target, or folders of them.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="calibration.json; other sections in it are kept.")] = Path(
        "calibration.json"
    ),
    model: Annotated[
        str | None, typer.Option(help="pinhole or fisheye; if not given, the one that fits clearly better.")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(help='Inner corners of a chessboard, "9x6", or squares of a ChArUco board, "charuco 8x6".'),
    ] = None,
    square_mm: Annotated[float, typer.Option(min=0.01, max=10000.0, help="Side of a square, mm.")] = 25.0,
    crop: Annotated[
        str | None,
        typer.Option(
            "--sensor-crop",
            metavar="X,Y,W,H",
            help="What the sensor's mode shows of it, as `annulus daemon --check` has it; others are refused.",
        ),
    ] = None,
    second: Annotated[
        Path | None, typer.Option(help="Folder of photographs by the head's second camera, taken at the same moments.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Where to draw what the lens is worth. [default: FILE.camera.png]")
    ] = None,
    as_json: Json = False,
) -> None:
    """The camera from photographs of a chessboard or ChArUco board, from nothing but them.

    The target may be of any size, partly seen, through any lens; bad photographs are left out and named. Ten to twenty
    photographs, the target filling half the image, tilted 30 to 45 degrees, and in every corner of it.

    With --second both cameras of a head are measured, and where the second stands: photographs of one moment have one
    name in both folders, or one place in their order. `annulus calibrate pipe` then says how the rings agree with it.
    """
    if model not in (None, "pinhole", "fisheye"):
        raise AnnulusError(f'--model is "{model}", expected pinhole or fisheye')
    field = None if crop is None else _field(crop)
    from annulus_pipe.calibrate.both import join_cameras, pair_files, save_both
    from annulus_pipe.calibrate.camera import calibrate_camera, image_files, save_camera

    files = [image_files(images), *([] if second is None else [image_files([second])])]
    pairs = pair_files(*files) if second is not None else []
    if field is not None and second is not None:
        raise AnnulusError("--sensor-crop does not go with --second: give it for each camera by itself")
    with progress() as bars:
        results = [
            calibrate_camera(
                each,
                model=model,  # type: ignore[arg-type]
                target=target,
                square_mm=square_mm,
                progress=bars,
            )
            for each in files
        ]
    both = join_cameras(results[0], results[1], pairs) if second is not None else None
    stale = save_camera(results[0], out, field) if both is None else save_both(both, out)
    from annulus_pipe.calibrate.camera_picture import draw_camera

    picture = picture or out.with_suffix(".camera.png")
    pictures = [picture, picture.with_stem(f"{picture.stem}-second")][: len(results)]
    for result, drawn in zip(results, pictures, strict=True):
        draw_camera(result, drawn)
    if as_json:
        shown = {"file": str(out), "picture": str(picture)}
        if both is None:
            print(json.dumps({**results[0].to_dict(), **shown}))
        else:
            print(json.dumps({"cameras": [one.to_dict() for one in results], **both.to_dict(), **shown}))
        return
    for result in results:
        _show_camera(result)
    if both is not None:
        x, y, z = both.placed.centre_mm
        figures = both.to_dict()
        used = sum(one["used"] for one in figures["moments"])
        print(f"moments    {used} of {len(pairs)} say where the second camera stands")
        for names in both.left_out:
            print(f"           {names[0]} and {names[1]} LEFT OUT: not of one moment, they contradict the others")
        print(
            f"second     turned {figures['turned_deg']:.3f} +- {figures['turned_sigma_deg']:.3f} deg, at {x:.3f} "
            f"{y:.3f} {z:.3f} +- {max(figures['centre_sigma_mm']):.3f} mm from the first"
        )
    if stale:
        print(f"warning    the rings in {out} were measured with the camera before this one: calibrate them again")
    print(f"written    {', '.join(map(str, (out, *pictures)))}")


def _show_camera(result: "CameraCalibration") -> None:
    figures = result.to_dict()
    for one in result.photographs:
        state = f"{one.rms_px:6.3f} px" if one.rms_px == one.rms_px else "        -"
        odd = f", {one.left_out} left out" if one.left_out else ""
        print(
            f"{one.file:<24} {state}  {one.corners:4d} corners{odd}"
            + (f"  REJECTED {one.rejected}" * bool(one.rejected))
        )
    lens, sigma = result.camera, figures["sigma"]
    kept = [one for one in result.photographs if not one.rejected]
    own = sum(one.own_origin for one in kept)
    print(f"target     {result.target}{'' if result.target_was_given else ' (found out)'}")
    print(f"origin     {f'its own, in {own} of {len(kept)} photographs' if own else 'the first corner seen'}")
    print(f"camera     {lens.model} {lens.width}x{lens.height}")
    print(f"focal      {lens.fx:.2f} +- {sigma['fx']:.2f}, {lens.fy:.2f} +- {sigma['fy']:.2f} px")
    print(f"centre     {lens.cx:.2f} +- {sigma['cx']:.2f}, {lens.cy:.2f} +- {sigma['cy']:.2f} px")
    print("distortion " + " ".join(f"{value:.5f}" for value in lens.distortion))
    print(
        f"rms        {figures['rms_px']:.3f} px over {figures['kept']} of {figures['found']} photographs "
        f"({figures['rms_everything_px']:.3f} px with nothing left out)"
    )
    spread = figures["ray_sigma_px"]
    print(f"rays       known to {spread['median']:.3f} px (median corner), {spread['worst']:.3f} px (worst)")
    print(f"coverage   {100 * result.coverage:.0f} % of the image")
    for warning in result.warnings:
        print(f"warning    {warning}")


@app.command("colour", epilog="Example: annulus calibrate colour scans/yellow --calibration head-7.json -o yellow.json")
def colour(
    scan: Annotated[Path, typer.Argument(help="Scan folder or recording (.mcap); a few projector frames will do.")],
    calibration: Annotated[Path, typer.Option(help="calibration.json of the head.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="File of the pipe's colours.")] = Path("colour.json"),
    red_gain: Annotated[float, typer.Option(min=0.01, max=64.0, help="Red white-balance gain that was set.")] = 1.0,
    blue_gain: Annotated[float, typer.Option(min=0.01, max=64.0, help="Blue white-balance gain that was set.")] = 1.0,
    reference_u: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=10.0,
            help="This pipe's inner diameter is the calibration's within so many mm (k = 2): measure how far light "
            "goes on in its wall, and write it into the calibration.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """What the stripes look like on a pipe of this colour, and the white balance to set for it.

    Give the file to `annulus reconstruct --colour`. Set the gains on the camera (ColourGains of Picamera2), white
    balance off automatic, take frames again and learn again: then the weak channel is above the camera's noise.

    Light enters polyethylene and leaves it a little farther on, and a head that was calibrated in an opaque pipe reads
    it 0.2 to 0.5 mm too wide in radius. In a piece of it whose diameter is known, --reference-u measures that.
    """
    from annulus_pipe.calibrate.colour import calibrate_colour
    from annulus_pipe.calibrate.wall import MeasuredWall, save_wall
    from annulus_pipe.storage.calibration_file import save_part

    with progress() as bars:
        learnt = calibrate_colour(
            scan, calibration, camera_gains=(red_gain, blue_gain), diameter_u_mm=reference_u, progress=bars
        )
    profile, wall = learnt.profile, learnt.wall
    save_part(out, profile.to_dict())
    if isinstance(wall, MeasuredWall):
        save_wall(wall, calibration, reference_u or 0.0)
    if as_json:
        part = {"wall": wall.to_dict()} if isinstance(wall, MeasuredWall) else {"wall": None, "wall_not_measured": wall}
        print(json.dumps({**profile.to_dict(), **part, "warnings": list(learnt.warnings), "file": str(out)}))
        raise typer.Exit(1 if isinstance(wall, str) else 0)
    print(f"frames       {profile.frames} of {learnt.looked_at} showed every ring")
    print("             stripe  red    green  blue")
    for name, row, own in zip(("red", "green", "blue"), profile.crosstalk, profile.reflectance, strict=True):
        print(f"{name:<12} sees    " + "  ".join(f"{value:5.3f}" for value in row) + f"   brings {100 * own:.0f} %")
    before, after = profile.separation
    print(f"separation   {before:.0f} degrees as they come, {after:.0f} with this profile (90 is perfect)")
    before, after = profile.named
    print(f"named right  {100 * before:.2f} % by their brightest channel, {100 * after:.2f} % with this profile")
    print(f"set gains    red {profile.gains[0]:.2f}, blue {profile.gains[1]:.2f} (green 1)")
    for warning in learnt.warnings:
        print(f"warning      {warning}")
    if isinstance(wall, MeasuredWall):
        moved = ", ".join(
            f"{name} {value:.3f} +- {sigma:.3f}"
            for name, value, sigma in zip(("red", "green", "blue"), wall.shift_mm, wall.sigma_mm, strict=True)
        )
        print(f"wall         light leaves it {moved} mm farther on; radii were read {wall.wider_mm:+.3f} mm wide")
        print(f"written      {out}; section wall of {calibration}")
        return
    print(f"wall         not measured: {wall or 'needs a pipe whose diameter is known, and --reference-u'}")
    print(f"written      {out}")
    if wall is not None:
        raise typer.Exit(1)


@app.command(
    "reference", epilog="Example: annulus calibrate reference scans/clean --calibration head-7.json -o ref.json"
)
def reference(
    scan: Annotated[Path, typer.Argument(help="Scan folder or recording (.mcap) in a clean, round pipe.")],
    calibration: Annotated[Path, typer.Option(help="calibration.json of the head.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="File of the pattern's artefacts.")] = Path("reference.json"),
    radius: Annotated[
        float | None, typer.Option(min=1.0, max=5000.0, help="Radius of that pipe, mm. [default: the calibration's]")
    ] = None,
    as_json: Json = False,
) -> None:
    """What the projected pattern is off its cones, per ring and direction, from one frame or more in a clean pipe.

    Give the file to `annulus reconstruct --reference`. Take several frames, the head leaning and standing as it will.
    """
    from math import degrees, hypot, isnan

    from annulus_pipe.calibrate.reference import calibrate_reference
    from annulus_pipe.storage.calibration_file import save_part

    with progress() as bars:
        learnt = calibrate_reference(scan, calibration, radius_mm=radius, progress=bars)
    artefacts = learnt.reference
    save_part(out, artefacts.to_dict())
    figures = {"frames": len(artefacts.poses), "before_mm": artefacts.before_mm, "known_percent": 100 * artefacts.known}
    if not isnan(artefacts.after_mm):
        figures["after_mm"] = artefacts.after_mm
    if as_json:
        print(json.dumps({**figures, "warnings": list(learnt.warnings), "file": str(out)}))
        return
    print(f"frames     {len(artefacts.poses)} of {learnt.looked_at} showed the pipe")
    lean = max(hypot(p.rx, p.ry) for p in artefacts.poses)
    shift = max(hypot(p.tx, p.ty) for p in artefacts.poses)
    print(f"poses      up to {degrees(lean):.2f} degrees and {shift:.1f} mm off the axis")
    after = (
        "unknown after it" if isnan(artefacts.after_mm) else f"{artefacts.after_mm:.3f} mm after it, on frames kept out"
    )
    print(f"radius     rms {artefacts.before_mm:.3f} mm before the correction, {after}")
    print(f"seen       {100 * artefacts.known:.1f} % of all directions of all rings; elsewhere nothing is corrected")
    for warning in learnt.warnings:
        print(f"warning    {warning}")
    print(f"written    {out}")


@app.command(
    "target",
    epilog="Example: annulus calibrate target scans/t --camera head.json --square-mm 30 --radius 76.2 -o head.json",
)
def target(
    scan: Annotated[Path, typer.Argument(help="Scan folder or recording of pairs; see below.")],
    camera: Annotated[Path, typer.Option(help="File with the `camera` section, and `pattern` if it has one.")],
    square_mm: Annotated[float, typer.Option(min=0.1, max=10000.0, help="Side of a square, mm: it sets the scale.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="calibration.json; other sections in it are kept.")] = Path(
        "calibration.json"
    ),
    colours: Annotated[
        str | None, typer.Option(help="Stripes from the innermost outwards, like RRGBGR; if the file has no pattern.")
    ] = None,
    radius: Annotated[float | None, typer.Option(min=1.0, max=5000.0, help="Radius of the pipe to scan, mm.")] = None,
    as_json: Json = False,
) -> None:
    """The rings from a flat target: angles, axes and vertices.

    The scan has, for each of 15 to 20 places of a chessboard or ChArUco board before the head, two frames taken
    without touching either: light "led" (the target in white light) and light "projector" (the rings on it). Frames
    with the same z_mm belong together: number the places there, 0, 1, 2 .. With one z_mm throughout, a projector frame
    goes with the led frame before it. Hold the target near and far, tilted 20 to 40 degrees every way; only slits on
    white paper count, so big squares and wide margins help.
    """
    from annulus_pipe.calibrate.target import calibrate_target, save_target
    from annulus_pipe.geometry.calibration import camera_to_dict
    from annulus_pipe.storage.calibration_file import load_camera, load_sections

    lens, given = load_camera(camera), load_sections(camera)
    pattern = given.get("pattern")
    stripes = colours or (pattern.get("colours") if isinstance(pattern, dict) else None)
    if not isinstance(stripes, str) or len(stripes) < 2 or set(stripes) - set("RGB"):
        raise AnnulusError(f"{camera}: no pattern.colours, or not letters R, G, B. Give --colours, like RRGBGR.")
    pipe = given.get("pipe")
    if radius is None and isinstance(pipe, dict) and isinstance(pipe.get("radius_mm"), int | float):
        radius = float(pipe["radius_mm"])
    with progress() as bars:
        result = calibrate_target(scan, lens, stripes, square_mm, bars)
    save_target(result, camera_to_dict(lens), radius, out)
    figures = result.to_dict()
    if as_json:
        print(json.dumps({**figures, "file": str(out)}))
        return
    for pair in result.pairs:
        if pair.rejected:
            print(f"{pair.rings:<24} REJECTED {pair.rejected}")
        else:
            print(
                f"{pair.rings:<24} {pair.rms_mm:6.3f} mm  {pair.points:5d} points  target {pair.pose_px:.2f} px, "
                f"{pair.distance_mm:.0f} mm away, {pair.tilt_deg:.0f} deg"
            )
    print("ring  full angle         axis x, y           vertex mm                                rms mm")
    rows = zip(
        result.cones, figures["sigma_theta_full_deg"], figures["sigma_vertex_mm"], figures["ring_rms_mm"], strict=True
    )
    for k, (cone, angle, vertex, rms) in enumerate(rows):
        places = " ".join(f"{v:8.3f}+-{s:.3f}" for v, s in zip(cone.vertex_mm, vertex, strict=True))
        full = 2 * math.degrees(cone.half_angle)
        print(f"{k:4d}  {full:8.3f}+-{angle:.3f}  {cone.axis[0]:8.4f} {cone.axis[1]:8.4f}  {places}  {rms:.3f}")
    print(
        f"rms        {result.rms_mm:.3f} mm over {figures['points']} points ({figures['outliers']} outliers left out)"
    )
    for warning in result.warnings:
        print(f"warning    {warning}")
    if radius is None:
        print("warning    no pipe radius in the file: give --radius before reconstructing")
    print(f"written    {out}")


@app.command(
    "pipe", epilog="Example: annulus calibrate pipe scans/tube --camera camera.json --radius 76.2 -o head-7.json"
)
def pipe(
    scan: Annotated[Path, typer.Argument(help="Scan folder or recording (.mcap) taken in a clean, round pipe.")],
    camera: Annotated[Path, typer.Option(help="File with the camera and pattern.colours; a calibration.json will do.")],
    radius: Annotated[float, typer.Option(help="The pipe's inner radius, mm. It alone sets the scale of the answer.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="calibration.json; other sections in it are kept.")] = Path(
        "calibration.json"
    ),
    pattern: Annotated[str, typer.Option(help="slits, or line: bright rings or planes of one colour.")] = "slits",
    lines: Annotated[
        int | None, typer.Option(min=1, max=16, help="How many bright lines, with --pattern line. [default: 1]")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Where to draw what is left over. [default: FILE.pipe.png]")
    ] = None,
    as_json: Json = False,
) -> None:
    """The projector's rings from a clean pipe of known radius, from nothing but the camera.

    Lean the head about 10 degrees to the left, to the right, up and down, and stand off the axis that way, a frame or
    two each; eight frames are plenty. No target, no marks. The pipe may be any that is round and clean.

    With --pattern line the head has bright rings or flat planes of a laser in place of a slide of slits. Where the file
    lists several cameras, the scan has frames of all, and where they stand is found along.
    """
    if pattern not in ("slits", "line"):
        raise AnnulusError(f'--pattern is "{pattern}", expected slits or line')
    if lines is not None and pattern != "line":
        raise AnnulusError("--lines goes with --pattern line: slits are counted by the file's pattern.colours")
    from annulus_pipe.calibrate.head import calibrate_head
    from annulus_pipe.calibrate.pipe import calibrate_pipe, save_pipe
    from annulus_pipe.geometry.calibration import several_cameras
    from annulus_pipe.storage.calibration_file import load_sections

    with progress() as bars:
        if pattern == "slits" and several_cameras(load_sections(camera)):
            result = calibrate_head(scan, camera, radius, progress=bars)
        else:
            result = calibrate_pipe(scan, camera, radius, lines=(lines or 1) if pattern == "line" else 0, progress=bars)
    from annulus_pipe.calibrate.pipe_picture import draw_pipe

    save_pipe(result, out)
    picture = picture or out.with_suffix(".pipe.png")
    draw_pipe(result, picture)
    figures = result.to_dict()
    if as_json:
        print(json.dumps({**figures, "file": str(out), "picture": str(picture)}))
        return
    for index, why in result.left_out.items():
        print(f"frame {index:<6} LEFT OUT: {why}")
    print(
        "ring   full angle, deg        axis x    axis y    vertex, mm                        residual         held out"
    )
    for k, ring in enumerate(figures["rings"]):
        x, y, z = ring["vertex_mm"]
        held = ring["held_out_mm"]
        print(
            f"{k + 1:<4} {ring['theta_full_deg']:9.4f} +- {ring['theta_full_sigma_deg']:.4f}   "
            f"{ring['axis'][0]:8.5f}  {ring['axis'][1]:8.5f}  {x:7.3f} {y:7.3f} {z:8.3f} "
            f"+- {max(ring['vertex_sigma_mm']):.3f}   {ring['residual_px']:.3f} px {ring['residual_mm']:.3f} mm"
            + ("" if held is None else f"   {held:.3f} mm")
        )
    print(f"frames     {len(result.frames)} of {result.found} used")
    if figures["held_out_mm"] is not None:
        kept = "kept" if figures["corrected"] else "not kept"
        corrected = figures["held_out_corrected_mm"]
        print(
            f"radius     {figures['held_out_mm']:.3f} mm rms in frames held out"
            + ("" if corrected is None else f", {corrected:.3f} with residual corrections ({kept})")
        )
    for one in result.cameras:
        x, y, z = one["centre_mm"]
        print(
            f"camera {one['camera']:<3} turned {one['turned_deg']:.3f} +- {one['turned_sigma_deg']:.3f} deg, at "
            f"{x:.3f} {y:.3f} {z:.3f} +- {max(one['centre_sigma_mm']):.3f} mm from the first"
        )
    for one in figures.get("target", ()):
        print(
            f"target     has camera {one['camera']} turned by {one['turned_deg']:.3f} deg and {one['moved_mm']:.3f} mm "
            f"elsewhere: {one['sigmas']:.1f} sigma"
        )
    print(f"distance   {result.distance_mm:.2f} mm from camera to projector, if the radius is {radius:g} mm: check it")
    print(f"poses      {'good' if not result.advice else 'could be better: ' + '; '.join(result.advice)}")
    for warning in result.warnings:
        print(f"warning    {warning}")
    print(f"written    {out}, {picture}")


def _field(text: str) -> tuple[int, int, int, int]:
    from annulus_pipe.geometry.calibration import sensor_crop

    try:
        return sensor_crop([int(value) for value in text.split(",")], "--sensor-crop")
    except ValueError:
        raise AnnulusError(f"--sensor-crop {text}: expected X,Y,W,H in pixels of the sensor, 0,0,3280,2464") from None
