"""A promise for long scans: what a frame needs while it is labelled and told of is given back."""

import gc
import tracemalloc
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import pytest
from faulty_head import Head

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.daemon.evidence import Evidence
from annulus_pipe.job import JobSheet

KEPT_MAX = 40_000  # bytes, of which 20 000 come and go; a header kept of each of 1600 would be 500 000, a number 53 000


class Scan:
    """As much of a session as labels, evidence and numbers need; two cameras, and every fault of the line."""

    def __init__(self) -> None:
        self.head, self.account, self.notes = Head(seed=5), Account(), 0
        self.head.begin()
        config = cast(HeadConfig, SimpleNamespace(cameras=(), job=JobSheet()))
        self.evidence = Evidence(self._note, self.head.navigation, self.account, config, (), None)

    def _note(self, topic: str, body: Mapping[str, Any]) -> None:
        self.notes += 1

    def run(self, first: int, last: int) -> None:
        for k in range(first, last):
            self.head.run(k, k + 1)
            for header in self.head.headers:
                self.account.label(header)
            self.head.headers.clear()
            self.evidence.turn(k * 0.04)
            if k % 25 == 0:
                assert self.account.numbers() and [one.numbers() for one in self.head.labellings]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("warm", "frames"), [(1500, 1_000), (2_000, 3_000)])  # of each of two cameras
def test_what_a_frame_leaves_behind_is_nothing(warm: int, frames: int) -> None:
    tracemalloc.start()
    try:
        scan = Scan()
        scan.run(0, warm)
        before = _kept()
        scan.run(warm, warm + frames)
        grown = _kept() - before
    finally:
        tracemalloc.stop()
    assert scan.notes > frames / 25 and scan.account.frames.total() > frames
    assert grown < KEPT_MAX


def _kept() -> int:
    gc.collect()
    return tracemalloc.get_traced_memory()[0]
