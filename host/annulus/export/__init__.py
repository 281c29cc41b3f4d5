"""Results in other programs' forms: an anomaly list, LAZ, GLB, DXF, E57, radii. From a folder of results, computes no
wall anew."""
