"""Lets the tests here import synthetic_pipe.py of the rings' tests."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "rings"))
