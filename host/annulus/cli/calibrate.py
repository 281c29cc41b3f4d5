"""`annulus calibrate`: the camera, the rings, the paint; every answer goes into one calibration.json."""

import json
from pathlib import Path
from typing import Annotated

import typer

from annulus.cli.show import Json, group, progress
from annulus.vocabulary import AnnulusError

app = group("Measure the head: camera, rings, colours. Every answer goes into one calibration.json.")


@app.callback()
def _calibrate() -> None:
    """Commands below share one file: each replaces its own sections and keeps the others."""


@app.command("camera", epilog="Example: annulus calibrate camera board/*.jpg --square-mm 25 -o head-7.json")
def camera(
    images: Annotated[list[Path], typer.Argument(help="Photographs of a flat board, or folders of them.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="calibration.json; other sections in it are kept.")] = Path(
        "calibration.json"
    ),
    model: Annotated[
        str | None, typer.Option(help="pinhole or fisheye; if not given, the one that fits clearly better.")
    ] = None,
    board: Annotated[
        str | None,
        typer.Option(help='Inner corners of a chessboard, "9x6", or squares of a ChArUco board, "charuco 8x6".'),
    ] = None,
    square_mm: Annotated[float, typer.Option(min=0.01, max=10000.0, help="Side of a square, mm.")] = 25.0,
    picture: Annotated[
        Path | None, typer.Option(help="Where to draw what the lens is worth. [default: FILE.camera.png]")
    ] = None,
    as_json: Json = False,
) -> None:
    """The camera from photographs of a chessboard or ChArUco board, from nothing but them.

    The board may be of any size, partly seen, through any lens; bad photographs are left out and named. Ten to twenty
    photographs, the board filling half the image, tilted 30 to 45 degrees, and in every corner of it.
    """
    if model not in (None, "pinhole", "fisheye"):
        raise AnnulusError(f'--model is "{model}", expected pinhole or fisheye')
    from annulus.calibrate.camera import calibrate_camera, image_files, save_camera
    from annulus.calibrate.camera_picture import draw_camera

    with progress() as bars:
        result = calibrate_camera(
            image_files(images),
            model=model,  # type: ignore[arg-type]
            board=board,
            square_mm=square_mm,
            progress=bars,
        )
    stale = save_camera(result, out)
    picture = picture or out.with_suffix(".camera.png")
    draw_camera(result, picture)
    told = result.to_dict()
    if as_json:
        print(json.dumps({**told, "file": str(out), "picture": str(picture)}))
        return
    for one in result.photographs:
        state = f"{one.rms_px:6.3f} px" if one.rms_px == one.rms_px else "        -"
        odd = f", {one.left_out} left out" if one.left_out else ""
        print(
            f"{one.file:<24} {state}  {one.corners:4d} corners{odd}"
            + (f"  REJECTED {one.rejected}" * bool(one.rejected))
        )
    lens, sigma = result.camera, told["sigma"]
    print(f"board      {result.board}{'' if result.board_was_given else ' (found out)'}")
    print(f"camera     {lens.model} {lens.width}x{lens.height}")
    print(f"focal      {lens.fx:.2f} +- {sigma['fx']:.2f}, {lens.fy:.2f} +- {sigma['fy']:.2f} px")
    print(f"centre     {lens.cx:.2f} +- {sigma['cx']:.2f}, {lens.cy:.2f} +- {sigma['cy']:.2f} px")
    print("distortion " + " ".join(f"{value:.5f}" for value in lens.distortion))
    print(
        f"rms        {told['rms_px']:.3f} px over {told['kept']} of {told['found']} photographs "
        f"({told['rms_everything_px']:.3f} px with nothing left out)"
    )
    spread = told["ray_sigma_px"]
    print(f"rays       known to {spread['median']:.2f} px (median), {spread['worst']:.2f} px (worst place)")
    print(f"coverage   {100 * result.coverage:.0f} % of the image")
    for warning in result.warnings:
        print(f"warning    {warning}")
    if stale:
        print(f"warning    the rings in {out} were measured with the camera before this one: calibrate them again")
    print(f"written    {out}, {picture}")


@app.command("colour", epilog="Example: annulus calibrate colour scans/yellow --calibration head-7.json -o yellow.json")
def colour(
    scan: Annotated[Path, typer.Argument(help="Scan folder or recording (.mcap); a few projector frames will do.")],
    calibration: Annotated[Path, typer.Option(help="calibration.json of the head.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="File of the pipe's colours.")] = Path("colour.json"),
    red_gain: Annotated[float, typer.Option(min=0.01, max=64.0, help="Red white-balance gain that was set.")] = 1.0,
    blue_gain: Annotated[float, typer.Option(min=0.01, max=64.0, help="Blue white-balance gain that was set.")] = 1.0,
    as_json: Json = False,
) -> None:
    """What the stripes look like on a pipe of this colour, and the white balance to set for it.

    Give the file to `annulus reconstruct --colour`. Set the gains on the camera (ColourGains of Picamera2), white
    balance off automatic, take frames again and learn again: then the weak channel is above the camera's noise.
    """
    from annulus.calibrate.colour import calibrate_colour
    from annulus.record.calibration_file import save_part

    with progress() as bars:
        learnt = calibrate_colour(scan, calibration, camera_gains=(red_gain, blue_gain), progress=bars)
    profile = learnt.profile
    save_part(out, profile.to_dict())
    if as_json:
        print(json.dumps({**profile.to_dict(), "warnings": list(learnt.warnings), "file": str(out)}))
        return
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
    print(f"written      {out}")


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

    from annulus.calibrate.reference import calibrate_reference
    from annulus.record.calibration_file import save_part

    with progress() as bars:
        learnt = calibrate_reference(scan, calibration, radius_mm=radius, progress=bars)
    told = learnt.reference
    save_part(out, told.to_dict())
    figures = {"frames": len(told.poses), "before_mm": told.before_mm, "known_percent": 100 * told.known}
    if not isnan(told.after_mm):
        figures["after_mm"] = told.after_mm
    if as_json:
        print(json.dumps({**figures, "warnings": list(learnt.warnings), "file": str(out)}))
        return
    print(f"frames     {len(told.poses)} of {learnt.looked_at} showed the pipe")
    lean = max(hypot(p.rx, p.ry) for p in told.poses)
    shift = max(hypot(p.tx, p.ty) for p in told.poses)
    print(f"poses      up to {degrees(lean):.2f} degrees and {shift:.1f} mm off the axis")
    after = "unknown after it" if isnan(told.after_mm) else f"{told.after_mm:.3f} mm after it, on frames kept out"
    print(f"radius     rms {told.before_mm:.3f} mm before the correction, {after}")
    print(f"seen       {100 * told.known:.1f} % of all directions of all rings; elsewhere nothing is corrected")
    for warning in learnt.warnings:
        print(f"warning    {warning}")
    print(f"written    {out}")
