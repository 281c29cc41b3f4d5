"""Frames of one flash find each other, whatever was lost and whenever they come."""

from collections import Counter

import numpy as np
import pytest

from annulus_pipe.daemon.flashes import Flashes, Gathered
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import CameraSequence, EdgeIndex, Label, Slot

PERIOD_NS = 40_000_000
PATIENCE_NS = 6 * PERIOD_NS


def header(index: int, edge: int | None, camera: int, label: Label = Label.PROJECTOR, segment: int = 0) -> FrameHeader:
    number = None if edge is None else EdgeIndex(edge)
    return FrameHeader(
        index, CameraSequence(0), 0, label, "", number, Slot(0), 0, 0.0, "mono8", 4, 4, camera=camera, segment=segment
    )


def gathered(flashes: Flashes[str], now_ns: int) -> list[tuple[int, list[int]]]:
    return [(flash.index, list(flash.frames)) for flash in flashes.ready(now_ns)]


def test_with_one_camera_nothing_waits() -> None:
    flashes: Flashes[str] = Flashes([3], PATIENCE_NS)
    for i in range(5):
        assert flashes.take(header(i, i, 3), "", i) is True
        assert gathered(flashes, i) == [(i, [3])] and len(flashes) == 0


def test_a_flash_waits_for_the_other_camera_and_no_longer_than_it_can_come() -> None:
    flashes: Flashes[str] = Flashes([0, 1], PATIENCE_NS)
    assert flashes.take(header(0, 10, 0), "a", 0) is True
    assert gathered(flashes, PERIOD_NS) == []
    assert flashes.take(header(0, 10, 1), "b", PERIOD_NS) is False
    assert gathered(flashes, PERIOD_NS) == [(0, [0, 1])]
    flashes.take(header(1, 11, 0), "a", 0)
    flashes.passed(header(2, 12, 1, Label.LED))  # the second camera's frames are past it: it lost that one
    assert gathered(flashes, 1) == [(1, [0])]
    flashes.take(header(3, 13, 1), "b", 0)  # and now the first says nothing at all
    assert gathered(flashes, PATIENCE_NS) == []
    assert gathered(flashes, PATIENCE_NS + 1) == [(3, [1])]
    assert flashes.take(header(3, 13, 0), "a", 2 * PATIENCE_NS) is None, "too late: not measured twice"


def test_edges_from_before_a_restart_say_nothing_of_flashes_after_it() -> None:
    flashes: Flashes[str] = Flashes([0, 1], PATIENCE_NS)
    flashes.passed(header(0, 900, 1))
    flashes.take(header(1, 3, 0, segment=1), "a", 0)
    assert gathered(flashes, 1) == []
    flashes.take(header(1, 3, 1, segment=1), "b", 1)
    assert gathered(flashes, 1) == [(1, [0, 1])]


@pytest.mark.parametrize("seed", range(6))
def test_no_pair_is_wrong_and_no_frame_is_lost_however_frames_drop_and_lag(seed: int) -> None:
    """10 % of one camera's frames dropped, 3 % of the other's, each with a lag of its own, up to patience's."""
    rng = np.random.default_rng(seed)
    events: list[tuple[float, int, int]] = []
    for camera, loss in ((0, 0.03), (1, 0.10)):
        lag, at = rng.uniform(0.2, 2.0), 0.0
        for edge in range(1000):
            if rng.random() >= loss:
                at = max(at, edge + lag + rng.uniform(0.0, 0.9) + 3.0 * (rng.random() < 0.02))  # in order of capture
                events.append((at, camera, edge))
    events.sort()
    index: dict[int, int] = {}
    flashes: Flashes[tuple[int, int]] = Flashes([0, 1], PATIENCE_NS)
    out: list[Gathered[tuple[int, int]]] = []
    late = 0
    for at, camera, edge in events:
        now = round(at * PERIOD_NS)
        out += flashes.ready(now)
        one = header(index.setdefault(edge, len(index)), edge, camera, Label.LED if edge % 5 == 4 else Label.PROJECTOR)
        if one.label is Label.PROJECTOR:
            late += flashes.take(one, (edge, camera), now) is None
        flashes.passed(one)
        out += flashes.ready(now)
    out += flashes.ready(0, all_of_them=True)
    there: dict[int, set[int]] = {}
    for _, camera, edge in events:
        if edge % 5 != 4:
            there.setdefault(edge, set()).add(camera)
    assert Counter(flash.index for flash in out) == Counter(index[edge] for edge in there), "each flash once"
    for flash in out:
        edges = {edge for _, (edge, _) in flash.frames.values()}
        assert len(edges) == 1 and all(frame[1] == camera for camera, (_, frame) in flash.frames.items())
        assert set(flash.frames) == there[edges.pop()], "what came is together, whoever came first"
    assert late == 0
    alone = sum(len(flash.frames) == 1 for flash in out)
    assert 0.08 < alone / len(out) < 0.18
