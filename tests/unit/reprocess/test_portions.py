"""What goes to the worker of one window of a long scan, and how many windows there are at a time."""

import pickle
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from annulus_pipe.geometry.drift import Drift
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.reprocess import whole
from annulus_pipe.reprocess.cluster import Dask, packed
from annulus_pipe.reprocess.executors import Processes
from annulus_pipe.reprocess.ranges import Facts
from annulus_pipe.reprocess.whole import Filed
from annulus_pipe.reprocess.windows import Portion, Portions, WindowWork
from annulus_pipe.rings.diagnosis import FrameLighting
from annulus_pipe.scans.scan import Scan, ScanFrame
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.vocabulary import Label
from annulus_pipe.wall.scale import AbsoluteScale
from annulus_pipe.wall.windows import Window, WindowPlan

OF = 100  # frames of a range, and of a window, whose halo has 20 of each neighbour
PORTION_MOST = 60_000  # bytes; about 24 000


class Known:
    """Profiles, or files, of known origin."""

    def made_from(self) -> tuple[str, ...]:
        return ("known",)


def portions(ranges: int) -> Portions:
    count = OF * ranges
    frames = tuple(ScanFrame(i, Label.PROJECTOR, 2.5 * i, f"rings-{i}.jpg") for i in range(count))
    facts = tuple(
        Facts(
            n,
            f"ranges/{n:06d}.parquet",
            OF * n,
            OF * n + OF - 1,
            tuple((i, FrameLighting(200.0, 0.0, 0.0, 0.35)) for i in range(OF * n, OF * n + OF)),
            (),
            (),
            (),
            (),
            OF,
            1000,
            {},
            (0.0, 1.0),
            {},
            True,
            "a processor",
            (),
        )
        for n in range(ranges)
    )
    windows = tuple(
        Window(250.0 * n, 250.0 * (n + 1), tuple(range(max(0, OF * n - 20), min(count, OF * (n + 1) + 20))))
        for n in range(ranges)
    )
    filed = Filed(StoragePath("season"), facts, tuple(range(0, count, OF)))
    return Portions(Scan(Path("scan"), frames, None, None), filed, WindowPlan(windows, 2.0, 2.0))


def test_what_a_window_is_sent_does_not_grow_with_its_scan() -> None:
    short, long = portions(4), portions(200)
    assert [frame.index for frame in long[2].part.frames] == list(range(180, 320))
    assert [facts.number for facts in long[2].profiles.facts] == [1, 2, 3]
    assert long[2].profiles.frame(185) == long[2].profiles.facts[0].frames[85] == 185
    assert len(packed(long[2])) == len(packed(short[2])) < PORTION_MOST
    assert pickle.loads(packed(long[2])) == long[2]


def test_a_window_is_kept_for_the_scale_of_its_scan_and_no_other() -> None:
    """Which frames beyond the window say: the same frames with another scale are other results."""
    portion = Portion(0, Window(0.0, 1.0, ()), Scan(Path("scan"), (), None, None), Known())
    job = SimpleNamespace(calibration=None, colour=None, reference=None, sections=())
    drifts = [None, Drift(), Drift(focal=0.001), Drift(focal=0.001)]
    scales = [
        one and AbsoluteScale(np.zeros(1), (one,), np.eye(7), np.ones(7), np.ones((2, 7)), 0.1, 1.0) for one in drifts
    ]
    made = [WindowWork(job, 2.0, 2.0, Known(), scale=one)._made_from(portion) for one in scales]  # type: ignore[arg-type]
    assert made[2] == made[3] and len(set(made)) == 3


def test_what_is_packed_comes_out_as_it_went_in() -> None:
    for value in (
        Pose(0.1, -0.2, 3.0, 4.0, None),
        FrameLighting(1.0, 0.5, float("inf"), 0.35),
        StoragePath("s3://bucket/x"),
        Processes(3),
    ):
        assert pickle.loads(packed(value)) == value and type(pickle.loads(packed(value))) is type(value)


@pytest.mark.parametrize(
    ("free_mb", "cores", "workers", "at_once"),
    [
        (64_000.0, 32, None, 2),
        (64_000.0, 1, None, 1),
        (64_000.0, 2, 5, 5),
        (2100.0, 8, None, 2),
        (1700.0, 8, None, 1),
        (900.0, 8, 8, 1),
        (100.0, 8, 8, 1),
    ],
)
def test_so_many_windows_at_a_time_as_there_is_room_for_and_two_where_nobody_asks_for_more(
    monkeypatch: pytest.MonkeyPatch, free_mb: float, cores: int, workers: int | None, at_once: int
) -> None:
    """22 at a time of a scan of 25 m, where a machine has the memory, were eleven times what is promised."""
    monkeypatch.setattr(whole, "_free_mb", lambda: free_mb)
    monkeypatch.setattr("os.cpu_count", lambda: cores)
    assert whole._fewer(Processes(workers)) == Processes(at_once, apart=True)
    dask = Dask("tcp://127.0.0.1:8786")
    assert whole._fewer(dask) is dask
