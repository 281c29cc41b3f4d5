"""A plate from one side, through air, from file to file: simulated raw shots, and the places found in such a file.

A file has what a rig would have recorded and knows of itself, and nothing of what is in the plate: a simulation's truth
goes into a file of its own beside.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.extras import need
from annulus_pipe.numeric.arrays import Chips, FloatArray
from annulus_pipe.numeric.late import fft
from annulus_pipe.storage.arrays import require_plain_hdf5
from annulus_pipe.storage.whole import written_whole
from annulus_pipe.untrusted import mapping, number, parse_json, parse_toml, read_file, text, whole, within
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.budget import (
    RECORD_S,
    SEQUENCES,
    Laminate,
    SingleSidedRig,
    bursts_of,
    code_cost,
    decoder,
    spectra,
)
from annulus_pipe.wings.tai.measure.elastic import RATE_HZ, PlateDefect, PlateSample, face_velocity, sound_in_air
from annulus_pipe.wings.tai.measure.layered import KINDS, PlateModel
from annulus_pipe.wings.tai.measure.seek import PlateAnswer, places, regularised, sound_part, time_reversal

FORMAT = "annulus single-sided 1"
PITCH_MM = 2.0  # between positions: half of the shortest wave along a face (400 kHz, 1.4 mm/us, 3.5 mm). Guard: topic
POSITIONS = 51
SAMPLES = round(RECORD_S * RATE_HZ)
EXAMPLE = PlateSample(defects=(PlateDefect("delamination", -20.0, 6.0, 20.0),))
QUIET_S = 4e-6  # before the air's way is over, so long nothing of the plate is in a decoded trace
BEAM_HALF = 0.5  # of the horn's aperture along the plate: where its power has fallen to 1/e
TEXT_MAX, BURSTS_MAX, SHOTS_MAX = 4096, 8, 10**9


@dataclass(frozen=True, eq=False)
class PlateRecord:
    """`shots` (bursts, positions, samples), Pa at RATE_HZ from chip 0: each the mean of `averages` bursts.

    `laminate` is what the plate was bought as, not what it is.
    """

    shots: NDArray[np.float32]
    sequence: str
    averages: int
    rig: SingleSidedRig
    laminate: Laminate
    pitch_mm: float = PITCH_MM

    @property
    def x_mm(self) -> FloatArray:
        return np.asarray((np.arange(self.shots.shape[1]) - (self.shots.shape[1] - 1) / 2) * self.pitch_mm)


def read_plate(path: Path) -> PlateSample:
    """A plate by TOML: `thickness_mm`, and [[delamination]] (x_mm, depth_mm, wide_mm) and [[water]] (and thick_mm).

    Raises AnnulusError of one line.
    """
    try:
        found = parse_toml(read_file(path, 1 << 20))
        _only(found, {"thickness_mm", *KINDS}, "the plate")
        laminate = replace(Laminate(), thickness_mm=within(found.get("thickness_mm", 20.0), "thickness_mm", 6.0, 40.0))
        defects = []
        for kind in KINDS:
            tables = found.get(kind, [])
            if not isinstance(tables, list) or len(tables) > 20:
                raise ValueError(f"[[{kind}]] must be up to 20 tables")
            for table in tables:
                values = mapping(table, f"[[{kind}]]")
                names = ("x_mm", "depth_mm", "wide_mm") + (("thick_mm",) if kind == "water" else ())
                _only(values, set(names), f"[[{kind}]]")
                got = {name: number(values.get(name, 1.0 if name == "thick_mm" else None), name, 1e3) for name in names}
                defects.append(PlateDefect(kind, **got))  # type: ignore[arg-type]
        return PlateSample(laminate, tuple(defects))
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, AnnulusError) as error:
        raise AnnulusError(f"{path}: {error}") from None


def simulate_plate(
    sample: PlateSample,
    rig: SingleSidedRig,
    sequence: str,
    seconds: float,
    seed: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> PlateRecord:
    """Shots of a plate with the receiver's own noise, `seconds` a position at the shortest period that is allowed."""
    _checked_time(sequence, seconds)  # before the seconds that the sound takes
    velocity, x_mm = face_velocity(sample, rig, progress=(lambda n, of: progress("sound", n, of)) if progress else None)
    count = POSITIONS
    at = np.asarray((np.arange(count) - (count - 1) / 2) * PITCH_MM, float)
    return with_noise(sound_in_air(velocity, x_mm, rig, at, SAMPLES), rig, sequence, seconds, seed)


def with_noise(traces: FloatArray, rig: SingleSidedRig, sequence: str, seconds: float, seed: int) -> PlateRecord:
    """From what one chip sounds like (positions, samples) to the shots of a sequence, each with its share of noise."""
    bursts = _checked_time(sequence, seconds)
    cost = code_cost(sequence, rig)
    averages = max(1, math.floor(seconds / cost.period_s / len(bursts)))
    samples = SAMPLES + math.ceil(max(map(len, bursts)) * rig.pulse_s * RATE_HZ)
    length = fft.next_fast_len(samples + SAMPLES, real=True)
    f = fft.rfftfreq(length, 1 / RATE_HZ)
    coded = spectra(bursts, rig.pulse_s, f)
    clean = fft.irfft(coded[:, None] * fft.rfft(traces, length, axis=1), length, axis=2)[:, :, :samples]
    rms = rig.noise_pa_rthz() * math.sqrt(RATE_HZ / 2 / averages)
    noise = np.random.default_rng(seed).normal(scale=rms, size=clean.shape)
    return PlateRecord((clean + noise).astype(np.float32), sequence, averages, rig, Laminate())


def _checked_time(sequence: str, seconds: float) -> tuple[Chips, ...]:
    if not 1e-4 <= seconds <= 1e6:
        raise AnnulusError(f"{seconds:g} s a position, expected 0.0001..1000000")
    return bursts_of(sequence)


def require_plate_name(path: Path) -> None:
    if path.suffix not in (".h5", ".hdf5"):
        raise AnnulusError(f"{path}: expected a name ending in .hdf5 or .h5")


def decoded(record: PlateRecord) -> FloatArray:
    """(positions, SAMPLES): what one chip would have sounded like, in the band and a half of it to both sides."""
    rig = record.rig
    bursts = bursts_of(record.sequence)
    length = fft.next_fast_len(2 * record.shots.shape[2], real=True)
    f = fft.rfftfreq(length, 1 / RATE_HZ)
    in_band = (f > 0.5 * rig.band_hz[0]) & (f < 1.5 * rig.band_hz[1])
    total = np.zeros((record.shots.shape[1], len(f)), complex)
    taps = decoder(bursts, rig.pulse_s, f[in_band])
    for shot, weight in zip(record.shots, taps, strict=True):
        total[:, in_band] += weight * fft.rfft(np.asarray(shot, float), length, axis=1)[:, in_band]
    return np.asarray(fft.irfft(total, length, axis=1)[:, :SAMPLES])


def noise_rms(traces: FloatArray, rig: SingleSidedRig, flight_s: float) -> float:
    """Of decoded traces, as white noise of the same density in the band: from before anything could arrive."""
    quiet = int((flight_s - QUIET_S) * RATE_HZ)
    if quiet < 16:
        raise AnnulusError(f"{quiet} samples before sound arrives, expected 16 or more: move the receivers farther off")
    window = np.hanning(quiet)
    spectrum = fft.rfft(traces[:, :quiet] * window, axis=1)
    f = fft.rfftfreq(quiet, 1 / RATE_HZ)
    inside = (f >= rig.band_hz[0]) & (f <= rig.band_hz[1])
    return math.sqrt(float(np.mean(np.abs(spectrum[:, inside]) ** 2)) / float(np.sum(window**2)))


def examine_plate(record: PlateRecord) -> tuple[PlateModel, PlateAnswer]:
    """The image of a record, and the places in it. No place where nothing stands out."""
    beam = np.exp(-((record.x_mm / (BEAM_HALF * record.rig.horn_mm[0])) ** 2))
    model = PlateModel(record.laminate, record.rig, record.pitch_mm, beam, RATE_HZ, SAMPLES)
    traces = decoded(record)
    rms = noise_rms(traces, record.rig, model.flight_s)
    if not 0 < rms < math.inf:
        raise AnnulusError("no noise before sound arrives: without it nothing can be said of what is found")
    data = model.damped(traces)
    common = sound_part(model, data)
    left = data - common
    sigma = rms * math.sqrt(float(np.sum(np.abs(model.damped(np.eye(model.samples))[:, 0]) ** 2)))
    image, misfit = regularised(model, left, sigma)
    found = places(model, left, common, rms)
    return model, PlateAnswer(image, misfit, found, time_reversal(model, traces - np.median(traces, axis=0)))


def image_plate(source: Path, out: Path) -> dict[str, Any]:
    """Writes image.npz and image.png of a single-sided file into `out`; what was found, for a person or a program."""
    record = load_plate(source)
    model, answer = examine_plate(record)
    out.mkdir(parents=True, exist_ok=True)
    np.savez(
        out / "image.npz",
        delamination=answer.image[0],
        water=answer.image[1],
        x_mm=record.x_mm,
        depth_mm=model.depths_mm,
        time_reversal=answer.time_reversed,
    )
    plate_picture(record, model, answer, out / "image.png", source.name)
    return {
        "kind": "single-sided",
        "positions": record.shots.shape[1],
        "sequence": record.sequence,
        "seconds": record.averages * record.shots.shape[0] * code_cost(record.sequence, record.rig).period_s,
        "wave_mm": 1e3 * record.laminate.speed / record.rig.middle_hz,
        "misfit": answer.misfit,
        "places": [asdict(place) for place in answer.places],
    }


def plate_lines(found: Mapping[str, Any]) -> list[str]:
    lines = [
        f"plate      {found['positions']} positions, {found['sequence']}, {found['seconds']:.3g} s each; "
        f"a wave of the plate is {found['wave_mm']:.1f} mm"
    ]
    lines += [
        f"place      {p['kind'] or 'of unknown kind'}: x {p['x_mm']:+.1f} +- {p['x_sigma_mm']:.1f} mm, depth "
        f"{p['depth_mm']:.1f} +- {p['depth_sigma_mm']:.1f} mm, {p['wide_mm']:.0f} +- {p['wide_sigma_mm']:.0f} mm wide, "
        f"{p['sigmas']:.0f} times its noise"
        for p in found["places"]
    ]
    return lines if found["places"] else [*lines, "place      none stands out of the noise"]


def plate_picture(record: PlateRecord, model: PlateModel, answer: PlateAnswer, path: Path, title: str) -> None:
    """Both images and plain time reversal, over the same plate; found places as boxes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, rows = plt.subplots(3, 1, figsize=(8.0, 7.6), layout="constrained", sharex=True)
    draw_plate(rows, figure, record.x_mm, model, answer)
    rows[0].set_title(
        f"{title}: {record.sequence}, {record.averages} x {len(record.shots)} bursts a position", fontsize=9
    )
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_plate(rows: Any, figure: Any, x_mm: FloatArray, model: PlateModel, answer: PlateAnswer) -> None:
    """Onto three axes: delamination, water, time reversal."""
    from matplotlib.patches import Rectangle

    half = 0.5 * (x_mm[1] - x_mm[0])
    extent = (x_mm[0] - half, x_mm[-1] + half, model.depths_mm[-1] + 0.5, model.depths_mm[0] - 0.5)
    named = (
        (answer.image[0], "delamination, 1 = parted"),
        (answer.image[1], "water, 1 = 1 mm under full power"),
        (answer.time_reversed, "time reversal, Pa"),
    )
    for n, (axes, (values, label)) in enumerate(zip(rows, named, strict=True)):
        most = float(values.max()) or 1.0
        shown = axes.imshow(values, extent=extent, cmap="magma", vmin=0, vmax=most, aspect="auto")
        figure.colorbar(shown, ax=axes, label=label)
        axes.set(ylabel="depth, mm", ylim=(model.laminate.thickness_mm, 0))
        for place in answer.places if n < 2 else ():
            if place.kind not in (KINDS[n], None):
                continue
            axes.add_patch(
                Rectangle(
                    (place.x_mm - place.wide_mm / 2, place.depth_mm - place.depth_sigma_mm),
                    place.wide_mm,
                    2 * place.depth_sigma_mm,
                    fill=False,
                    color="tab:cyan",
                )
            )
    rows[-1].set_xlabel("x, mm")


def save_plate(path: Path, record: PlateRecord) -> None:
    """HDF5: `shots`, and `about`, a JSON text of what the rig knows of itself. Whole or not at all."""
    require_plate_name(path)
    about = {
        "format": FORMAT,
        "sequence": record.sequence,
        "averages": record.averages,
        "pitch_mm": record.pitch_mm,
        "rate_hz": RATE_HZ,
        "thickness_mm": record.laminate.thickness_mm,
        "rig": {key: value for key, value in asdict(record.rig).items() if key in _RIG},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as file, need("h5py").File(file, "w") as root:
        root.create_dataset("shots", data=record.shots)
        root.create_dataset("about", data=np.frombuffer(json.dumps(about).encode(), np.uint8))


def save_truth(path: Path, sample: PlateSample) -> None:
    path.write_text(json.dumps(asdict(sample), indent=1) + "\n")


_RIG = ("power_w", "standoff_mm", "receiver_db", "pulse_s", "temperature_c", "humidity_percent")


def is_plate(path: Path) -> bool:
    """Whether that is a single-sided file; anything that cannot be read is none."""
    if path.suffix not in (".h5", ".hdf5") or not path.is_file():
        return False
    try:
        with need("h5py").File(path, "r") as root:
            return "about" in root and "shots" in root
    except (OSError, RuntimeError, ValueError, KeyError):
        return False


def load_plate(path: Path) -> PlateRecord:
    """Raises AnnulusError of one line for a missing, cut short, foreign or senseless file."""
    try:
        with need("h5py").File(path, "r") as root:
            require_plain_hdf5(root)
            if root["about"].size > TEXT_MAX:
                raise ValueError(f"about has {root['about'].size} bytes, expected {TEXT_MAX} at most")
            about = mapping(parse_json(bytes(np.asarray(root["about"], np.uint8)), TEXT_MAX), "about")
            shots = np.asarray(root["shots"], np.float32)
        if about.get("format") != FORMAT or about.get("rate_hz") != RATE_HZ:
            raise ValueError(f"expected {FORMAT} at {RATE_HZ / 1e6:g} MHz")
        sequence = text(about.get("sequence"), "sequence", 40)
        if sequence not in SEQUENCES:
            raise ValueError(f"sequence {sequence!r}, expected one of {', '.join(SEQUENCES)}")
        known = mapping(about.get("rig"), "rig")
        _only(known, set(_RIG), "rig")
        values: dict[str, Any] = {name: number(known.get(name), name, 1e7) for name in _RIG}
        rig = SingleSidedRig(**values)
        laminate = replace(Laminate(), thickness_mm=within(about.get("thickness_mm"), "thickness_mm", 6.0, 40.0))
        if shots.ndim != 3 or len(shots) != len(bursts_of(sequence)):
            raise ValueError(f"shots of shape {shots.shape}, expected ({len(bursts_of(sequence))}, positions, samples)")
        if not (16 <= shots.shape[1] <= 512 and SAMPLES <= shots.shape[2] <= 1 << 16):
            raise ValueError(
                f"{shots.shape[1]} positions of {shots.shape[2]} samples, expected 16..512 of {SAMPLES}..65536"
            )
        if not np.isfinite(shots).all():
            raise ValueError("shots hold values that are no numbers")
        averages = whole(about.get("averages"), "averages", 1, SHOTS_MAX)
        return PlateRecord(
            shots, sequence, averages, rig, laminate, within(about.get("pitch_mm"), "pitch_mm", 0.5, 10.0)
        )
    except (
        OSError,
        RuntimeError,
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        ArithmeticError,
        AnnulusError,
    ) as error:
        what = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise AnnulusError(f"{path}: cannot be read as single-sided shots ({what})") from None


def _only(found: Mapping[str, Any], known: set[str], where: str) -> None:
    if unknown := sorted(set(map(str, found)) - known):
        raise ValueError(f"{where} has {unknown[0]!r}, expected {', '.join(sorted(known))}")
