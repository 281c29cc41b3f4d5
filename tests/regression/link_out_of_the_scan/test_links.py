"""frames.csv took a file that is a link to anywhere, digits with underscores and rows longer than its heading. Fails
where `record.scan` asks only whether the name has `..` in it."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.scans.scan import open_scan
from annulus_pipe.vocabulary import AnnulusError


@pytest.mark.parametrize(
    ("heading", "row", "says"),
    [
        ("", "0,link.png,led,0", "line 2: file 'link.png' is or lies behind a link"),
        ("", "0,away/0.png,led,0", "line 2: file 'away/0.png' is or lies behind a link"),
        ("", "0,0.png,led,1_000", 'line 2: z_mm is "1_000"'),
        ("", "0,0.png,led,\N{ARABIC-INDIC DIGIT ONE}", "line 2: z_mm is"),
        ("", "0,0.png,led,0,0,0,0", "line 2: 7 cells, expected 4 as line 1 has"),
        (",z_mm", "0,0.png,led,0,5", "line 1: a column is there twice"),
    ],
)
def test_a_row_that_is_none_is_named(heading: str, row: str, says: str, tmp_path: Path) -> None:
    scan = tmp_path / "scan"
    for folder in (scan, tmp_path / "elsewhere"):
        folder.mkdir()
        cv2.imwrite(str(folder / "0.png"), np.zeros((4, 4, 3), np.uint8))
    (scan / "link.png").symlink_to(tmp_path / "elsewhere/0.png")
    (scan / "away").symlink_to(tmp_path / "elsewhere")
    (scan / "frames.csv").write_text(f"index,file,light,z_mm{heading}\n{row}\n")
    with pytest.raises(AnnulusError) as caught:
        open_scan(scan)
    assert says in str(caught.value)
