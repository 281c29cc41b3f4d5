"""What a recording says of how warm its head was, for what its optics may have drifted by."""

import math
from collections.abc import Iterator
from itertools import islice

from annulus_pipe.record.recording import Recording
from annulus_pipe.scans.scan import Scan
from annulus_pipe.wall.optics import Optics, Prior

TOPIC, TEMPERATURE = "/sensor/", "temperature_c"
READ_MOST = 2000  # of a topic: of an hour's samples the first minutes say enough


def prior_of(scan: Scan) -> Prior:
    """By `[optics]` of the head that recorded it and its sensors' temperature; the widest where one is not there."""
    recording = scan.recording
    stated = (recording.configuration or {}).get("optics") if recording is not None else None
    if recording is None or not stated:
        return Prior()
    try:
        return Optics.from_dict(stated).prior(_celsius(recording))
    except ValueError:  # whoever wrote it
        return Prior()


def _celsius(recording: Recording) -> Iterator[float]:
    for topic in recording.topics:
        if topic.startswith(TOPIC):
            for body in islice(recording.notes(topic), READ_MOST):
                values = body.get("values") if isinstance(body, dict) else None
                value = values.get(TEMPERATURE) if isinstance(values, dict) else None
                if isinstance(value, int | float) and math.isfinite(value):
                    yield float(value)
