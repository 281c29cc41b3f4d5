"""Acquisition and reconstruction for a multi-modality inspector of plastic pipes."""

import os

# Matrices here are small and many: threads of BLAS that wait for one another took four times the processor of one,
# 19 s in place of 4 for the axis of a pipe that undulates. Before numpy is imported; who knows better is heard.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
