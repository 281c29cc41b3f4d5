"""`annulus calibrate`: the camera, the rings, the paint; every answer goes into one calibration.json."""

from annulus.cli.show import group

app = group("Measure the head: camera, rings, colours. Every answer goes into one calibration.json.")


@app.callback()
def _calibrate() -> None:
    """Commands below share one file: each replaces its own sections and keeps the others."""
