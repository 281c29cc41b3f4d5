"""Numbers without a subject: array types, compiled loops, robust statistics, and how a number is read. Knows no pipe.

Assumed by compiled loops: NaN means "nothing here" and keeps that meaning; sums may be regrouped, so two machines may
differ in a last bit.
"""
