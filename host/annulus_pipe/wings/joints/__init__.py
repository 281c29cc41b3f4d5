"""Butt-fusion joints on a bench: CT volumes, a near-field probe's rasters, light through dogbones, strengths."""
