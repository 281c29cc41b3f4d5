"""Labels and pairs of two cameras on one sync line, in virtual time: firmware, link and labelling as the daemon has
them, each camera with a driver of its own that loses frames, stamps and hands over as it likes.
"""

from collections import Counter, deque
from typing import NamedTuple

import pytest

from annulus_pipe.capture.camera import BAYER_RGGB8
from annulus_pipe.daemon.flashes import Flashes, Gathered
from annulus_pipe.labelling.labelling import CameraMode, FrameSeen, Labelling
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.twin.driver import Delivered, Driver
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.image_sensor import Exposure
from annulus_pipe.twin.native import NativeBoard
from annulus_pipe.twin.soak_world import MS_TICKS, SoakWorld
from annulus_pipe.twin.truth import LabelVerdict
from annulus_pipe.vocabulary import Label

FRAMES = 1200
LATE_NS = 9_000_000  # the second camera's driver stamps so much later
BEHIND_FRAMES = 2  # and keeps so many frames more


class _Waiting(NamedTuple):
    seen: FrameSeen
    frame: Delivered


class _Both:
    """The driver of the first camera, as the soak knows one; the second sees the same exposures."""

    def __init__(self, world: "TwoCameras", first: Driver) -> None:
        self._world, self._first = world, first

    def take(self, exposure: Exposure) -> Delivered | None:
        delivered = self._world.second.take(exposure)
        if delivered is not None:
            self._world.second_on_the_way.append(delivered._replace(timestamp_ns=delivered.timestamp_ns + LATE_NS))
        return self._first.take(exposure)

    def __getattr__(self, name: str) -> object:
        return getattr(self._first, name)


class TwoCameras(SoakWorld):
    def __init__(self, seed: int, first: Faults, second: Faults) -> None:
        super().__init__(FRAMES, seed, first, NativeBoard(), frozenset())
        self.second = Driver(second, self.timing, seed, start_tick=MS_TICKS, camera=1)
        self.driver = _Both(self, self.driver)  # type: ignore[assignment]
        camera = self.world.camera
        mode = CameraMode(1, camera.width, camera.height, BAYER_RGGB8, round(self.timing.period_us * 1000))
        self.second_labelling = Labelling(mode, self.navigation, self._reported, False)
        self.second_on_the_way: deque[Delivered] = deque()
        self.second_waiting: deque[_Waiting] = deque()
        self.second_verdicts = Counter[LabelVerdict]()
        self.flashes: Flashes[int] = Flashes([0, 1], round(6 * self.timing.period_us * 1000))
        self.pairs: list[Gathered[int]] = []
        self.exposure_of: dict[tuple[int, int], int] = {}  # index, camera -> exposure
        self.late = 0

    def _host(self) -> None:
        super()._host()
        while self.second_on_the_way and self.second_on_the_way[0].due_tick <= self.tick:
            frame = self.second_on_the_way.popleft()
            arrived_ns = self.clock.ns(frame.due_tick)
            picture = self.pictures.measured(frame.parts)
            seen = FrameSeen(frame.sequence, frame.timestamp_ns, arrived_ns, picture, {})
            self.second_labelling.saw(seen)
            self.second_waiting.append(_Waiting(seen, frame))
        now = self._now
        self.second_labelling.look_for_offset(now / 1e9)
        crowded = not self.second_labelling.offset_known and len(self.second_waiting) >= 20
        while self.second_waiting and (crowded or self.second_labelling.settled(self.second_waiting[0].seen, now)):
            crowded = False
            one = self.second_waiting.popleft()
            header = self.second_labelling.header(one.seen)
            self.second_verdicts[self.truth.verdict(header, one.frame)] += 1
            self._gather(header, one.frame)
        self.pairs += self.flashes.ready(now)

    def _label(self, one: object) -> None:
        said = self.labelling.header
        headers: list[FrameHeader] = []

        def header(seen: FrameSeen) -> FrameHeader:
            headers.append(said(seen))
            return headers[-1]

        self.labelling.header = header  # type: ignore[method-assign]
        super()._label(one)  # type: ignore[arg-type]
        self.labelling.header = said  # type: ignore[method-assign]
        self._gather(headers[0], one.frame)  # type: ignore[attr-defined]

    def _gather(self, header: FrameHeader, frame: Delivered) -> None:
        if header.label is Label.PROJECTOR:
            self.late += self.flashes.take(header, int(frame.parts[0].exposure.sequence), self._now) is None
        self.flashes.passed(header)


@pytest.mark.parametrize("seed", [1, 2])
def test_no_pair_is_wrong_when_one_camera_loses_one_frame_in_ten(seed: int) -> None:
    second = Faults(frames_dropped=0.1, delivery_frames=float(BEHIND_FRAMES))
    world = TwoCameras(seed, Faults(frames_dropped=0.01), second)
    for number in range(FRAMES):
        world.frame(number)
    world.finish()
    world.pairs += world.flashes.ready(0, all_of_them=True)
    for verdicts in (world.verdicts, world.second_verdicts):
        assert verdicts[LabelVerdict.WRONG_LAMP] == verdicts[LabelVerdict.WRONG_PLACE] == 0
        assert verdicts[LabelVerdict.RIGHT] > 0.8 * FRAMES
    whole = [pair for pair in world.pairs if len(pair.frames) == 2]
    assert len(whole) > 500
    for pair in whole:
        (first, one), (second_header, other) = pair.frames.values()
        assert one == other, "both are of one exposure"
        assert (first.edge, first.z_mm) == (second_header.edge, second_header.z_mm)
    alone = Counter(next(iter(pair.frames)) for pair in world.pairs if len(pair.frames) == 1)
    lost = world.second.counts["dropped"]
    assert lost == pytest.approx(0.1 * FRAMES, rel=0.3)
    begun = [pair.since_ns for pair in whole]
    steady = [pair for pair in world.pairs if begun[20] < pair.since_ns <= begun[-1] and len(pair.frames) == 1]
    assert alone[0] > 0.5 * lost * 0.8 and len(steady) < 0.16 * len(world.pairs), "alone are those whose other was lost"
    world.board.close()
