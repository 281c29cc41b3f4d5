"""A joint's dogbones, from files to files: their strengths, light through them, whether joints tell good from bad.

Each door gives what its JSON says, and the files written, that one first.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.clusters import leave_one_out
from annulus_pipe.wings.joints.measure.statistics import LEVEL, Search, Strengths, correlate, moving_mean, power
from annulus_pipe.wings.joints.measure.transmission import against_strengths, paired, thickness_along, transmission
from annulus_pipe.wings.joints.pictures import write_clusters, write_correlation, write_transmission
from annulus_pipe.wings.joints.raster_file import read_walls
from annulus_pipe.wings.joints.strength_file import read_features, read_results, read_strengths, read_transmission

Written = tuple[dict[str, Any], list[Path]]

SENSES = {"same": (1,), "mirrored": (-1,), "either": (1, -1)}  # of the dogbones' angles, beside the volume's


def correlate_strengths(
    folder: Path, strength: Path, names: Sequence[str], within_deg: float, sense: str, mean_deg: float
) -> Written:
    """Features of a joint's folder against its dogbones' strengths. sense : of `SENSES`."""
    curves = _means(folder / "features.json", names, mean_deg)
    angles, energies = read_strengths(strength)
    try:
        strengths = Strengths(angles, energies)
    except AnnulusError as error:
        raise AnnulusError(f"{strength}: {error}") from None
    search, known_zero = Search(within_deg, senses=SENSES[sense]), Search(0.0, senses=(1,))
    relations = correlate(curves, strengths, search)
    content: dict[str, Any] = {
        "strengths": str(strength),
        "n": len(angles),
        "angle_deg": angles,
        "energy_j": energies,
        "within_deg": within_deg,
        "sense_sought": sense,
        "mean_deg": mean_deg,
        "level": LEVEL,
        "features": {
            one.name: {
                **one.figures(),
                "told_if_r_0.8": power(curves[one.name], angles, search),
                "told_if_r_0.8_known_zero": power(curves[one.name], angles, known_zero),
                "verdict": one.verdict,
            }
            for one in relations
        },
    }
    return content, write_correlation(folder, content, curves, {one.name: one.chance for one in relations})


def compare_light(folder: Path, lines: Path, strength: Path | None, zero_deg: float | None) -> Written:
    """Line scans of light. zero_deg : the CT's angle of dogbone_0; the folder's CT then says the thickness."""
    z, angles, mv = read_transmission(lines)
    try:
        found = transmission(z, mv)
        if zero_deg is not None:
            thickness = thickness_along(*read_walls(folder), (angles + zero_deg) % 360, z, found.joint_mm)
            found = transmission(z, mv, thickness)
    except AnnulusError as error:
        raise AnnulusError(str(error) if str(folder) in str(error) else f"{lines}: {error}") from None
    content = {
        "lines": str(lines),
        "units": "mm, degrees, absorbance to base e",
        "dogbone_deg": angles.tolist(),
        **found.figures(),
    }
    if strength is not None:
        at, energy = read_strengths(strength)
        which = paired(at, angles)
        if which is None:
            raise AnnulusError(f"{strength}: has not the {len(angles)} dogbones of {lines}, expected their angles")
        energy = energy[which]
        r, as_good, least = against_strengths(found.depth, energy)
        content |= {"energy_j": energy.tolist(), "r": r, "as_good_by_turning": as_good, "least_by_turning": least}
    return content, write_transmission(folder, content, found.curves())


def classify_dogbones(dogbones: Path, out: Path, names: Sequence[str], mean_deg: float) -> Written:
    """Good and bad dogbones of several joints, each joint told by the others. dogbones : CSV beside the joints'
    folders."""
    joints, angles, good = read_results(dogbones)
    folders = list(dict.fromkeys(joints))
    values = np.empty((len(joints), len(names)))
    for folder in folders:
        mine = [k for k, one in enumerate(joints) if one == folder]
        for column, mean in enumerate(_means(dogbones.parent / folder / "features.json", names, mean_deg).values()):
            turn = np.linspace(0, 360, len(mean), endpoint=False)
            values[mine, column] = np.interp(angles[mine], turn, mean, period=360)
    pipe = np.array([folders.index(one) for one in joints])
    try:
        found = leave_one_out(values, good, pipe, angles)
    except AnnulusError as error:
        raise AnnulusError(f"{dogbones}: {error}") from None
    content = {
        "dogbones": str(dogbones),
        "features": list(names),
        "mean_deg": mean_deg,
        "joints": folders,
        "joint": joints,
        "angle_deg": angles,
        "good": good.tolist(),
        "values": values,
        **found.figures(),
    }
    return content, write_clusters(out, content)


def _means(source: Path, names: Sequence[str], mean_deg: float) -> dict[str, FloatArray]:
    """(P,) each: named features of a features.json, mean over a dogbone, even round the pipe."""
    phi, raw = read_features(source, names)
    out = {}
    for name, values in raw.items():
        try:
            out[name] = moving_mean(phi, values, mean_deg)
        except AnnulusError as error:
            raise AnnulusError(f"{source}: {name} is {error}") from None
    return out
