"""`annulus calibrate fringe`: a slide of fringes, before a plate or in a clean pipe."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from annulus_pipe.cli.show import Json, progress, verbs
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.wings.fringe.calibrate_pipe import FringePipeCalibration
    from annulus_pipe.wings.fringe.calibrate_plate import FringeCalibration


app = verbs()


@app.command(
    "fringe",
    epilog="Example: annulus calibrate fringe scans/reference --camera head-7.json --distance 100 -o head-7.json",
)
def fringe(
    scan: Annotated[
        Path,
        typer.Argument(
            help="Scan folder of a plain, flat plate (frames.csv has height_mm) or clean pipe (tx_mm, ty_mm)."
        ),
    ],
    camera: Annotated[Path, typer.Option(help="File with the camera, or the cameras; a calibration.json will do.")],
    design: Annotated[
        Path | None,
        typer.Option(
            "--slide", help="calibration.json of `annulus pattern design --fringe`: rings. [default: the camera's file]"
        ),
    ] = None,
    radius: Annotated[
        float | None, typer.Option(min=1.0, max=5000.0, help="Of the clean pipe, inside, mm. [default: the file's]")
    ] = None,
    distance: Annotated[
        float | None,
        typer.Option(
            min=1.0, max=10000.0, help="First camera to the plate at height 0, mm. [default: the file's distance_mm]"
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="calibration.json; other sections in it are kept.")] = Path(
        "calibration.json"
    ),
    as_json: Json = False,
) -> None:
    """A slide of fringes from a flat plate at two or more known heights: where its light comes from, period, waveform.

    Stand a plain plate across the first camera's axis, one projector frame a camera at each height (towards the head is
    positive); three heights or more, of uneven spacing, a few millimetres apart. Nothing need move.

    A slide of rings: in a clean pipe of known radius, the head some millimetres aside (tx_mm right, ty_mm down), three
    frames or more. It begins with the slide's design.
    """
    from annulus_pipe.storage.calibration_file import projects_rings
    from annulus_pipe.wings.fringe.calibrate_plate import calibrate_fringe, save_fringe

    if projects_rings(design or camera):
        if distance is not None:
            raise AnnulusError("--distance is of a plate, and the slide is one of rings for a pipe: leave it out")
        _fringe_pipe(scan, camera, design, radius, out, as_json)
        return
    if design is not None or radius is not None:
        raise AnnulusError("--slide and --radius are of a slide of rings, and the file has none")
    with progress() as bars:
        result = calibrate_fringe(scan, camera, distance_mm=distance, progress=bars)
    save_fringe(result, out)
    figures = result.to_dict()
    if as_json:
        print(json.dumps({**figures, "file": str(out)}))
        return
    _show_plate(result, figures, out)


def _fringe_pipe(scan: Path, camera: Path, slide: Path | None, radius: float | None, out: Path, as_json: bool) -> None:
    from annulus_pipe.wings.fringe.calibrate_pipe import calibrate_fringe_pipe, save_fringe_pipe

    with progress() as bars:
        result = calibrate_fringe_pipe(scan, camera, slide, radius_mm=radius, progress=bars)
    save_fringe_pipe(result, out)
    figures = result.to_dict()
    if as_json:
        print(json.dumps({**figures, "file": str(out)}))
    else:
        _show_pipe(result, figures, out)


def _show_plate(result: "FringeCalibration", figures: Mapping[str, Any], out: Path) -> None:
    """figures : `result.to_dict()`."""
    slide, sigma = figures["projector"], figures["sigma"]
    x, y, z = slide["centre_mm"]
    print(f"frames     {figures['frames']} of a plate at {', '.join(f'{h:g}' for h in figures['heights_mm'])} mm")
    print(
        f"light      from {x:.3f} {y:.3f} {z:.3f} mm, +- {sigma['across_mm']:.4f} across the stripes, "
        f"{sigma['depth_mm']:.4f} ahead (along them it makes no difference)"
    )
    print(
        f"period     {slide['period']:.6f} +- {sigma['period']:.6f} of the tangent; K {figures['k_rad']:.3f} +- "
        f"{sigma['k_rad']:.3f} rad"
    )
    print(
        f"stripes    turned {slide['turn_deg']:.4f} +- {sigma['turn_deg']:.4f} deg, axis known to "
        f"{max(sigma['tilt_deg']):.5f} deg, phase {slide['phase0']:.4f} +- {sigma['phase0']:.4f} rad"
    )
    print(f"lens       {_lens(figures)}")
    curve = figures["transfer"]
    source = "as the file says" if result.curve_stated else "the file says none"
    print(
        f"curve      {curve['sensor']}, black {curve['black']:g}, gamma {curve.get('gamma', 1.0):.3f} taken out "
        f"({source}); what is left looks like a gamma of {figures['gamma']:.4f} +- {figures['gamma_sigma']:.4f}"
    )
    print(f"harmonics  {_harmonics(slide, sigma)}, taken out; modulation {figures['modulation']:.3f}")
    apart = f", cameras {figures['cameras_apart_rad']:.4f} rad apart" if len(result.head.cameras) > 1 else ""
    print(f"phase      {figures['rms_rad']:.4f} rad rms over {figures['tiles']} tiles{apart}")
    for warning in result.warnings:
        print(f"warning    {warning}")
    print(f"written    {out}")


def _show_pipe(result: "FringePipeCalibration", figures: Mapping[str, Any], out: Path) -> None:
    """figures : `result.to_dict()`."""
    projector, sigma = figures["projector"], figures["sigma"]
    place = ", ".join(f"{at:.3f} +- {s:.3f}" for at, s in zip(projector["centre_mm"], sigma["centre_mm"], strict=True))
    misfit = f"{figures['misfit_levels']:.2f} grey levels"
    print(f"frames     {figures['frames']} of a clean pipe of radius {figures['radius_mm']:g} mm, misfit {misfit}")
    print(f"light      from {place} mm (right, down, ahead); its axis known to {max(sigma['tilt_deg']):.4f} deg")
    print(f"period     {projector['period_mm']:.4f} +- {sigma['period_mm']:.4f} mm on that wall")
    print(f"phase      {projector['phase0']:.4f} +- {sigma['phase0']:.4f} rad")
    print(f"lens       {_lens(figures, with_sigma=False)}")
    if "mirror" in projector:
        ball = [*projector["mirror"]["centre_mm"], projector["mirror"]["radius_mm"]]
        pairs = ", ".join(f"{at:.3f} +- {s:.3f}" for at, s in zip(ball, sigma["mirror_mm"], strict=True))
        print(f"mirror     {pairs} mm (its centre from the slide, its radius)")
    shown = _harmonics(projector, sigma)
    source = "as the file says" if result.curve_stated else "the file says none"
    print(f"harmonics  {shown}, taken out; curve {figures['transfer']['sensor']} ({source})")
    for warning in figures["warnings"]:
        print(f"warning    {warning}")
    print(f"written    {out}")


def _lens(figures: Mapping[str, Any], with_sigma: bool = True) -> str:
    """What the slide's lens does to the tangent at the edge of the light. In a pipe its sigma is the fit's alone, and
    was four times too small where the truth was known: none is stated."""
    amount = f"{100 * figures['barrel']:+.2f} %"
    if with_sigma:
        amount = f"{100 * figures['barrel']:+.2f} +- {100 * figures['barrel_sigma']:.2f} %"
    what = "distorts by" if "distortion" in figures["projector"] else "none that stands out:"
    return f"{what} {amount} where the light ends (tangent {figures['edge']:.2f}); a barrel is negative"


def _harmonics(slide: Mapping[str, Any], sigma: Mapping[str, Any]) -> str:
    waves = slide.get("harmonics", [])
    pairs = zip(waves[::2], waves[1::2], sigma["harmonics"][::2], strict=False)
    shown = (f"{k}: {c:.4f} cos {s:+.4f} sin +- {e:.4f}" for k, (c, s, e) in enumerate(pairs, start=2))
    return ", ".join(shown) or "none"
