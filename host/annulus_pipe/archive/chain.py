"""Loops over the rows of the second map: what each place or roll would cost, and the likeliest chain of them.

A row's cost is half the squares of what it differs from the first map there, in units of its sigma, each cut off at
CUT: what grew must not pull; less what they would be of a wall that shows nothing. Chains are piecewise smooth: a step
costs, a slip costs a lot, however far.
"""

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.jit import jit

CUT = 9.0  # sigma squared
STANDS_MM = 0.15  # what stands out by more is a defect ..
GROWS = 0.3  # .. and may have grown by this part of it and be the same


@jit
def _row_costs(second, first, row_at, turned, sigma, cost):  # type: ignore[no-untyped-def]
    rows, columns = first.shape
    per = 1.0 / (sigma * sigma)
    for i in range(row_at.shape[0]):
        for k in range(row_at.shape[1]):
            at = row_at[i, k]
            low = int(np.floor(at))
            if not (low >= 0 and low + 1 < rows):
                continue
            part = at - low
            whole = np.floor(turned[i, k])
            aside = turned[i, k] - whole
            begin = int(whole) % columns
            total = 0.0
            for c in range(columns):
                left = c + begin
                if left >= columns:
                    left -= columns
                right = left + 1
                if right == columns:
                    right = 0
                there = (1 - part) * ((1 - aside) * first[low, left] + aside * first[low, right]) + part * (
                    (1 - aside) * first[low + 1, left] + aside * first[low + 1, right]
                )
                off = second[i, c] - there
                if off == off:
                    stands = GROWS * max(abs(there) - STANDS_MM, 0.0)
                    total += min(off * off / (sigma * sigma + stands * stands), CUT)
                    total -= min(second[i, c] * second[i, c] * per, CUT)
            cost[i, k] = 0.5 * total


def row_costs(
    second: Float32Array, first: Float32Array, row_at: FloatArray, turned: FloatArray, sigma_mm: float
) -> FloatArray:
    """(Z, K) costs of each row of the second at K places of the first: below 0 where it is found again, above where the
    first shows what it does not have.

    row_at (Z, K) in rows of the first, turned (Z, K) in columns: column c of the second lies on c + turned. 0 beside
    the first's rows, and where one of the two did not see.
    """
    cost = np.zeros(row_at.shape)
    _row_costs(second, first, row_at, turned, sigma_mm, cost)
    return cost


@jit
def _likeliest(cost, step, slip, came):  # type: ignore[no-untyped-def]
    rows, states = cost.shape
    total = cost[0].copy()
    reach = np.empty(states)
    for i in range(1, rows):
        least = 0
        for k in range(states):
            came[i, k] = k
            reach[k] = total[k]
            if total[k] < total[least]:
                least = k
        for k in range(1, states):
            if reach[k - 1] + step < reach[k]:
                reach[k] = reach[k - 1] + step
                came[i, k] = came[i, k - 1]
        for k in range(states - 2, -1, -1):
            if reach[k + 1] + step < reach[k]:
                reach[k] = reach[k + 1] + step
                came[i, k] = came[i, k + 1]
        far = total[least] + slip
        for k in range(states):
            if far < reach[k]:
                reach[k] = far
                came[i, k] = least
            total[k] = reach[k] + cost[i, k]
    at = 0
    for k in range(states):
        if total[k] < total[at]:
            at = k
    return at


def likeliest(cost: FloatArray, step: float, slip: float) -> IntArray:
    """(Z,) the states of the cheapest chain through cost (Z, K): a neighbour costs `step`, any other `slip`."""
    came = np.zeros(cost.shape, np.int32)
    chain = np.zeros(len(cost), np.int64)
    chain[-1] = _likeliest(np.ascontiguousarray(cost), step, slip, came)
    for i in range(len(cost) - 1, 0, -1):
        chain[i - 1] = came[i, chain[i]]
    return chain


@jit
def _passed(belief, leap, near, far, fade, out):  # type: ignore[no-untyped-def]
    states = belief.shape[0]
    for k in range(states):  # no slip where one was believed: the same place is another state
        out[k] = belief[k + leap] if 0 <= k + leap < states else 0.0
    _spread(out, near, far, fade)


@jit
def _spread(belief, near, far, fade):  # type: ignore[no-untyped-def]
    states = belief.shape[0]
    down, up = np.empty(states), np.empty(states)
    for k in range(states):
        down[k] = belief[k] + (fade * down[k - 1] if k > 0 else 0.0)
        back = states - 1 - k
        up[back] = belief[back] + (fade * up[back + 1] if k > 0 else 0.0)
    share = far * (1.0 - fade) / (1.0 + fade)
    before = belief[0]
    for k in range(states):
        now = belief[k]
        after = belief[k + 1] if k + 1 < states else now
        belief[k] = now + near * (before - 2.0 * now + after) - far * now + share * (down[k] + up[k] - now)
        before = now


@jit
def _believed(likely, leaps, near, far, fade):  # type: ignore[no-untyped-def]
    rows, states = likely.shape
    ahead = np.empty((rows, states))
    back, part = np.full(states, 1.0 / states), np.empty(states)
    for i in range(rows):
        if i == 0:
            ahead[i] = likely[i]
        else:
            _passed(ahead[i - 1], leaps[i], near, far, fade, part)
            ahead[i] = part * likely[i]
        ahead[i] /= ahead[i].sum()
    for i in range(rows - 1, -1, -1):
        ahead[i] *= back
        ahead[i] /= ahead[i].sum()
        if i > 0:
            part[:] = back * likely[i]
            _spread(part, near, far, fade)
            for k in range(states):
                back[k] = part[k - leaps[i]] if 0 <= k - leaps[i] < states else 0.0
            back /= back.sum()
    return ahead


def believed_states(cost: FloatArray, leaps: IntArray, near: float, far: float, fade: float) -> FloatArray:
    """(Z, K) how likely each state is, by all rows' costs (log-likelihood).

    From a row to the next a state is its neighbour with the likelihood `near` either way, and slips with `far`, by n
    states with fade^n. leaps (Z,): before row i state k is what state k + leaps[i] was.
    """
    likely = np.exp(cost.min(axis=1, keepdims=True) - cost) + 1e-12
    return np.asarray(_believed(likely, leaps.astype(np.int64), near, far, fade))


@jit
def _joined(weight, pull, tie, value, variance):  # type: ignore[no-untyped-def]
    rows = weight.shape[0]
    down, up, right = np.empty(rows), np.empty(rows), np.empty(rows)
    for i in range(rows):
        before = tie[i - 1] if i > 0 else 0.0
        after = tie[i] if i < rows - 1 else 0.0
        variance[i] = weight[i] + before + after
    down[0], right[0] = variance[0], pull[0]
    for i in range(1, rows):
        share = tie[i - 1] / down[i - 1]
        down[i] = variance[i] - share * tie[i - 1]
        right[i] = pull[i] + share * right[i - 1]
    up[rows - 1] = variance[rows - 1]
    value[rows - 1] = right[rows - 1] / down[rows - 1]
    for i in range(rows - 2, -1, -1):
        up[i] = variance[i] - tie[i] * tie[i] / up[i + 1]
        value[i] = (right[i] + tie[i] * value[i + 1]) / down[i]
    for i in range(rows):
        variance[i] = 1.0 / (down[i] + up[i] - variance[i])


def joined(weight: FloatArray, pull: FloatArray, tie: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The x of least sum weight x^2 / 2 - pull x + tie (x[i + 1] - x[i])^2 / 2, and its variances: (Z,) both.

    weight, pull (Z,); tie (Z - 1,), 0 where a chain is broken.
    """
    value, variance = np.zeros(len(weight)), np.zeros(len(weight))
    _joined(weight + 1e-9, pull, tie, value, variance)
    return value, variance
