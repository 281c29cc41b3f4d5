"""A quote that breaks frames.csv was reported on the line before it (a3caf7d). Fails with DictReader's own line_num,
which is that of the last good row."""

from pathlib import Path

import pytest

from annulus_pipe.scans.scan import open_scan
from annulus_pipe.vocabulary import AnnulusError


def test_the_line_that_is_bad_is_named(tmp_path: Path) -> None:
    (tmp_path / "0.png").touch()
    (tmp_path / "frames.csv").write_text('index,file,light,z_mm\n0,0.png,led,0\n1,"0.png"x,led,0\n')
    with pytest.raises(AnnulusError, match="line 3: "):
        open_scan(tmp_path)
