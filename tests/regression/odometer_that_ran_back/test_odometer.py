"""An odometer that was reset, slipped back or counted the wrong way, and pictures that stood twice in a scan, left a
map with two places of the pipe on one, and nothing was said. Fails without `running_back_findings` and
`doubled_findings`."""

import numpy as np
import pytest

from annulus_pipe.reprocess.places import doubled_findings, running_back_findings
from annulus_pipe.rings.diagnosis import FrameLighting, diagnose
from annulus_pipe.scans.scan import ScanFrame
from annulus_pipe.vocabulary import Label


def frames(z_mm: list[float], segment: list[int] | None = None) -> list[ScanFrame]:
    segments = segment or [0] * len(z_mm)
    return [
        ScanFrame(i, Label.PROJECTOR, z, f"{i}.jpg", segment=s)
        for i, (z, s) in enumerate(zip(z_mm, segments, strict=True))
    ]


UP = [2.0 * i for i in range(30)]


@pytest.mark.parametrize(
    ("z_mm", "kind", "where"),
    [
        (UP + [2.0 * i for i in range(20)], "place_back", (30,)),  # reset
        ([*UP, 50.0, 48.0, 52.0, 60.0], "place_back", (30,)),  # slipped, 10 mm
        ([*UP, *[2.0 * i - 40.0 for i in range(20)]], "place_back", (30,)),  # begins anew below nought
        ([-z for z in UP], "place_backwards", (0, 29)),
        ([100.0 - z for z in UP] + [99.0], "place_backwards", (0, 30)),
    ],
)
def test_z_that_runs_back_is_reported(z_mm: list[float], kind: str, where: tuple[int, ...]) -> None:
    (one,) = [one for one in running_back_findings(frames(z_mm)) if one.kind == kind]
    assert one.frames == where and "\n" not in one.text


def test_a_rest_and_a_segment_that_begins_anew_are_none() -> None:
    rests = [*UP, *[58.0 + 1.2 * np.sin(i) for i in range(20)], *[60.0 + 2 * i for i in range(9)]]
    assert running_back_findings(frames(rests)) == []
    assert running_back_findings(frames([*UP, *UP], [0] * 30 + [1] * 30)) == []
    assert running_back_findings(frames([])) == running_back_findings(frames([np.nan, np.nan])) == []


def light(seed: int) -> FrameLighting:
    return diagnose(np.random.default_rng(seed).integers(0, 255, (96, 128, 3), np.uint8))


def test_one_picture_at_two_places_is_reported() -> None:
    seeds = [0, 0, 1, 2, 2, 2, 3]
    lights = [(i, light(seed)) for i, seed in enumerate(seeds)]
    (one,) = doubled_findings(frames(UP), lights)
    assert one.kind == "picture_doubled" and one.frames == (1, 4, 5)
    assert doubled_findings(frames([10.0] * 7), lights) == []  # a head at rest
    assert doubled_findings(frames(UP), [(i, light(i)) for i in range(7)]) == []
    dark = diagnose(np.zeros((96, 128, 3), np.uint8))  # nothing but darkness is like itself
    assert doubled_findings(frames(UP), [(0, dark), (1, dark)]) == []
