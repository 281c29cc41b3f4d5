"""What the commands say to people of fringes: `annulus calibrate fringe` before a plate, in a pipe, `reconstruct`."""

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from annulus_pipe.wings.fringe.calibrate_pipe import FringePipeCalibration
    from annulus_pipe.wings.fringe.calibrate_plate import FringeCalibration


class By(StrEnum):
    SLIDE = "slide"
    CAMERAS = "cameras"


BY = {
    By.SLIDE: "the slide: its calibrated phase says the height",
    By.CAMERAS: "the cameras: the height at which both see one phase; the slide's own calibration is not used",
}


def show_plate(result: "FringeCalibration", figures: Mapping[str, Any], out: Path) -> None:
    """told : `result.to_dict()`."""
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
    curve = figures["transfer"]
    source = "as the file says" if result.curve_told else "the file says none"
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


def show_pipe(result: "FringePipeCalibration", figures: Mapping[str, Any], out: Path) -> None:
    """told : `result.to_dict()`."""
    projector, sigma = figures["projector"], figures["sigma"]
    place = ", ".join(f"{at:.3f} +- {s:.3f}" for at, s in zip(projector["centre_mm"], sigma["centre_mm"], strict=True))
    misfit = f"{figures['misfit_levels']:.2f} grey levels"
    print(f"frames     {figures['frames']} of a clean pipe of radius {figures['radius_mm']:g} mm, misfit {misfit}")
    print(f"light      from {place} mm (right, down, ahead); its axis known to {max(sigma['tilt_deg']):.4f} deg")
    print(f"period     {projector['period_mm']:.4f} +- {sigma['period_mm']:.4f} mm on that wall")
    print(f"phase      {projector['phase0']:.4f} +- {sigma['phase0']:.4f} rad")
    shown = _harmonics(projector, sigma)
    source = "as the file says" if result.curve_told else "the file says none"
    print(f"harmonics  {shown}, taken out; curve {figures['transfer']['sensor']} ({source})")
    for warning in figures["warnings"]:
        print(f"warning    {warning}")
    print(f"written    {out}")


def _harmonics(slide: Mapping[str, Any], sigma: Mapping[str, Any]) -> str:
    waves = slide.get("harmonics", [])
    pairs = zip(waves[::2], waves[1::2], sigma["harmonics"][::2], strict=False)
    shown = (f"{k}: {c:.4f} cos {s:+.4f} sin +- {e:.4f}" for k, (c, s, e) in enumerate(pairs, start=2))
    return ", ".join(shown) or "none"
