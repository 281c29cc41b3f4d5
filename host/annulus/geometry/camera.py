"""Camera models: pixels to rays and back. Pixel centres are at whole numbers, as in OpenCV."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from annulus.geometry.pose import FloatArray

Model = Literal["pinhole", "fisheye"]


@dataclass(frozen=True, slots=True)
class Camera:
    """Intrinsics. `pinhole` is Brown-Conrady (k1 k2 p1 p2 [k3 ..]), `fisheye` is OpenCV's Kannala-Brandt (k1..k4)."""

    model: Model
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    @property
    def matrix(self) -> FloatArray:
        """K, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def _coefficients(self) -> FloatArray:
        n = 4 if self.model == "fisheye" else max(5, len(self.distortion))
        return np.pad(np.array(self.distortion, dtype=float), (0, n - len(self.distortion)))

    def rays(self, pixels: FloatArray) -> FloatArray:
        """(N, 2) pixels -> (N, 3) unit vectors in the camera frame; NaN outside what the lens model can invert."""
        pixels = np.asarray(pixels, dtype=float)
        if self.model == "fisheye":
            x, y = (pixels[:, 0] - self.cx) / self.fx, (pixels[:, 1] - self.cy) / self.fy
            distorted = np.hypot(x, y)
            theta = _invert_kannala_brandt(distorted, self._coefficients())
            with np.errstate(invalid="ignore"):
                scale = np.where(distorted > 1e-12, np.sin(theta) / np.maximum(distorted, 1e-12), 1.0)
            return np.stack([x * scale, y * scale, np.cos(theta)], axis=1)
        if any(self.distortion):
            criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-12)
            flat = np.asarray(
                cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.matrix, self._coefficients(), criteria=criteria)
            ).reshape(-1, 2)
        else:
            flat = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        rays = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def project(self, points: FloatArray) -> FloatArray:
        """(N, 3) mm in the camera frame -> (N, 2) pixels; NaN behind a pinhole camera."""
        points = np.asarray(points, dtype=float)
        x, y, z = points.T
        if self.model == "fisheye":
            rho = np.hypot(x, y)
            theta = np.arctan2(rho, z)
            t2 = theta * theta
            k1, k2, k3, k4 = self._coefficients()[:4]
            distorted = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            scale = np.where(rho > 1e-12, distorted / np.maximum(rho, 1e-12), 1.0 / np.maximum(np.abs(z), 1e-12))
            return np.stack([self.fx * x * scale + self.cx, self.fy * y * scale + self.cy], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = np.where(z[:, None] > 1e-9, points[:, :2] / z[:, None], np.nan)
        if any(self.distortion):
            ahead = np.isfinite(flat[:, 0])
            out = np.full_like(flat, np.nan)
            if ahead.any():
                shaped = np.concatenate([flat[ahead], np.ones((int(ahead.sum()), 1))], axis=1).reshape(-1, 1, 3)
                out[ahead] = cv2.projectPoints(shaped, np.zeros(3), np.zeros(3), self.matrix, self._coefficients())[
                    0
                ].reshape(-1, 2)
            return out
        return np.asarray(flat * [self.fx, self.fy] + [self.cx, self.cy])


def _invert_kannala_brandt(distorted: FloatArray, k: FloatArray) -> FloatArray:
    """theta with theta (1 + k1 theta^2 + ..) = distorted, by Newton; NaN where it does not converge below pi."""
    theta = np.minimum(distorted, 1.5)
    for _ in range(20):
        t2 = theta * theta
        value = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) - distorted
        slope = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
        theta = np.clip(theta - value / np.where(np.abs(slope) > 1e-6, slope, 1e-6), 0.0, np.pi)
    t2 = theta * theta
    residual = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) - distorted
    return np.where(np.abs(residual) < 1e-9, theta, np.nan)
