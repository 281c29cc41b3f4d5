"""What sectors that look through the wall read along the pipe: a lane beside the map."""

from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class LaneMark:
    """One place of a lane. sector : of those that look there, from 1; 0: all alike. probability : of `kind`, 0..1."""

    kind: str
    z_mm: float
    length_mm: float
    is_bore: bool
    sector: int = 0
    phi_deg: float = float("nan")  # atan2(y, x), y down
    probability: float = float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class Lane:
    """c_pf : (G, K) by sector along z_mm (G,), drawn where `seen` (G,). remark : for people, what it cannot tell."""

    z_mm: FloatArray
    c_pf: FloatArray
    seen: BoolArray
    marks: tuple[LaneMark, ...] = ()
    remark: str = ""

    def joined(self, other: "Lane") -> "Lane":
        """Another run's readings after these."""
        order = np.argsort(z := np.concatenate([self.z_mm, other.z_mm]), kind="stable")
        marks = tuple(sorted((*self.marks, *other.marks), key=lambda one: one.z_mm))
        remark = self.remark if self.remark == other.remark else f"{self.remark} {other.remark}".strip()
        return Lane(
            z[order],
            np.concatenate([self.c_pf, other.c_pf])[order],
            np.concatenate([self.seen, other.seen])[order],
            marks,
            remark,
        )
