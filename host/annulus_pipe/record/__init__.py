"""Recordings: one scan in an MCAP file or in parts of it, written so that a kill costs the last moments only.

The form is in README.md. Everything made before still reads: tests/unit/scans/test_made_before.py. Knows no method.
"""
