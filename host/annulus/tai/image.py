"""From a file of raw or decoded sound to image.npz, image.png and what should be known about them."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from annulus.record.acoustic import load_acoustic
from annulus.tai.decode import code_name, decode_record, load_template, sounds_like, sweep_of
from annulus.thermoacoustic.imaging import Image, back_projection, search_sound_speed, time_reversal
from annulus.thermoacoustic.sweep import examine, gaps_deg, quiet_spike, usable
from annulus.vocabulary import AnnulusError

Method = Literal["time-reversal", "back-projection"]
OBJECT = 0.85  # of the receivers' radius: what the sample is taken to fill, if nobody says
LEAST = 3  # usable positions


@dataclass(frozen=True, slots=True)
class ImageResult:
    """What was done and found, for the screen and --json."""

    positions: int
    excluded: tuple[int, ...]
    findings: tuple[str, ...]
    holes_deg: tuple[tuple[float, float], ...]
    decoded_from: str
    method: str
    sound_speed_m_s: float
    sound_speed_searched: bool
    pixel_mm: float
    size: tuple[int, int]
    misfit: tuple[float, ...]
    strongest: tuple[float, float, float]  # value, x mm, y mm

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def make_image(
    source: Path,
    out: Path,
    *,
    method: Method = "time-reversal",
    pixel_mm: float | None = None,
    sound_speed_m_s: float | None = None,
    search_m_s: tuple[float, float] | None = None,
    refinements: int = 0,
    nonnegative: bool = False,
    object_radius_mm: float | None = None,
    template: Path | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> ImageResult:
    """Writes image.npz (image, x_mm, y_mm) and image.png into `out`.

    Traces with faults are named and left out; holes of the circle stay holes. A coded record is decoded first. Nothing
    that comes before sound from `object_radius_mm` could arrive is looked at.

    Raises AnnulusError for a file that makes no sense, and where too little is left for an image.
    """
    record = load_acoustic(source)
    findings = []
    other = sounds_like(record)
    if other is not None:
        findings.append(f"the record says {code_name(record.code)} was sent, but it sounds like {other}")
    coded = code_name(record.code) if record.code.strip("0") not in ("", "1") else ""
    # a decoder spreads a flat top until nobody sees it: looked for in what was recorded
    raw = [fault for fault in examine(sweep_of(record, sound_speed_m_s)) if fault.kind == "clipped"] if coded else []
    record, used = decode_record(record, load_template(template) if template else None)
    if used is not None:
        findings.append(
            f"decoded from {coded}: sidelobes 1/{used.psr:.1f} of the peak, {used.gain_db:.1f} dB over one pulse"
        )
    sweep = sweep_of(record, sound_speed_m_s)
    faults = raw + examine(sweep)
    findings += [fault.text for fault in faults]
    kept = usable(sweep, faults)
    if np.count_nonzero(kept) < LEAST:
        reasons = "; ".join(fault.text for fault in faults if fault.excluded)
        raise AnnulusError(
            f"{source}: {np.count_nonzero(kept)} of {len(kept)} traces can be used, expected {LEAST} or more: {reasons}"
        )
    sweep = sweep.only(kept)
    sample = OBJECT * sweep.radius_mm if object_radius_mm is None else object_radius_mm
    if not 0 < sample <= sweep.radius_mm:
        raise AnnulusError(
            f"an object of {sample:g} mm radius, expected more than 0 and at most the receivers' {sweep.radius_mm:g} mm"
        )
    sweep = quiet_spike(sweep, sample)
    if search_m_s is not None:
        speed, _, _ = search_sound_speed(sweep, *search_m_s, progress)
        sweep = replace(sweep, sound_speed_m_s=speed)
    elif sound_speed_m_s is None and record.sound_speed_m_s is None:
        findings.append(
            f"no speed of sound given or recorded: {sweep.sound_speed_m_s:g} m/s taken (water); --search finds it"
        )
    holes = tuple(gaps_deg(sweep.angles_deg))
    if method == "back-projection":
        image = back_projection(sweep, pixel=pixel_mm)
    else:
        image = time_reversal(
            sweep, pixel=pixel_mm, refinements=refinements, nonnegative=nonnegative, progress=progress
        )
    out.mkdir(parents=True, exist_ok=True)
    np.savez(
        out / "image.npz", image=image.values, x_mm=image.x_mm, y_mm=image.y_mm,
        sound_speed_m_s=image.sound_speed_m_s, angles_deg=sweep.angles_deg, radius_mm=sweep.radius_mm,
    )  # fmt: skip
    picture(image, sweep.angles_deg, sweep.radius_mm, holes, out / "image.png", source.name)
    at = np.unravel_index(int(np.nanargmax(image.values)), image.values.shape)
    return ImageResult(
        len(kept), tuple(int(i) for i in np.flatnonzero(~kept)), tuple(findings), holes, coded, image.method,
        image.sound_speed_m_s, search_m_s is not None, float(image.x_mm[1] - image.x_mm[0]),
        (image.values.shape[1], image.values.shape[0]), image.misfit,
        (float(image.values[at]), float(image.x_mm[at[1]]), float(image.y_mm[at[0]])),
    )  # fmt: skip


def picture(
    image: Image,
    angles_deg: NDArray[np.float64],
    radius_mm: float,
    holes_deg: tuple[tuple[float, float], ...],
    path: Path,
    title: str,
) -> None:
    """The image with axes in mm, y upwards, the receivers on their circle and its holes shaded."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.patches import Wedge

    figure, axes = plt.subplots(figsize=(7.2, 6.2), layout="constrained")
    half = 0.5 * float(image.x_mm[1] - image.x_mm[0])
    extent = (image.x_mm[0] - half, image.x_mm[-1] + half, image.y_mm[0] - half, image.y_mm[-1] + half)
    values = image.values
    most = float(np.nanpercentile(np.abs(values), 99.8)) or 1.0
    least = -most if float(np.nanmin(values)) < -0.3 * most else 0.0
    shown = axes.imshow(
        values, origin="lower", extent=extent, cmap="gray" if least == 0 else "RdBu_r", vmin=least, vmax=most
    )
    for start, stop in holes_deg:
        axes.add_patch(
            Wedge((0, 0), 1.06 * radius_mm, start, stop, width=0.06 * radius_mm, color="0.8", hatch="//", lw=0)
        )
    turn = np.radians(angles_deg)
    axes.plot(1.03 * radius_mm * np.cos(turn), 1.03 * radius_mm * np.sin(turn), ".", color="tab:orange", ms=4)
    axes.set(
        xlabel="x, mm", ylabel="y, mm", aspect="equal",
        xlim=(-1.1 * radius_mm, 1.1 * radius_mm), ylim=(-1.1 * radius_mm, 1.1 * radius_mm),
    )  # fmt: skip
    missing = sum(stop - start for start, stop in holes_deg)
    note = f", {missing:.0f} deg of the circle not heard" if holes_deg else ""
    axes.set_title(
        f"{title}: {image.method}, {image.sound_speed_m_s:.0f} m/s, {len(angles_deg)} positions{note}", fontsize=9
    )
    figure.colorbar(shown, ax=axes, label="initial pressure, unit of the signals", shrink=0.85)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def quality(found: Image, truth: NDArray[np.float64], within_mm: float) -> tuple[float, float]:
    """(PSNR in dB with the truth's maximum as M, Eq. 8.21; correlation) inside a circle."""
    y, x = np.meshgrid(found.y_mm, found.x_mm, indexing="ij")
    inside = (np.hypot(x, y) < within_mm) & np.isfinite(found.values)
    a, b = found.values[inside].astype(float), truth[inside]
    error = float(np.mean((a - b) ** 2))
    psnr = 10 * math.log10(float(b.max()) ** 2 / error) if error > 0 else math.inf
    return psnr, float(np.corrcoef(a, b)[0, 1])
