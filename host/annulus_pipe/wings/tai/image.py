"""From a file of raw or decoded sound to image.npz, image.png and what should be known about them."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, load_acoustic
from annulus_pipe.wings.tai.decode import code_name, decode_record, detected_code, load_template, sweep_of
from annulus_pipe.wings.tai.measure.agreement import LAG_RAD, Arrival, disagreeing, likelier_arrival, search_sound_speed
from annulus_pipe.wings.tai.measure.imaging import AcousticImage, Region, back_projection, time_reversal
from annulus_pipe.wings.tai.measure.sweep import Sweep, band_passed, examine, gaps_deg, usable, without_coupling

Method = Literal["time-reversal", "back-projection"]
OBJECT = 0.85  # of the receivers' radius: what the sample is taken to fill, if nobody says. Unguarded: a convention
LEAST = 3  # usable positions. Guard: test_nothing_left_to_image_is_one_line


@dataclass(frozen=True, slots=True)
class ImageSettings:
    """How an image is made. Lengths mm, speeds m/s, frequencies Hz; None: as recorded, or as the sound asks for."""

    method: Method = "time-reversal"
    pixel_mm: float | None = None
    sound_speed_m_s: float | None = None
    search_m_s: tuple[float, float] | None = None  # find the speed of sound in this range
    band_hz: tuple[float, float] | None = None  # what of the sound is used
    arrival: Arrival | None = None  # how sound arrives; None: as recorded, or by which receivers agree better
    region: Region | None = None  # what is shown, and asked for the speed of sound; None: the whole circle
    object_radius_mm: float | None = None  # nothing comes from farther out
    refinements: int = 0
    nonnegative: bool = False


DEFAULT = ImageSettings()


@dataclass(frozen=True, slots=True)
class ImageResult:
    """What was done and found, for a person or a program."""

    positions: int
    excluded: tuple[int, ...]
    findings: tuple[str, ...]
    holes_deg: tuple[tuple[float, float], ...]
    decoded_from: str
    method: str
    sound_speed_m_s: float
    sound_speed_searched: bool
    sound_speed_agreement: float | None  # correlation of opposite halves, where it was searched
    arrival: str  # "space" or "plane": how sound was taken to arrive
    pixel_mm: float
    size: tuple[int, int]
    misfit: tuple[float, ...]
    strongest: tuple[float, float, float]  # value, x mm, y mm

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def make_image(
    source: Path,
    out: Path,
    settings: ImageSettings = DEFAULT,
    template: Path | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> ImageResult:
    """Writes image.npz (image, x_mm, y_mm) and image.png into `out`.

    Traces with faults are named and left out, and so are receivers that agree with no other; holes of the circle stay
    holes. A coded record is decoded first. Nothing that comes before sound from the object could arrive is looked at.

    Raises AnnulusError for a file that makes no sense, and where too little is left for an image.
    """
    record = load_acoustic(source)
    findings = []
    other = detected_code(record)
    if other is not None:
        findings.append(f"the record says {code_name(record.code)} was sent, but it sounds like {other}")
    coded = code_name(record.code) if record.code.strip("0") not in ("", "1") else ""
    # a decoder spreads a flat top until nobody sees it: looked for in what was recorded
    raw = examine(sweep_of(record, settings.sound_speed_m_s)) if coded else []
    record, used = decode_record(record, load_template(template) if template else None)
    if used is not None:
        findings.append(
            f"decoded from {coded}: sidelobes 1/{used.psr:.1f} of the peak, {used.gain_db:.1f} dB over one pulse"
        )
    sweep = sweep_of(record, settings.sound_speed_m_s)
    faults = [fault for fault in raw if fault.kind == "clipped"] + examine(sweep)
    findings += [fault.text for fault in faults]
    kept = np.flatnonzero(usable(sweep, faults))
    if len(kept) < LEAST:
        reasons = "; ".join(fault.text for fault in faults if fault.excluded)
        raise AnnulusError(
            f"{source}: {len(kept)} of {len(sweep.signals)} traces can be used, expected {LEAST} or more: {reasons}"
        )
    sweep = _prepared(sweep.only(kept.tolist()), settings)
    arrival = settings.arrival or known_arrival(record)
    if settings.search_m_s is None:
        fit, arrival = None, arrival or likelier_arrival(sweep, settings.region)
        if settings.sound_speed_m_s is None and record.sound_speed_m_s is None:
            findings.append(
                f"no speed of sound given or recorded: {sweep.sound_speed_m_s:g} m/s taken (water); a search finds it"
            )
    else:
        fit, rival = search_sound_speed(sweep, *settings.search_m_s, arrival, settings.region, progress)
        sweep, arrival = replace(sweep, sound_speed_m_s=fit.sound_speed_m_s), fit.arrival
        findings.append(
            f"halves of the circle agree by {fit.agreement:.2f} at {fit.sound_speed_m_s:.1f} m/s, as sound in "
            f"{fit.arrival_text}; as sound in {rival.arrival_text}, by {rival.agreement:.2f} at "
            f"{rival.sound_speed_m_s:.1f} m/s"
        )
    bad = disagreeing(sweep, arrival, settings.region)
    findings += [
        f"the receiver at position {kept[i]} agrees with the others by {own:.2f}, "
        f"its neighbours by {beside:.2f}; left out"
        for i, own, beside in bad
    ]
    left = [i for i in range(len(kept)) if i not in {one[0] for one in bad}]
    sweep, kept = sweep.only(left), kept[left]
    image = _imaged(sweep, settings, progress)
    holes = tuple(gaps_deg(sweep.angles_deg))
    out.mkdir(parents=True, exist_ok=True)
    np.savez(
        out / "image.npz",
        image=image.values,
        x_mm=image.x_mm,
        y_mm=image.y_mm,
        sound_speed_m_s=image.sound_speed_m_s,
        angles_deg=sweep.angles_deg,
        radius_mm=sweep.radius_mm,
    )
    picture(image, sweep, out / "image.png", source.name)
    at = np.unravel_index(int(np.nanargmax(image.values)), image.values.shape)
    return ImageResult(
        len(record.signals),
        tuple(sorted(set(range(len(record.signals))) - {int(i) for i in kept})),
        tuple(findings),
        holes,
        coded,
        image.method,
        image.sound_speed_m_s,
        fit is not None,
        fit.agreement if fit else None,
        arrival,
        float(image.x_mm[1] - image.x_mm[0]),
        (image.values.shape[1], image.values.shape[0]),
        image.misfit,
        (float(image.values[at]), float(image.x_mm[at[1]]), float(image.y_mm[at[0]])),
    )


def known_arrival(record: AcousticRecord) -> Arrival | None:
    """How sound arrived, where the record says so: simulated sound does, in a plane."""
    return next((arrival for arrival in LAG_RAD if record.extra.get("sound") == arrival), None)


def _prepared(sweep: Sweep, settings: ImageSettings) -> Sweep:
    """Without what cannot be sound of the object, and in the band that was asked for."""
    sample = OBJECT * sweep.radius_mm if settings.object_radius_mm is None else settings.object_radius_mm
    if not 0 < sample <= sweep.radius_mm:
        raise AnnulusError(
            f"an object of {sample:g} mm radius, expected more than 0 and at most the receivers' {sweep.radius_mm:g} mm"
        )
    if settings.band_hz is not None:
        # the pulse that couples in would ring through the filter: cut off before, its rest faded out after
        silent_s = (sweep.radius_mm - sample) * 1e-3 / sweep.sound_speed_m_s
        sweep = band_passed(sweep.since(0.5 * silent_s), *settings.band_hz)
    return without_coupling(sweep, sample)


def _imaged(sweep: Sweep, settings: ImageSettings, progress: Callable[[str, int, int], None] | None) -> AcousticImage:
    if settings.method == "back-projection":
        return back_projection(sweep, pixel=settings.pixel_mm, region=settings.region)
    return time_reversal(
        sweep,
        pixel=settings.pixel_mm,
        region=settings.region,
        refinements=settings.refinements,
        nonnegative=settings.nonnegative,
        progress=progress,
    )


def picture(image: AcousticImage, sweep: Sweep, path: Path, title: str) -> None:
    """The image with axes in mm, y upwards, the receivers on their circle and its holes shaded."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.patches import Wedge

    radius_mm, holes_deg = sweep.radius_mm, gaps_deg(sweep.angles_deg)
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
    turn = np.radians(sweep.angles_deg)
    axes.plot(1.03 * radius_mm * np.cos(turn), 1.03 * radius_mm * np.sin(turn), ".", color="tab:orange", ms=4)
    whole = (-1.1 * radius_mm, 1.1 * radius_mm)
    cut_out = max(extent[1] - extent[0], extent[3] - extent[2]) < 1.5 * radius_mm
    axes.set(
        xlabel="x, mm",
        ylabel="y, mm",
        aspect="equal",
        xlim=extent[:2] if cut_out else whole,
        ylim=extent[2:] if cut_out else whole,
    )
    missing = sum(stop - start for start, stop in holes_deg)
    note = f", {missing:.0f} deg of the circle not heard" if holes_deg else ""
    axes.set_title(f"{title}: {image.method}, {image.sound_speed_m_s:.0f} m/s, {len(turn)} positions{note}", fontsize=9)
    figure.colorbar(shown, ax=axes, label="initial pressure, unit of the signals", shrink=0.85)
    figure.savefig(path, dpi=130)
    plt.close(figure)
