"""`annulus pattern`: what the projector's slide should be."""

import json
import re
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, verbs
from annulus_pipe.hooks import merged
from annulus_pipe.vocabulary import AnnulusError

app = verbs()


@app.callback()
def _pattern() -> None:
    """Keeps `design` a command of its own."""


@app.command(
    "design",
    epilog="Example: annulus pattern design --word 2 --camera head-7.json --pipe-mm 152.4 --distance-mm 56 "
    "--sensor-radius-mm 9 --glass-mm 45 --projector-f-mm 12 -o slide",
)
def design(
    pipe_mm: Annotated[str, typer.Option(help="Inner diameter of the pipe, mm, or a range: 100-160.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for slide, preview and calibration.json.")],
    distance_mm: Annotated[float | None, typer.Option(help="Projector behind camera (d_t), mm.")] = None,
    sensor_radius_mm: Annotated[float | None, typer.Option(help="Radius of the sensor's body (R_sen), mm.")] = None,
    glass_mm: Annotated[float | None, typer.Option(help="Length of the clear tube (d_g), mm.")] = None,
    projector_f_mm: Annotated[
        float | None, typer.Option(min=0.5, max=500.0, help="Focal length of the slide's lens, mm.")
    ] = None,
    head: Annotated[
        str, typer.Option(help="sequence: projector behind camera. stereo: beside two cameras.")
    ] = "sequence",
    calibration: Annotated[
        Path | None, typer.Option(help="With --head stereo: a calibration, or a design in its form.")
    ] = None,
    word: Annotated[int, typer.Option(help="Stripes that must be read together to know where one is (n).")] = 2,
    colours: Annotated[str, typer.Option(help="Colours of the stripes; k letters of R, G, B.")] = "RGB",
    stripes: Annotated[int | None, typer.Option(help="Coloured stripes; k^n if not given.")] = None,
    rings: Annotated[int | None, typer.Option(help="Slits between stripes instead: one fewer than stripes.")] = None,
    camera: Annotated[Path | None, typer.Option(help="File with the `camera` section.")] = None,
    f: Annotated[float | None, typer.Option(help="Instead of --camera: its focal length, px.")] = None,
    fisheye: Annotated[bool, typer.Option("--fisheye", help="With --f: r = f theta, not r = f tan theta.")] = False,
    size: Annotated[str, typer.Option(help="With --f: pixels of the image.")] = "1664x1232",
    nominal_mm: Annotated[
        float | None, typer.Option(help="Pipe in which stripes are of one width. [default: the middle of the range]")
    ] = None,
    fringe: Annotated[
        bool, typer.Option("--fringe", help="A slide of waves, for fringes, in place of coloured stripes.")
    ] = False,
    period_mm: Annotated[
        float | None, typer.Option(min=0.1, max=1000.0, help="With --fringe: a period along the wall, mm.")
    ] = None,
    defocus_mm: Annotated[
        float, typer.Option(min=0.0, max=10.0, help="With --fringe: diameter of the lens's blur on the slide, mm.")
    ] = 0.0,
    slit_px: Annotated[float, typer.Option(min=2.0, max=100.0, help="Width of a slit in the image, px.")] = 8.0,
    inner_deg: Annotated[float | None, typer.Option(help="Full angle where the pattern begins; else chosen.")] = None,
    outer_deg: Annotated[float | None, typer.Option(help="Full angle where the pattern ends; else chosen.")] = None,
    as_json: Json = False,
) -> None:
    """A pattern for this head: colours, angles, limits checked, a slide to print and what the camera will see.

    The slide is to scale in slide.svg and slide.pdf: print at 100 % and measure the bar. Black passes no light.
    calibration.json has the pattern and the rings as designed, for `annulus calibrate pipe` to begin with.

    With --head stereo nothing is laid out: cameras and rings are read from --calibration, and for the ends and the
    middle of --pipe-mm is drawn and said where each camera knows the wall, and where both together know it worst.

    With --fringe the rings are a wave whose phase is linear along the wall of that pipe: give --period-mm,
    --distance-mm, --inner-deg, --outer-deg, --projector-f-mm.
    """
    if fringe:
        _fringe(pipe_mm, period_mm, distance_mm, inner_deg, outer_deg, projector_f_mm, defocus_mm, out, as_json)
        return
    if period_mm is not None or defocus_mm:
        raise AnnulusError("--period-mm and --defocus-mm go with --fringe")
    if head not in ("sequence", "stereo"):
        raise AnnulusError(f'--head is "{head}", expected sequence or stereo')
    if head == "stereo":
        _stereo(pipe_mm, calibration, out, as_json)
        return
    if calibration is not None:
        raise AnnulusError("--calibration goes with --head stereo")
    if distance_mm is None or sensor_radius_mm is None or glass_mm is None or projector_f_mm is None:
        raise AnnulusError(
            "give --distance-mm, --sensor-radius-mm, --glass-mm and --projector-f-mm: where the projector stands "
            "behind the camera, the body, the clear tube, the slide's lens"
        )
    from annulus_pipe.calibrate.slide import write_design
    from annulus_pipe.geometry.camera import Camera
    from annulus_pipe.rings.pattern import PatternHead, stripe_colours
    from annulus_pipe.rings.pattern import design as lay_out
    from annulus_pipe.storage.calibration_file import load_camera

    if (camera is None) == (f is None):
        raise AnnulusError("give either --camera FILE or --f PIXELS (with --fisheye and --size as need be)")
    if camera is not None:
        lens = load_camera(camera)
    else:
        match = re.fullmatch(r"\s*(\d+)\s*[xX*]\s*(\d+)\s*", size)
        if match is None:
            raise AnnulusError(f'--size is "{size}", expected like 1664x1232')
        width, height = int(match[1]), int(match[2])
        if f is None or not 1 <= f <= 1e6 or not (16 <= width <= 16384 and 16 <= height <= 16384):
            raise AnnulusError(
                f"--f {f} and --size {size}: expected a focal length in px and an image of 16 to 16384 px"
            )
        lens = Camera("fisheye" if fisheye else "pinhole", width, height, f, f, (width - 1) / 2, (height - 1) / 2)
    least, most = _diameters(pipe_mm)
    if rings is not None and stripes is not None:
        raise AnnulusError("--rings and --stripes say the same: give one")
    count = rings + 1 if rings is not None else stripes
    planned = PatternHead(lens, least, most, nominal_mm or (least + most) / 2, distance_mm, sensor_radius_mm, glass_mm)
    pattern = lay_out(
        planned,
        stripe_colours(colours, word, count),
        word,
        slit_px=slit_px,
        inner_full_deg=inner_deg,
        outer_full_deg=outer_deg,
    )
    written = write_design(pattern, projector_f_mm, out)
    figures = pattern.to_dict()
    if as_json:
        print(json.dumps({**figures, "files": [str(path) for path in written]}))
        return
    limits = figures["limits"]
    print(f"colours    {pattern.colours}: {figures['stripes']} stripes, {figures['slits']} slits, n = {word}")
    print(f"angles     {figures['inner_full_deg']:.2f} to {figures['outer_full_deg']:.2f} deg (full)")
    print(f"inner      above {limits['inner_full_deg_above']:.2f} deg: clear of the body (Eq. 3.3)")
    print(f"distance   {distance_mm:g} mm, below {limits['distance_mm_below']:.1f} mm: all seen (Eq. 3.2)")
    for pipe in figures["pipes"]:
        near, far = pipe["ahead_mm"]
        low, high = pipe["stripe_px"]
        print(
            f"pipe       {pipe['diameter_mm']:g} mm: {near:.0f} to {far:.0f} mm ahead, "
            f"stripes {low:.1f} to {high:.1f} px"
        )
    print("stripe  radius on the slide, mm")
    for colour, a, b in pattern.radii_mm(projector_f_mm):
        print(f"  {colour}     {a:8.4f} {b:8.4f}")
    print("written    " + ", ".join(str(path) for path in written))


def _diameters(text: str) -> tuple[float, float]:
    match = re.fullmatch(r"\s*([\d.]+)\s*(?:-|\.\.|to)?\s*([\d.]+)?\s*", text)
    try:
        least, most = (float(match[1]), float(match[2] or match[1])) if match else (0.0, 0.0)
    except ValueError:
        least, most = 0.0, 0.0
    if not 0 < least <= most <= 1e4:
        raise AnnulusError(f'--pipe-mm is "{text}", expected a diameter in mm, or a range like 100-160')
    return least, most


def _fringe(
    pipe_mm: str,
    period_mm: float | None,
    distance_mm: float | None,
    inner_deg: float | None,
    outer_deg: float | None,
    focal_mm: float | None,
    defocus_mm: float,
    out: Path,
    as_json: bool,
) -> None:
    if period_mm is None or distance_mm is None or inner_deg is None or outer_deg is None or focal_mm is None:
        raise AnnulusError(
            "--fringe needs --period-mm, --distance-mm, --inner-deg, --outer-deg and --projector-f-mm: the wave on the "
            "wall, where the projector stands behind the camera, its field, the slide's lens"
        )
    least, most = _diameters(pipe_mm)
    wave = (least + most) / 4, period_mm, distance_mm, (inner_deg / 2, outer_deg / 2), focal_mm, defocus_mm
    slide, written = merged("lights")["slides"].designed(*wave, out=out)
    import numpy as np

    edges = np.array([slide.inner_mm, slide.outer_mm])
    left = [round(float(one), 3) for one in slide.modulation(edges)]
    figures = {
        "kind": "fringe",
        "rings": slide.rings,
        "period_mm": period_mm,
        "pipe_diameter_mm": (least + most) / 2,
        "radii_mm": edges.tolist(),
        "finest_mm": slide.finest_mm,
        "modulation": left,
        "ahead_mm": list(slide.wall_mm),
        "files": [str(path) for path in written],
    }
    if as_json:
        print(json.dumps(figures))
        return
    near, far = slide.wall_mm
    print(
        f"wave       {period_mm:g} mm along the wall of a pipe of {figures['pipe_diameter_mm']:g} mm, "
        f"{slide.rings} rings"
    )
    print(f"wall       {near:.0f} to {far:.0f} mm ahead of the camera")
    print(f"slide      radii {slide.inner_mm:.3f} to {slide.outer_mm:.3f} mm, finest period {slide.finest_mm:.4f} mm")
    inner, outer = 100 * left[0], 100 * left[1]
    print(f"modulation {inner:.0f} % of the innermost, {outer:.0f} % of the outermost ring is left by the defocus")
    print("written    " + ", ".join(str(path) for path in written))


def _stereo(pipe_mm: str, file: Path | None, out: Path, as_json: bool) -> None:
    from annulus_pipe.calibrate.outlook_picture import draw_outlook
    from annulus_pipe.stereo.outlook import COVERED, outlook
    from annulus_pipe.storage.calibration_file import load_calibration

    if file is None:
        raise AnnulusError("--head stereo needs --calibration FILE: cameras, where they stand, and the rings")
    known = load_calibration(file)
    if not known.others:
        raise AnnulusError(f"{file}: the head has one camera, expected two or more for --head stereo")
    least, most = _diameters(pipe_mm)
    pipes = [outlook(known, diameter / 2) for diameter in sorted({least, (least + most) / 2, most})]
    picture = out / "outlook.png"
    draw_outlook(pipes, [one.id for one in known.cameras], picture)
    figures = []
    for pipe in pipes:
        worst = float(pipe.worst_mm.max())
        at = float(pipe.worst_mm.argmax() * 360.0 / len(pipe.worst_mm))
        seen = worst < 1e6
        figures.append(
            {
                "diameter_mm": 2 * pipe.radius_mm,
                "covered": pipe.is_covered,
                "worst_direction_deg": at,
                "worst_sigma_mm": worst if seen else None,
                "ahead_mm": pipe.ahead_mm.tolist(),
            }
        )
        if not as_json:
            print(
                f"pipe       {2 * pipe.radius_mm:g} mm: {'covered' if pipe.is_covered else 'NOT covered'}; worst at "
                f"{at:.0f} deg round the projector, {f'sigma {worst:.3f} mm' if seen else 'a ring is not seen'} "
                f"(asked: {COVERED * pipe.radius_mm:.3f})"
            )
    if as_json:
        print(json.dumps({"pipes": figures, "files": [str(picture)]}))
    else:
        print(f"written    {picture}")
