"""The optional sections of a calibration: what a ring is off its cone, and how well the rings are known."""

import json
import math

import pytest

from annulus.geometry.calibration import Calibration, RingCorrection
from annulus.geometry.camera import Camera
from annulus.geometry.cone import Cone

CAMERA = Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5)
RINGS = (Cone(0.33, (0.0, 0.0, 1.0), (0.0, 0.0, -56.0)), Cone(0.41, (0.0, 0.0, 1.0), (0.0, 0.0, -56.0)))
COVARIANCE = tuple(tuple(1e-4 if i == j else 0.0 for j in range(12)) for i in range(12))
FINE = (RingCorrection((0.001, -0.002, 0.0)), RingCorrection((0.0, 0.0, 0.001, 0.0), (0.1, 0.0, -0.1, 0.0)))


def _tuned() -> Calibration:
    return Calibration(CAMERA, "RGB", RINGS, 76.2, COVARIANCE, FINE)


def test_what_was_written_is_read_back() -> None:
    read = json.loads(json.dumps(_tuned().to_dict()))
    assert Calibration.from_dict(read) == _tuned()


def test_a_file_of_before_has_neither_section() -> None:
    data = Calibration(CAMERA, "RGB", RINGS, 76.2).to_dict()
    assert "covariance" not in data and "fine" not in data["rings"][0]
    read = Calibration.from_dict(data)
    assert read.covariance is None and read.corrections is None


def test_sections_that_do_not_fit_are_named() -> None:
    for key, value, words in [
        ("covariance", [[1.0]], "12 rows"),
        ("covariance", [[math.nan] * 12] * 12, "covariance.n"),
        ("covariance", [[float(i == j) + 2.0 * (i + j == 1) for j in range(12)] for i in range(12)], "does not fit"),
    ]:
        data = _tuned().to_dict()
        data[key] = value
        with pytest.raises(ValueError, match=words):
            Calibration.from_dict(data)
    for fine, words in [
        ({}, "offset_rad"),
        ({"offset_rad": [0.0, 0.0]}, "3..4096"),
        ({"offset_rad": [0.0] * 4, "shift_mm": [0.0] * 3}, "expected 4"),
    ]:
        data = _tuned().to_dict()
        data["rings"][1]["fine"] = fine
        with pytest.raises(ValueError, match=words):
            Calibration.from_dict(data)
    data = _tuned().to_dict()
    del data["rings"][1]["fine"]
    with pytest.raises(ValueError, match=r"rings\[1\]\.fine"):
        Calibration.from_dict(data)
