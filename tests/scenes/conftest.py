"""Whole methods on drawn, ray-traced and photographed scenes. Lets them draw what the rings' unit tests draw."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "rings"))
