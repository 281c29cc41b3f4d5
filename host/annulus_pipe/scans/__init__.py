"""Whatever can be opened as a scan: a recording, a scan folder, one made of a video or of pictures.

One frame type for whatever a scan came from (scan.py); its forms are in README.md. Knows no method.
"""
