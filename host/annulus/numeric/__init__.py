"""Numbers without a subject: array types, compiled loops, robust statistics. Knows nothing of pipes.

Assumed by compiled loops: NaN means "nothing here" and keeps that meaning; sums may be regrouped, so two machines may
differ in a last bit.
"""
