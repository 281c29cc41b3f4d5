"""Loops over the rows of the second map: what each place or roll would cost, and the likeliest chain of them.

A row's cost is half the squares of what it differs from the first map there, in units of its sigma, each cut off at
CUT: what grew must not pull; less what they would be of a wall that shows nothing. Chains are piecewise smooth: a step
costs, a slip costs a lot, however far.
"""

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.native import door

CUT = 9.0  # sigma squared
STANDS_MM = 0.15  # what stands out by more is a defect ..
GROWS = 0.3  # .. and may have grown by this part of it and be the same

_costs = door(
    "chain_costs",
    "f4[z,c] second",
    "f4[r,c] first",
    "f8[z,k] row_at",
    "f8[z,k] turned",
    "f8 sigma_mm",
    "f8 cut",
    "f8 stands_mm",
    "f8 grows",
    "f8[z,k]! cost",
)
_likeliest = door(
    "chain_likeliest", "f8[z,k] cost", "f8 step", "f8 slip", "f8[2,k]! room", "i4[z,k]! came", "i8[z]! chain"
)
_believed = door(
    "chain_believed", "f8[z,k] likely", "i8[z] leaps", "f8 near", "f8 far", "f8 fade", "f8[4,k]! room", "f8[z,k]! ahead"
)
_joined = door(
    "chain_joined", "f8[z] weight", "f8[z] pull", "f8[t] tie", "f8[3,z]! room", "f8[z]! value", "f8[z]! variance"
)


def row_costs(
    second: Float32Array, first: Float32Array, row_at: FloatArray, turned: FloatArray, sigma_mm: float
) -> FloatArray:
    """(Z, K) costs of each row of the second at K places of the first: below 0 where it is found again, above where the
    first shows what it does not have.

    row_at (Z, K) in rows of the first, turned (Z, K) in columns: column c of the second lies on c + turned. 0 beside
    the first's rows, and where one of the two did not see.
    """
    cost = np.empty(row_at.shape)
    ordered = map(np.ascontiguousarray, (second, first, row_at, turned))
    _costs(*ordered, sigma_mm, CUT, STANDS_MM, GROWS, cost)
    return cost


def likeliest(cost: FloatArray, step: float, slip: float) -> IntArray:
    """(Z,) the states of the cheapest chain through cost (Z, K): a neighbour costs `step`, any other `slip`."""
    came, chain = np.empty(cost.shape, np.int32), np.zeros(len(cost), np.int64)
    _likeliest(np.ascontiguousarray(cost), step, slip, np.empty((2, cost.shape[1])), came, chain)
    return chain


def believed_states(cost: FloatArray, leaps: IntArray, near: float, far: float, fade: float) -> FloatArray:
    """(Z, K) how likely each state is, by all rows' costs (log-likelihood).

    From a row to the next a state is its neighbour with the likelihood `near` either way, and slips with `far`, by n
    states with fade^n. leaps (Z,): before row i state k is what state k + leaps[i] was.
    """
    likely = np.exp(cost.min(axis=1, keepdims=True) - cost) + 1e-12
    ahead = np.empty(likely.shape)
    _believed(likely, leaps.astype(np.int64), near, far, fade, np.empty((4, likely.shape[1])), ahead)
    return ahead


def joined(weight: FloatArray, pull: FloatArray, tie: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The x of least sum weight x^2 / 2 - pull x + tie (x[i + 1] - x[i])^2 / 2, and its variances: (Z,) both.

    weight, pull (Z,); tie (Z - 1,), 0 where a chain is broken.
    """
    value, variance = np.zeros(len(weight)), np.zeros(len(weight))
    _joined(weight + 1e-9, pull, tie, np.empty((3, len(weight))), value, variance)
    return value, variance
