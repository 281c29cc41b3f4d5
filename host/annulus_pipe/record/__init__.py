"""What outlives the process: recordings, scan folders, calibrations and raw sound, read and written whole.

One frame type for whatever a scan came from (scan.py), and one form for each file (README.md). Everything made before
still reads: tests/unit/record/test_made_before.py. Knows no method.
"""
