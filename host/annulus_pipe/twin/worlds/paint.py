"""What marks a wall without changing its shape: silt, stains, the maker's print."""

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.twin.worlds.features import wrap_deg

WHITE = (0.75, 0.77, 0.78)  # albedo of white PVC, red green blue
YELLOW = (0.72, 0.47, 0.06)  # of MDPE gas pipe: blue is absorbed almost wholly
ORANGE = (0.70, 0.22, 0.05)


def stain(albedo: NDArray[np.uint8], base: NDArray[np.float32], step_z_mm: float, rng: np.random.Generator) -> None:
    """Paint in place: a dull invert where silt has lain and brown water stains with soft rims."""
    rows, clocks = albedo.shape[:2]
    clock = np.arange(clocks, dtype=np.float64) * (360.0 / clocks)
    silt = np.exp(-((wrap_deg(clock - 180.0) / 20.0) ** 2))
    albedo[:] = base * (1.0 - silt[:, None] * np.array([0.10, 0.15, 0.22])) + 0.5
    reach = 90  # of a stain and its rim, map cells each way
    for _ in range(round(rows * step_z_mm / 28.0)):
        row, column = int(rng.integers(rows)), int(rng.integers(clocks))
        size = (int(rng.integers(10, 60)), int(rng.integers(8, 36)))
        patch = np.zeros((2 * reach + 1, 2 * reach + 1), np.uint8)
        cv2.ellipse(patch, (reach, reach), size, float(rng.uniform(0, 180)), 0, 360, 255, -1)
        soft = cv2.GaussianBlur(patch, (0, 0), 7.0).astype(np.float32) / np.float32(255.0)
        strength = np.array([0.14, 0.26, 0.42], np.float32) * np.float32(rng.uniform(0.5, 1.0))
        low, high = max(0, row - reach), min(rows, row + reach + 1)
        around = np.arange(column - reach, column + reach + 1) % clocks
        shade = soft[low - row + reach : high - row + reach, :, None] * strength
        albedo[low:high, around] = albedo[low:high, around] * (1.0 - shade) + 0.5


def print_line(albedo: NDArray[np.uint8]) -> None:
    """The maker's print along the pipe at two o'clock, in place. Text runs along z."""
    rows, clocks = albedo.shape[:2]
    tall = 16  # columns of 0.25 degrees: letters 5 mm high
    ink = np.zeros((tall + 12, rows), np.uint8)
    for x in range(20, rows, 560):
        cv2.putText(ink, "ANNULUS TWIN PVC-U 160 SDR 17", (x, tall + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.62, 255, 2)
    soft = cv2.GaussianBlur(ink, (0, 0), 0.8).astype(np.float32).T / np.float32(255.0)
    first = round(60.0 * clocks / 360.0)
    part = albedo[:, first : first + soft.shape[1]]
    part[:] = part * (1.0 - 0.5 * soft[:, :, None]) + 0.5
