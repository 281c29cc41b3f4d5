"""What `annulus joint image` says of drawn CT volumes: zone, thickness, hi-lo, beads and flaws against their truth."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure import features, image, summary
from annulus_pipe.wings.joints.volume_file import open_volume
from tools.bench.blind.others.joint_volumes import BELL, Flaw, Joint, draw, scanned, wave
from tools.bench.blind.others.tally import Case
from tools.bench.blind.score import Number

ANGLES = 8  # at which numbers are held against the truth: where dogbones are cut
LIMIT_SNR = 14.0  # of a flaw's smoothed contrast over the noise smoothed alike: over it it must be found
TOLD_DROP = 0.004  # of density: a shallower zone need not be told


def measured(seed: int, folder: Path) -> Case:
    rng = np.random.default_rng([seed, 91])
    joint = draw(rng)
    grey, noise, form = scanned(joint, rng)
    np.save(folder / "ct.npy", grey)
    (folder / "ct.json").write_text(json.dumps({"voxel_mm": joint.voxel}), encoding="utf-8")
    dz, _, dx = joint.voxel
    case = Case(
        seed,
        f"{2 * joint.radius:.0f} mm, wall {joint.wall / dx:.0f} voxels, {dz / dx:.1f} as long, {form}, "
        f"noise {100 * noise:.2f} %, hi-lo {math.hypot(*joint.aside):.2f} mm, zone "
        f"{100 * joint.zone_drop:.1f} %",
    )
    try:
        found = image(open_volume(folder / "ct.npy"))
    except AnnulusError as error:
        case.refused = str(error).replace(str(folder), "")
        return case
    finally:
        (folder / "ct.npy").unlink()
    score(case, joint, noise, features(found), summary(found))
    return case


def score(case: Case, joint: Joint, noise: float, reported: dict[str, Any], prior: dict[str, Any]) -> None:
    at = np.arange(ANGLES) * 2 * math.pi / ANGLES
    index = [int(np.argmin(np.abs(np.radians(reported["phi_deg"]) - one))) for one in at]
    ahead, behind = np.full(ANGLES, 1e3), np.full(ANGLES, -1e3)
    nought = np.zeros(ANGLES)
    plain_out, plain_in = (
        0.5 * (joint.surface(one, at, ahead) + joint.surface(one, at, behind)) for one in (False, True)
    )
    size = 1 + wave(joint.bead_wave, at)
    zone = {"W": joint.mean_width(at), "haz": np.full(ANGLES, 1 - joint.zone_drop)}
    thick = joint.surface(False, at, nought) - joint.surface(True, at, nought)
    for what, name, true in (("zone's width", "W", zone["W"]), ("zone's density, %", "haz", 100 * zone["haz"])):
        scale = 100.0 if name == "haz" else 1.0
        for k, true_one in zip(index, true, strict=True):
            value, k2 = scale * reported[name][k], 2 * scale * reported[f"{name}_sigma"][k]
            if not math.isfinite(value):
                if joint.zone_drop > TOLD_DROP:
                    case.unsaid[what] += 1
            elif joint.zone_drop == 0:
                case.false.append(f"{what} {value:.2f} +- {k2:.2f} where there is no zone")
            else:
                case.numbers.append(Number(what, "all round", value, k2, float(true_one)))
    hilo = "hi-lo" if any(joint.aside) else "no hi-lo"
    numbers = [
        ("thickness T", hilo, reported["T"][k], 2 * reported["T_sigma"][k], true)
        for k, true in zip(index, thick, strict=True)
    ]
    sigma, aside = prior["hilo_mm"]["sigma"], prior["hilo_mm"]["axes_aside"]
    numbers.append(("hi-lo, axes aside", hilo, aside, 2 * sigma, math.hypot(*joint.aside)))
    for name, what, true in (
        ("ho", "bead's height", size * 0.5 * (joint.rolls[0][0] + joint.rolls[1][0])),
        ("hi", "bead's height", size * 0.5 * (joint.rolls[2][0] + joint.rolls[3][0])),
        ("wo", "bead's width", size * (joint.rolls[0][1] + joint.rolls[1][1])),
        ("wi", "bead's width", size * (joint.rolls[2][1] + joint.rolls[3][1])),
        ("ro", "outer radius", plain_out),
        ("ri", "inner radius", plain_in),
    ):
        row = np.asarray(reported[name])
        row = row.mean(axis=0) if row.ndim == 2 else row
        numbers += [(what, "all round", row[k], math.nan, one) for k, one in zip(index, true, strict=True)]
    for what, where, value, k2, true_one in numbers:
        if math.isfinite(value):
            case.numbers.append(Number(what, where, float(value), float(k2), float(true_one)))
        else:
            case.unsaid[what] += 1
    match(case, joint, noise, reported["found"])


def match(case: Case, joint: Joint, noise: float, found: list[dict[str, Any]]) -> None:
    voxel = float(np.prod(joint.voxel)) ** (1 / 3)
    left = list(found)
    for flaw in joint.flaws:
        bell = (math.sqrt(2 * math.pi) * math.hypot(BELL, 0.7) * voxel) ** 3
        volume = 4 / 3 * math.pi * flaw.size_mm**3
        part = volume / (volume + bell)
        if flaw.kind == "gap":
            part = flaw.size_mm / (flaw.size_mm + math.sqrt(2 * math.pi) * math.hypot(BELL, 0.7) * joint.voxel[0])
        strong = abs(flaw.contrast) * part > LIMIT_SNR * noise
        mine = [one for one in left if near(flaw, one, voxel)]
        left = [one for one in left if one not in mine]
        kinds = [one["kind"] for one in mine]
        state = "found" if flaw.kind in kinds else "misnamed" if mine else "missed" if strong else "below the limit"
        reported = f"{', '.join(kinds)}; of {flaw.size_mm / voxel:.1f} voxels, contrast {flaw.contrast:+.2f}"
        case.things.append((flaw.kind, state, reported))
    case.false += [
        f"{one['kind']} at {one['phi_deg']:.0f} deg, {one['from_joint_mm']:+.1f} mm, snr {one['snr']:.1f}"
        for one in left
    ]


def near(flaw: Flaw, one: dict[str, Any], voxel: float) -> bool:
    off = (math.radians(one["phi_deg"]) - flaw.phi + math.pi) % (2 * math.pi) - math.pi
    if flaw.kind == "gap":
        wide = flaw.arc + 0.5 * math.radians(one["arc_deg"])
        return abs(off) < wide and abs(one["from_joint_mm"]) < 2.5 * voxel
    away = math.sqrt((flaw.rho * off) ** 2 + (one["rho"] - flaw.rho) ** 2 + (one["from_joint_mm"] - flaw.z) ** 2)
    return away < flaw.size_mm + 2.5 * voxel
