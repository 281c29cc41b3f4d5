"""What the model says of chapter 10, as numbers and curves: Figures 10.3 and 10.5, depth, shield, and the GTI's pipes.

The GTI's pipes lie in, half in, and beside an 8-inch sewer. The source gives what was seen in words only; the numbers
beside them are those of another field, a prototype's. Its pipes are of 4 inches, its sensor one of 120 degrees: both
are kept at this head's here.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wings.crossbore.measure.bored import bored, source_cases
from annulus_pipe.wings.crossbore.measure.field import (
    AIR,
    SECTORS,
    SOIL,
    WATER,
    Along,
    CrossSection,
    Pair,
    along,
    sectors,
)

SEWER_MM = 101.6  # radius, 8 inches
POCKET_MM = 76.2  # of air along the pipe, as in Figure 10.3
PROTOTYPE_FF = {  # of a prototype's field, air in the bore
    "through": (-243.0, -243.0, -243.0),
    "half": (-91.0, -220.0, -2.0),
    "10 mm clear": (None, -7.0, None),
    "50 mm clear": (0.0, 0.0, 0.0),
}
GTI = {"through": "A", "half": "B", "10 mm clear": "C", "50 mm clear": "C"}
LIFT_MM = 1.0
LIFT_PROTOTYPE = 0.31
DEPTH_PROTOTYPE_MM = 4.5  # half of the swing: taken here as what so thick a layer of air beside the wall takes off


@dataclass(frozen=True, slots=True)
class Map:
    """|E| of a pair at 1 V (or a sector), V/m, at points (n, 2) mm: (z, rho) along the pipe, (x, y) across it."""

    points_mm: FloatArray
    v_m: FloatArray


@dataclass(frozen=True, slots=True)
class Model:
    """figures : numbers, units in their names. curves : (n,) each. maps : by name."""

    figures: dict[str, Any]
    curves: dict[str, FloatArray]
    maps: dict[str, Map]


def model(
    soil: complex = SOIL, progress: Callable[[str, int, int], None] = lambda what, done, total: None, fine: float = 1.0
) -> Model:
    """Some 40 s. AnnulusError where scikit-fem is not installed."""
    plain = CrossSection(soil=soil, fine=fine)
    pairs = {name: along(Along(one, one, fine=fine)) for name, one in (("air", AIR), ("soil", soil), ("water", WATER))}
    swing = pairs["soil"].differential_pf - pairs["air"].differential_pf
    unshielded = {name: along(Along(one, one, shield=False, fine=fine)) for name, one in (("air", AIR), ("soil", soil))}
    pocket = along(Along(AIR, soil, -POCKET_MM / 2, POCKET_MM / 2, fine=fine))
    place = np.arange(-120.0, 121.0, 3.0)
    # soil lies at z > 0 of the tank; the head stands at `place` and sees its boundary at -place
    passing = [along(Along(soil, AIR, from_mm=-at, fine=fine)) for at in place]
    depth = np.array([0.5, 1, 1.5, 2, 3, 4, 4.5, 5, 6, 8, 10, 12, 15, 20, 30])
    lost = np.array(
        [
            (pairs["soil"].differential_pf - along(Along(AIR, soil, depth_mm=one, fine=fine)).differential_pf) / swing
            for one in depth
        ]
    )
    across = {name: sectors(replace(plain, soil=one)) for name, one in (("air", AIR), ("soil", soil), ("water", WATER))}
    bores = _bores(plain, progress)
    figures = {
        "drive_mhz": 6.5,
        "soil_eps": soil.real,
        "soil_eps_loss": -soil.imag,
        "head": {
            "radius_mm": plain.head.radius_mm,
            "sector_deg": plain.head.sector_deg,
            "electrode_mm": plain.head.electrode_mm,
            "apart_mm": plain.head.apart_mm,
        },
        "pipe": {
            "inner_radius_mm": plain.pipe.inner_mm,
            "outer_radius_mm": plain.pipe.outer_mm,
            "eps": complex(plain.pipe.eps).real,
        },
        "along": {name: _pair(one) for name, one in pairs.items()},
        "along_shield_off": {name: _pair(one) for name, one in unshielded.items()},
        "swing_ff": 1000 * swing,
        "swing_of_standing": swing / pairs["air"].differential_pf,
        "swing_of_standing_shield_off": (
            (unshielded["soil"].differential_pf - unshielded["air"].differential_pf) / unshielded["air"].differential_pf
        ),
        "pocket": {
            "length_mm": POCKET_MM,
            "change_ff": 1000 * (pocket.differential_pf - pairs["soil"].differential_pf),
        },
        "half_depth_mm": float(np.interp(0.5, lost, depth)),
        "half_depth_prototype_mm": DEPTH_PROTOTYPE_MM,
        "across_pf_per_m": {name: one.pf_per_m.tolist() for name, one in across.items()},
        "across_pf": {name: one.pf.tolist() for name, one in across.items()},
        "across_loss_ff": {name: one.loss_ff.tolist() for name, one in across.items()},
        **bores,
    }
    curves = {
        "place_mm": place,
        "differential_pf": np.array([one.differential_pf for one in passing]),
        "mutual_pf": np.array([one.mutual_pf for one in passing]),
        "depth_mm": depth,
        "lost_share": lost,
    }
    maps = {"soil": _map(pairs["soil"]), "bore": _map(pocket)}
    for name in ("soil", "air"):
        found = across[name].field
        rho, phi = found.grid.middle.T
        points = np.stack([rho * np.cos(phi), rho * np.sin(phi)], axis=1)
        maps[f"across_{name}"] = Map(points, 1000 * found.strength([1.0, 0.0, 0.0]))
    return Model(figures, curves, maps)


def _pair(one: Pair) -> dict[str, float]:
    return {
        "differential_pf": float(one.differential_pf),
        "loss_ff": float(one.loss_ff),
        "mutual_pf": float(one.mutual_pf),
        "single_pf": float(one.single_pf),
    }


def _map(pair: Pair) -> Map:
    return Map(pair.field.grid.middle[:, ::-1], 1000 * pair.field.strength([1.0, 0.0]))


def _bores(plain: CrossSection, progress: Callable[[str, int, int], None]) -> dict[str, Any]:
    """In three dimensions: what bores change, and a head off its axis."""
    fills = {"air": AIR, "water": WATER}
    cases = [
        (fill, *case)
        for fill, eps in fills.items()
        for case in source_cases(SEWER_MM, plain.pipe.outer_mm, eps).items()
    ]
    total = len(cases) + 3

    def report(done: int) -> None:
        progress("fields in 3-D", done, total)

    report(0)
    soil = bored(plain)
    report(1)
    air = bored(replace(plain, soil=AIR))
    report(2)
    off = bored(replace(plain, off_mm=(LIFT_MM, 0.0)))
    report(3)
    swing = soil.pf - air.pf
    rows = []
    for k, (fill, name, bore) in enumerate(cases):
        one = bored(replace(plain, bore=bore))
        report(k + 4)
        row = {
            "pipe": GTI[name],
            "case": name,
            "fill": fill,
            "radius_mm": bore.radius_mm,
            "offset_mm": bore.offset_mm,
            "phi_deg": bore.phi_deg,
            "change_ff": (1000 * (one.pf - soil.pf)).tolist(),
            "loss_ff": (one.loss_ff - soil.loss_ff).tolist(),
        }
        if fill == "air":
            row["prototype_ff"] = list(PROTOTYPE_FF[name])
        rows.append(row)
    return {
        "soil_pf": soil.pf.tolist(),
        "air_pf": air.pf.tolist(),
        "sector_swing_ff": (1000 * swing).tolist(),
        "lift": {
            "off_mm": LIFT_MM,
            "towards_sector": 0,
            "change_ff": (1000 * (off.pf - soil.pf)).tolist(),
            "of_swing": float((off.pf - soil.pf)[0] / swing[0]),
            "of_swing_prototype": LIFT_PROTOTYPE,
        },
        "looks_deg": [120.0 * k for k in range(SECTORS)],
        "nodes": soil.nodes,
        "bores": rows,
    }
