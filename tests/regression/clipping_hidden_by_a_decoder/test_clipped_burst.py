"""Flat tops of a coded shot were looked for after decoding, which spreads them until nobody sees them (5c243d4). Fails
when make_image examines the decoded record only."""

from pathlib import Path

import numpy as np

from annulus_pipe.link.codes import CODES
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, save_acoustic
from annulus_pipe.wings.tai.image import ImageSettings, make_image

RATE_HZ, CHIP_S, RADIUS_MM = 10e6, 0.5e-6, 9.0


def heard(angles_deg: np.ndarray) -> np.ndarray:
    """A point off the middle, sent for with the stuffed code: a pulse of pressure for every chip that is on."""
    turn, times = np.radians(angles_deg), np.arange(500) / RATE_HZ
    way = np.hypot(RADIUS_MM * np.cos(turn) - 2.2, RADIUS_MM * np.sin(turn)) * 1e-3 / 1500.0
    chips = CHIP_S * (np.flatnonzero([int(chip) for chip in CODES["mpsl25-stuffed"]]) + 0.5)
    x = (times[None, None] - way[:, None, None] - chips[None, :, None]) / 2.5e-7
    return (-x * np.exp(-(x**2))).sum(axis=1)


def test_a_clipped_shot_is_found_before_its_decoder_hides_it(tmp_path: Path) -> None:
    angles = np.arange(16) * 22.5
    signals = heard(angles) + 1e-3 * np.random.default_rng(2).normal(size=(16, 500))
    signals[6] = np.clip(signals[6], -0.2, 0.2)
    code = CODES["mpsl25-stuffed"]
    record = AcousticRecord(signals.astype(np.float32), angles, RADIUS_MM, RATE_HZ, 0.0, 1500.0, code, CHIP_S)
    save_acoustic(tmp_path / "raw.npz", record)
    result = make_image(tmp_path / "raw.npz", tmp_path / "out", ImageSettings("back-projection", pixel_mm=0.5))
    assert result.excluded == (6,)
    assert any("(6) are cut off at the digitizer's range" in finding for finding in result.findings)
