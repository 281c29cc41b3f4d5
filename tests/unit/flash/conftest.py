"""Lets the tests here import boot_rom.py beside them, and the scripted controller of the line's tests."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "link")]
