"""Promises of a cluster's address: nothing is said in the clear to another machine, and what is wrong is one line."""

from pathlib import Path

import pytest

from annulus_pipe.cli.reprocess import folders
from annulus_pipe.reprocess.cluster import Dask, Tls
from annulus_pipe.reprocess.executors import in_process
from annulus_pipe.reprocess.versions import differing, measured_with
from annulus_pipe.vocabulary import AnnulusError

FILES = Tls(Path("ca.pem"), Path("cert.pem"), Path("key.pem"))


@pytest.mark.parametrize(
    "url", ["tcp://10.0.0.3:8786", "tcp://0.0.0.0:8786", "tcp://head.example:8786", "tcp://[::]:1"]
)
def test_anything_but_loopback_wants_tls(url: str) -> None:
    with pytest.raises(AnnulusError, match="not loopback, and not encrypted"):
        Dask(url)
    with pytest.raises(AnnulusError):
        Dask(url, FILES)


@pytest.mark.parametrize(
    "url", ["", "10.0.0.3", "http://127.0.0.1:8786", "tcp://127.0.0.1", "tcp://127.0.0.1:99999999"]
)
def test_what_is_no_address_is_one_line(url: str) -> None:
    with pytest.raises(AnnulusError, match="no address of a scheduler"):
        Dask(url)


def test_files_of_tls_go_with_tls() -> None:
    Dask("tcp://127.0.0.1:8786"), Dask("tcp://localhost:8786"), Dask("tcp://[::1]:8786")
    with pytest.raises(AnnulusError, match="go with tls://"):
        Dask("tls://head.example:8786")
    with pytest.raises(AnnulusError, match="go with tls://"):
        Dask("tcp://127.0.0.1:8786", FILES)
    with pytest.raises(AnnulusError, match=r"ca\.pem: cannot be read"):
        Dask("tls://head.example:8786", FILES).security()


def test_a_difference_is_told_by_name() -> None:
    mine = dict(measured_with())
    assert differing(mine, mine) == "" and {"annulus", "numpy", "cv2", "loops"} <= mine.keys()
    assert differing(mine, {**mine, "numpy": "1.0"}) == f"numpy 1.0 for {mine['numpy']}"


def test_every_scan_has_a_folder_of_its_own() -> None:
    named = folders(["a/one.mcap", "s3://season/two.mcap", "three/", "a/one.mcap"])
    assert list(named.values()) == ["one", "two", "three"]
    with pytest.raises(AnnulusError, match="both would be one"):
        folders(["a/one.mcap", "b/one.mcap"])
    assert folders(["."]) == {".": Path.cwd().name}


def test_nothing_to_do_is_done() -> None:
    class Never:
        def ready(self):
            return lambda item: pytest.fail("asked for nothing")

    assert list(in_process(Never(), ())) == []
