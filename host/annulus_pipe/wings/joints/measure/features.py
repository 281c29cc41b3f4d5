"""What a joint's image says, as plain numbers by name: what files, tables and programs ask for."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wings.joints.measure.image import JointImage


def features(joint: JointImage) -> dict[str, Any]:
    """Arrays by angle under `phi_deg`, NaN where a thing is not told; `found` lists flaws, `from_joint_mm` from the
    fusion plane at their angle. Lengths in mm.

    W, W_sigma : width of the heat-affected zone, mean over the wall's inner part. T, T_sigma : thickness from notch to
    notch. crest : from crest to crest. wo, ho, wi, hi : width and height of the bead outside and inside; no, ni :
    height in its notch. ro, ri : (2, P) radius of either side's plain surface at the joint. zj : fusion plane, z.
    haz : mean density in the zone relative to plain wall, haz_sigma. hilo_out, hilo_in : second surface over the first.
    """
    outside, inside, zone = joint.bead_out, joint.bead_in, joint.zone
    phi_deg = np.degrees(joint.phi)
    return {
        "phi_deg": phi_deg,
        "W": zone.width,
        "W_sigma": zone.width_sigma,
        "T": joint.thickness_mm,
        "T_sigma": joint.thickness_sigma_mm,
        "crest": joint.crest_mm,
        "wo": outside.width,
        "ho": outside.height,
        "no": outside.notch,
        "wi": inside.width,
        "hi": inside.height,
        "ni": inside.notch,
        "haz": 1 - zone.drop,
        "haz_sigma": zone.drop_sigma,
        "ro": joint.outer_sides.at_mm,
        "ri": joint.inner_sides.at_mm,
        "hilo_out": joint.outer_sides.hilo_mm,
        "hilo_in": joint.inner_sides.hilo_mm,
        "zj": joint.fusion_mm,
        "found": [
            {name: getattr(flaw, name) for name in flaw.__slots__}
            | {"from_joint_mm": flaw.z - float(np.interp(flaw.phi_deg, phi_deg, joint.fusion_mm, period=360))}
            for flaw in joint.flaws
        ],
    }


def summary(joint: JointImage) -> dict[str, Any]:
    """A joint in a score of numbers: the median by angle, and the range where it says more."""

    def span(values: FloatArray) -> dict[str, float | None]:
        good = values[np.isfinite(values)]
        spread = (np.median(good), good.min(), good.max()) if len(good) else (None,) * 3
        names = ("median", "least", "greatest")
        return {name: None if v is None else round(float(v), 4) for name, v in zip(names, spread, strict=True)}

    phi, axis = joint.phi, joint.found.axis
    outer = np.asarray(joint.outer_sides.at_mm.mean(axis=0))
    second = 2 * float(np.abs(np.mean(outer * np.exp(-2j * phi))))  # r = mean + second cos 2(phi - ..)
    aside = [2 * float(np.mean(joint.outer_sides.hilo_mm * f(phi))) for f in (np.cos, np.sin)]
    worst = int(np.argmax(np.abs(joint.outer_sides.hilo_mm)))
    return {
        "outer_diameter_mm": round(2 * float(outer.mean()), 3),
        "ovality_percent": round(200 * second / float(outer.mean()), 3),
        "wall_mm": span(joint.wall_mm),
        "lean_deg": round(axis.lean_deg, 3),
        "joint_z_mm": round(float(np.mean(joint.fusion_mm)), 3),
        "W_mm": span(joint.zone.width),
        "W_sigma_mm": span(joint.zone.width_sigma)["median"],
        "T_mm": span(joint.thickness_mm),
        "T_sigma_mm": span(joint.thickness_sigma_mm)["median"],
        "zone_density_percent": span(100 * (1 - joint.zone.drop)),
        "bead_out_width_mm": span(joint.bead_out.width),
        "bead_out_height_mm": span(joint.bead_out.height),
        "bead_in_width_mm": span(joint.bead_in.width),
        "bead_in_height_mm": span(joint.bead_in.height),
        "hilo_mm": {
            "axes_aside": round(float(np.hypot(aside[0], aside[1])), 4),
            "towards_deg": round(float(np.degrees(np.arctan2(aside[1], aside[0])) % 360), 1),
            "greatest_outside": round(float(joint.outer_sides.hilo_mm[worst]), 4),
            "at_deg": round(float(np.degrees(phi[worst])), 1),
            "sigma": round(float(np.sqrt(np.sum(np.median(joint.outer_sides.sigma_mm, axis=1) ** 2))), 4),
        },
        "angles_without_zone": int(np.isnan(joint.zone.width).sum()),
        "angles_without_bead": int((np.isnan(joint.bead_out.width) | np.isnan(joint.bead_in.width)).sum()),
        "found": {kind: sum(flaw.kind == kind for flaw in joint.flaws) for kind in ("void", "grain", "gap")},
    }


def maps(joint: JointImage) -> Mapping[str, FloatArray]:
    """(Z, P) maps, and their axes `z_mm` (Z,) and `phi_deg` (P,)."""
    return {
        "z_mm": joint.z_mm,
        "phi_deg": np.degrees(joint.phi),
        "density": joint.density,
        "outer_mm": joint.outer,
        "inner_mm": joint.inner,
        "bead_out_mm": joint.outer - joint.outer_sides.along(joint.z_mm),
        "bead_in_mm": joint.inner_sides.along(joint.z_mm) - joint.inner,
    }
