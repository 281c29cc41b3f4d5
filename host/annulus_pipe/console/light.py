"""How evenly a flash lights the rows of a picture, in two numbers."""

from typing import Any

import numpy as np


def light(camera: int, label: str, index: int, part: bytes) -> dict[str, Any]:
    """`part`: float32, little-endian, the mean light of each band of rows, 0..255.

    banding_percent : the brightest band less the darkest, of the mean. What the picture shows has its part in it: it
    says something where it changes as a flash is moved. None of a picture that is dark.
    """
    bands = np.frombuffer(part, "<f4").astype(np.float64)
    bands = bands[np.isfinite(bands)]
    mean = float(bands.mean()) if len(bands) else 0.0
    banding = 100.0 * float(bands.max() - bands.min()) / mean if mean >= 1.0 else None
    return {
        "camera": camera,
        "label": label,
        "index": index,
        "mean": round(mean, 1),
        "banding_percent": None if banding is None else round(banding, 1),
    }
