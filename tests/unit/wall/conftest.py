"""Lets the tests here cast the pipes that the rings' tests cast."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "rings"))
