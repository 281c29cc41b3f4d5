"""Promises about labels and the camera's offset, in virtual time: a clockwork of edges and frames, ratio 4."""

from dataclasses import replace

import pytest

from annulus.capture.photometry import Light
from annulus.capture.timing import FrameTiming
from annulus.daemon.config import CameraConfig, HeadConfig, LampConfig
from annulus.daemon.labelling import GIVE_UP_S, NO_CONTROLLER, NOT_KNOWN, OFFSET_FRAMES, FrameSeen, Labelling
from annulus.link.head import EdgeSeen
from annulus.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Label, Lamp, Slot, Tick

PERIOD = 40_000_000
CONFIG = HeadConfig(
    CameraConfig(), FrameTiming(25.0, 38_000.0, 28_000.0), LampConfig(), "port", 0.05, None, None, None, None, None
)


class Clockwork:
    """Edge k falls at k periods; frame k ends there and was lit by the flash after edge k-1."""

    def __init__(self, offset_ns: int, config: HeadConfig = CONFIG) -> None:
        self.offset_ns, self.told = offset_ns, []
        self.labelling = Labelling(config, 64, 48, "mono8", lambda kind, text: self.told.append((kind, text)))

    def lamp(self, edge: int) -> Lamp:
        return Lamp.LED if edge % 5 == 4 else Lamp.PROJECTOR

    def frame(self, k: int) -> FrameSeen:
        """Let edge k and its frame happen."""
        flash = Flash(EdgeIndex(k), Tick(0), Slot(k % 5), self.lamp(k), 1, 1, 20 * k, 1, 7, EdgeFlag(0))
        self.labelling.hear(EdgeSeen(flash, k * PERIOD, 1000, 1))
        light = Light.LED if self.lamp(k - 1) is Lamp.LED else Light.PROJECTOR
        seen = FrameSeen(k, CameraSequence(k), k * PERIOD + self.offset_ns, light, {})
        self.labelling.saw(seen)
        self.labelling.look_for_offset(k * PERIOD / 1e9)
        return seen


@pytest.mark.parametrize("offset_ms", [-28, 0, 3, 39, -65])
def test_the_offset_is_found_whichever_end_of_the_exposure_the_driver_stamps(offset_ms: int) -> None:
    clock = Clockwork(offset_ms * 1_000_000)
    frames = [clock.frame(k) for k in range(1, 60)]
    assert clock.labelling.numbers()["offset_ns"] == pytest.approx(offset_ms * 1e6, abs=1e5)
    headers = [clock.labelling.header(frame) for frame in frames]
    right = {Lamp.LED: Label.LED, Lamp.PROJECTOR: Label.PROJECTOR}
    assert all(header.label in (Label.UNKNOWN, right[clock.lamp(header.index - 1)]) for header in headers)
    known = [header for header in headers if header.label is not Label.UNKNOWN]
    assert len(known) >= 55
    assert all(h.edge == h.index - 1 and h.slot == (h.index - 1) % 5 for h in known)
    assert [h.z_mm for h in known] == pytest.approx([h.index - 1.0 for h in known])


def test_before_the_offset_is_known_frames_are_not_settled_and_unknown() -> None:
    clock = Clockwork(0)
    for k in range(1, OFFSET_FRAMES):
        frame = clock.frame(k)
        assert not clock.labelling.settled(frame, k * PERIOD)
        assert clock.labelling.header(frame).reason == NOT_KNOWN
    assert not clock.labelling.offset_known and clock.told == []


def test_pictures_that_fit_no_flash_give_no_label_and_the_operator_is_told() -> None:
    clock = Clockwork(0)
    for k in range(1, round(2.5 * GIVE_UP_S * 25)):
        frame = clock.frame(k)
        clock.labelling.saw(replace(frame, light=Light.LED if k % 3 else Light.PROJECTOR))
        clock.labelling._seen.pop(), clock.labelling._seen.pop()
        clock.labelling.saw(replace(frame, light=Light.LED if k % 3 else Light.PROJECTOR))
        assert clock.labelling.header(frame).label is Label.UNKNOWN
    assert [kind for kind, _ in clock.told] == ["offset", "offset"]
    assert all("frames stay unknown" in text for _, text in clock.told)


def test_a_camera_that_changes_its_mind_is_unknown_until_its_new_offset_is_found() -> None:
    clock = Clockwork(-28_000_000)
    right = {Lamp.LED: Label.LED, Lamp.PROJECTOR: Label.PROJECTOR}
    last, waiting = [], []
    for k in range(1, 400):
        if k == 150:
            clock.offset_ns = 12_000_000  # one whole frame later: only pictures can tell
        waiting.append(clock.frame(k))
        while waiting and clock.labelling.settled(waiting[0], k * PERIOD):
            header = clock.labelling.header(waiting.pop(0))
            assert header.label in (Label.UNKNOWN, right[clock.lamp(header.index - 1)]), header
            last.append(header.label)
    assert any("doubtful" in text for _, text in clock.told)
    assert Label.UNKNOWN not in last[-100:]


def test_without_a_controller_labels_are_those_the_frames_bring() -> None:
    labelling = Labelling(replace(CONFIG, port=None), 64, 48, "mono8", lambda *_: None)
    led = FrameSeen(0, None, 5, Light.DARK, {"Light": "led", "ZMm": 3})
    assert labelling.settled(led, 0)
    assert (labelling.header(led).label, labelling.header(led).z_mm) == (Label.LED, 3.0)
    for metadata in ({}, {"Light": "led"}, {"Light": "both", "ZMm": 1.0}, {"Light": "led", "ZMm": "far"}):
        header = labelling.header(replace(led, metadata=metadata))
        assert (header.label, header.reason) == (Label.UNKNOWN, NO_CONTROLLER)
