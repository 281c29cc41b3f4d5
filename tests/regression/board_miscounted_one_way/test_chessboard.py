"""A board counted too small one way only was cropped to fit and calibrated without a word (ca3598f). Fails when both
directions must be larger than said."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.calibrate.camera import calibrate_camera
from annulus_pipe.vocabulary import AnnulusError


def test_a_board_miscounted_one_way_is_pointed_out(tmp_path: Path) -> None:
    squares = np.indices((6, 8)).sum(axis=0) % 2  # 7x5 inner corners
    board = np.pad(np.kron(255 * squares, np.ones((40, 40))).astype(np.uint8), 60, constant_values=255)
    files = []
    for i, lean in enumerate((30, 70)):
        corners = np.array([[0, 0], [440, 0], [440, 360], [0, 360]], np.float32)
        seen = corners + np.array([[lean, 40], [120, 90 - lean], [110, 60], [20, 50 + lean]], np.float32)
        image = cv2.warpPerspective(board, cv2.getPerspectiveTransform(corners, seen), (640, 480), borderValue=255)
        files.append(tmp_path / f"{i}.png")
        cv2.imwrite(str(files[-1]), cv2.GaussianBlur(image, (0, 0), 0.8))
    with pytest.raises(AnnulusError, match="show 7x5"):
        calibrate_camera(files, target="7x4")
