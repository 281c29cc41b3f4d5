"""Results in other programs' forms: an anomaly list, LAZ, GLB, DXF, E57, radii. From a folder of results, computes no
wall anew.

What is read here may come from anywhere, so every file is looked at before it is believed; what is written is made
beside and moved into place whole. One small file a form; `FORMS` says which there are and what they need.
"""

from annulus_pipe.export.forms import FORMS, Form, available, write
from annulus_pipe.export.results import Results, open_results

__all__ = ["FORMS", "Form", "Results", "available", "open_results", "write"]
