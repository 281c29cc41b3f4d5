"""Bias-corrected distance correlation (Szekely & Rizzo 2014), many candidates at once: sees what is no straight line.

0 on average where two things have nothing to do with each other, 1 where one is the other scaled; may be below 0. For
a single pair it is `dcor.u_distance_correlation_sqr`, which the tests hold it against.
"""

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray

COUNT_MIN = 4  # of values: with fewer there is nothing left once the centre is taken out


def distance_correlation(candidates: FloatArray, values: FloatArray) -> FloatArray:
    """(...) of (..., n) candidates with (n,) values, n >= COUNT_MIN; 0 where a candidate does not vary."""
    n = len(values)
    rows, columns = np.triu_indices(n, 1)
    centred = _centred(np.abs(values[:, None] - values))
    pairs = centred[rows, columns]
    apart = np.abs(candidates[..., rows] - candidates[..., columns])
    member = np.zeros((len(rows), n))  # which values a pair is of
    member[np.arange(len(rows)), rows] = member[np.arange(len(rows)), columns] = 1
    by_row = apart @ member
    # Inner products of centred matrices, from the plain one: what centring takes out is at right angles to the rest.
    own = 2 * np.sum(apart**2, axis=-1) - 2 / (n - 2) * np.sum(by_row**2, axis=-1)
    own += by_row.sum(axis=-1) ** 2 / ((n - 1) * (n - 2))
    size = np.sqrt(np.maximum(own, 0) * np.sum(centred**2))
    both = 2 * (apart @ pairs)
    varies = size > 1e-12 * max(float(np.max(size)), 1e-300)
    return np.asarray(np.divide(both, size, out=np.zeros_like(both), where=varies))


def _centred(apart: FloatArray) -> FloatArray:
    """U-centred: without rows' and columns' means, so scaled that its diagonal is left out."""
    n = len(apart)
    row = apart.sum(axis=1)
    out: FloatArray = apart - (row[:, None] + row) / (n - 2) + row.sum() / ((n - 1) * (n - 2))
    np.fill_diagonal(out, 0.0)
    return out
