"""Promises about labels and the camera's offset, in virtual time: a clockwork of edges and frames, ratio 4."""

import random
from dataclasses import replace

import pytest

from annulus_pipe.capture.photometry import Light, Photometry
from annulus_pipe.labelling.labelling import (
    NO_CONTROLLER,
    NOT_KNOWN,
    OFFSET_FRAMES,
    UNLABELLED_S,
    CameraMode,
    FrameSeen,
    Labelling,
)
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.link.head import EdgeSeen
from annulus_pipe.sensors.roll import NEAR_NS
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Label, Lamp, Slot, Tick

PERIOD = 40_000_000
MODE = CameraMode(0, 64, 48, "mono8", PERIOD)


def picture(light: Light) -> Photometry:
    """What a picture of this light measures."""
    peak, spread = {Light.DARK: (5.0, 0.0), Light.LED: (180.0, 0.001), Light.PROJECTOR: (250.0, 0.38)}[light]
    return Photometry(peak, 0.4, spread)


class Clockwork:
    """Edge k falls at k periods; frame k ends there and was lit by the flash after edge k-1."""

    def __init__(self, offset_ns: int) -> None:
        self.offset_ns, self.told = offset_ns, []
        self.preamble = range(0)  # its edges: of an order that does not repeat
        self.kept = 0  # frames that the driver holds: it hands over, counts and stamps an older picture
        self.navigation = Navigation(0.05)
        self.labelling = Labelling(MODE, self.navigation, lambda kind, text: self.told.append((kind, text)), False)

    def lamp(self, edge: int) -> Lamp:
        if edge in self.preamble:
            return random.Random(edge).choice([Lamp.PROJECTOR, Lamp.LED])
        return Lamp.LED if edge % 5 == 4 else Lamp.PROJECTOR

    def frame(self, k: int, delay: int = 1, width: int = 1) -> FrameSeen:
        """Let edge k and its frame happen."""
        flags = EdgeFlag.PREAMBLE if k in self.preamble else EdgeFlag(0)
        flash = Flash(EdgeIndex(k), Tick(0), Slot(k % 5), self.lamp(k), delay, width, 20 * k, 1, 7, flags)
        self.navigation.heard(EdgeSeen(flash, k * PERIOD, 1000, 1))
        light = Light.LED if self.lamp(k - 1 - self.kept) is Lamp.LED else Light.PROJECTOR
        seen = FrameSeen(CameraSequence(k), k * PERIOD + self.offset_ns, k * PERIOD, picture(light), {})
        self.labelling.saw(seen)
        self.labelling.look_for_offset(k * PERIOD / 1e9)
        return seen


@pytest.mark.parametrize("offset_ms", [-28, 0, 3, 39, -65])
def test_the_offset_is_found_whichever_end_of_the_exposure_the_driver_stamps(offset_ms: int) -> None:
    clock = Clockwork(offset_ms * 1_000_000)
    frames = [clock.frame(k) for k in range(1, 60)]
    assert clock.labelling.numbers()["offset_ns"] == pytest.approx(offset_ms * 1e6, abs=1e3)
    headers = [clock.labelling.header(frame) for frame in frames]
    right = {Lamp.LED: Label.LED, Lamp.PROJECTOR: Label.PROJECTOR}
    assert all(header.label in (Label.UNKNOWN, right[clock.lamp((header.sequence or 0) - 1)]) for header in headers)
    known = [header for header in headers if header.label is not Label.UNKNOWN]
    assert len(known) >= 55
    assert all(h.edge == h.sequence - 1 and h.slot == (h.sequence - 1) % 5 for h in known)
    assert [h.z_mm for h in known] == pytest.approx([h.sequence - 1.0 for h in known])


def test_before_the_offset_is_known_frames_are_not_settled_and_unknown() -> None:
    clock = Clockwork(0)
    for k in range(1, OFFSET_FRAMES):
        frame = clock.frame(k)
        assert not clock.labelling.settled(frame, k * PERIOD)
        assert clock.labelling.header(frame).reason == NOT_KNOWN
    assert not clock.labelling.offset_known and clock.told == []


def test_pictures_that_fit_no_flash_give_no_label_and_the_operator_is_told() -> None:
    clock = Clockwork(0)
    for k in range(1, round(2.5 * UNLABELLED_S * 25)):
        frame = clock.frame(k)
        clock.labelling.saw(replace(frame, picture=picture(Light.LED if k % 3 else Light.PROJECTOR)))
        clock.labelling._seen.pop(), clock.labelling._seen.pop()
        clock.labelling.saw(replace(frame, picture=picture(Light.LED if k % 3 else Light.PROJECTOR)))
        assert clock.labelling.header(frame).label is Label.UNKNOWN
    assert [kind for kind, _ in clock.told] == ["unlabelled", "unlabelled"]
    assert all("had a label for 30 s: camera offset: " in text for _, text in clock.told)


def test_a_camera_that_changes_its_mind_is_unknown_until_its_new_offset_is_found() -> None:
    clock = Clockwork(-28_000_000)
    right = {Lamp.LED: Label.LED, Lamp.PROJECTOR: Label.PROJECTOR}
    last, waiting = [], []
    for k in range(1, 400):
        if k == 150:
            clock.offset_ns = 12_000_000  # one whole frame later
        waiting.append(clock.frame(k))
        while waiting and clock.labelling.settled(waiting[0], k * PERIOD):
            header = clock.labelling.header(waiting.pop(0))
            assert header.label in (Label.UNKNOWN, right[clock.lamp((header.sequence or 0) - 1)]), header
            last.append(header.label)
    assert any("now doubted" in text for _, text in clock.told)
    assert Label.UNKNOWN not in last[-100:]


def test_a_camera_that_began_anew_is_unknown_until_a_preamble_since_then_proves_its_offset() -> None:
    """Its stamps and pictures are a lamp cycle later from then on, which no run of frames of the cycle contradicts."""
    clock, began = Clockwork(-28_000_000), 150
    before = [clock.frame(k) for k in range(1, began)]
    labelled = [clock.labelling.header(frame) for frame in before[:-1]]
    assert Label.UNKNOWN not in [header.label for header in labelled[-100:]]
    clock.labelling.restarted()
    clock.kept, clock.preamble = 5, range(began + 50, began + 65)
    for k in range(began, began + 50):
        frame = clock.frame(k)
        assert clock.labelling.wants_preamble and not clock.labelling.settled(frame, k * PERIOD)
        assert clock.labelling.header(frame).reason == NOT_KNOWN
    after = [clock.labelling.header(clock.frame(k)) for k in range(began + 50, began + 150)][-50:]
    assert {header.edge - header.sequence for header in after if header.edge is not None} == {-6}
    assert Label.UNKNOWN not in [header.label for header in after]
    assert clock.labelling.numbers()["contradictions"] == {}
    assert clock.labelling.header(before[-1]).reason == NOT_KNOWN  # what came before is none of this proof's


def test_without_a_controller_labels_are_those_the_frames_bring() -> None:
    labelling = Labelling(MODE, Navigation(0.05), lambda *_: None, True)
    led = FrameSeen(None, 5, 6, picture(Light.DARK), {"Light": "led", "ZMm": 3})
    assert labelling.settled(led, 0)
    assert (labelling.header(led).label, labelling.header(led).z_mm) == (Label.LED, 3.0)
    for metadata in ({}, {"Light": "led"}, {"Light": "both", "ZMm": 1.0}, {"Light": "led", "ZMm": "far"}):
        header = labelling.header(replace(led, metadata=metadata))
        assert (header.label, header.reason) == (Label.UNKNOWN, NO_CONTROLLER)


def roll_truth(at_ns: int) -> float:
    """A head that turns over once in 4 s: through 359 -> 1 every time."""
    return 90.0 * at_ns / 1e9


def test_a_frame_has_the_roll_of_the_middle_of_its_flash_while_the_sensor_speaks() -> None:
    """The sensor is silent from 4 s to 6 s of 10, samples come 12 ms late and 100 times a second, 0..360 degrees."""
    clock, late_ns, delay, width = Clockwork(-28_000_000), 12_000_000, 300_000, 500_000  # ticks of 10 ns
    samples = [t for t in range(0, 10_200_000_000, 10_000_000) if not 4_000_000_000 <= t < 6_000_000_000]
    waiting, rolls = [], {}
    for k in range(1, 250):
        now = k * PERIOD
        while samples and samples[0] + late_ns <= now:
            at = samples.pop(0)
            sample = Sample("imu", at, {"roll_deg": roll_truth(at) % 360.0}, {"roll_deg": "deg"})
            clock.navigation.sampled(sample)
        waiting.append(clock.frame(k, delay, width))
        while waiting and clock.labelling.settled(waiting[0], now):
            header = clock.labelling.header(waiting.pop(0))
            if header.label is not Label.UNKNOWN:
                rolls[(header.sequence or 0) - 1] = header.roll_deg  # by the edge whose flash lit it
    assert len(rolls) > 230
    for edge, roll in rolls.items():
        lit_ns = edge * PERIOD + (delay + width // 2) * 10
        if 4_000_000_000 + NEAR_NS < lit_ns < 6_000_000_000 - NEAR_NS:
            assert roll is None, "nothing is made up"
        elif not 3_980_000_000 < lit_ns < 6_000_000_000:
            assert roll is not None
            assert abs((roll - roll_truth(lit_ns) + 180.0) % 360.0 - 180.0) < 0.01


def test_two_cameras_label_from_the_same_edges_each_with_its_own_offset_and_size() -> None:
    """The second stamps the other end of the exposure and misses every seventh frame."""
    clock = Clockwork(-28_000_000)
    mode = CameraMode(1, 32, 20, "bgr8", PERIOD)
    other = Labelling(mode, clock.navigation, lambda *_: None, False)
    headers: list[FrameHeader] = []
    for k in range(1, 120):
        first = clock.frame(k)
        second = replace(first, timestamp_ns=k * PERIOD + 3_000_000, sequence=CameraSequence(1000 + k))
        if k % 7:
            other.saw(second)
        other.look_for_offset(k * PERIOD / 1e9)
        if k > 40:
            headers.append(clock.labelling.header(first))
            if k % 7:
                headers.append(other.header(second))
    assert {(h.camera, h.width, h.height, h.encoding) for h in headers} == {(0, 64, 48, "mono8"), (1, 32, 20, "bgr8")}
    right = {Lamp.LED: Label.LED, Lamp.PROJECTOR: Label.PROJECTOR}
    assert all(h.label is right[clock.lamp(h.edge)] for h in headers if h.edge is not None)
    assert sum(h.label is Label.UNKNOWN for h in headers) == 0
    by_edge: dict[int | None, set[int]] = {}
    for h in headers:
        by_edge.setdefault(h.edge, set()).add(h.index)
    assert all(len(indices) == 1 for indices in by_edge.values()), "frames of one flash share an index"
    assert len({(h.camera, h.index) for h in headers}) == len(headers)
