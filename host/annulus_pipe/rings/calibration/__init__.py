"""What ring images say of the head itself: cones, poses and residual corrections, from a clean pipe or a flat target.

Assumed: a scan taken for it, the lens known. `contours` reads rings before any cone is known; `autocalibration` (on
`observations`, `bundle`, `kernels`) finds cones and poses together from a pipe, `target` cones from flat targets;
`corrections` and `reference` what each ring is off its cone; `cross_validation` what all that is worth.
"""
