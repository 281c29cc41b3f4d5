"""Lets the tests here draw what the rooms' own tests draw."""

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parents[1] / "unit" / room) for room in ("rings", "link", "flash")]
