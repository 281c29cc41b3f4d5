"""Raw sound came through tempfile.mkstemp with mode 0600 whatever the umask: nobody else on the machine could open it
(c1989b4). Fails when the temporary file's mode is kept."""

import os
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, save_acoustic


@pytest.mark.parametrize("name", ["raw.npz", "raw.hdf5"])
def test_others_may_read_what_the_umask_lets_them(tmp_path: Path, name: str) -> None:
    before = os.umask(0o022)
    try:
        save_acoustic(tmp_path / name, AcousticRecord(np.ones((4, 32), np.float32), np.arange(4) * 90.0, 9.0, 1e6))
    finally:
        os.umask(before)
    assert (tmp_path / name).stat().st_mode & 0o777 == 0o644
