"""Numbers without a subject: array types, loops in C, robust statistics, and how a number is read. Knows no pipe.

Assumed by the loops: NaN means "nothing here" and keeps that meaning; sums have one order, so they are the same bits on
every machine.
"""
