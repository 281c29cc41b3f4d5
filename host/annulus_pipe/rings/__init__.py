"""Concentric coloured rings: one projector frame and a calibration in, a `Profile` of wall points out.

Assumed: a slide of coloured stripes with dark slits between them, each slit a cone of known angle, axis and vertex; a
round pipe of roughly known radius; one flash a frame. In the order of the method: `polar` lays the image out along
lines, `slits` finds the dark slits on them, `decode` names each by its two colours, `triangulate` meets its ray with
its cone, `outliers` drops what is not to be believed, `uncertainty` says how far each point may be off; `reconstructor`
is the whole. `order`, `colour` and `diagnosis` look at frames without trusting their colours; `pattern` designs slides;
`calibration/` finds cones and their residuals from frames. Opens no file, knows no scan.
"""
