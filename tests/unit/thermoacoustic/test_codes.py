"""The patterns are the controller's, to the chip: what it drives its pin to, and what it refuses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus.link import messages
from annulus.link.codec import Decoder, Frame, encode
from annulus.link.messages import Arm, ArmFlag, Burst, BurstCode, BurstReply, Identify, Pattern, StatusCode
from annulus.thermoacoustic.codes import CODES, Limits, Train, manchester, pattern, stuffed, text
from annulus.twin.native import _LIBRARY, PIN_INTERLOCK, PIN_MICROWAVE, PIN_TRIGGER, NativeBoard
from annulus.vocabulary import AnnulusError

LIMITS = Limits(
    (messages.CHIP_MIN_TICKS, messages.CHIP_MAX_TICKS),
    (messages.MICROWAVE_PULSE_MIN_NS // 10, messages.MICROWAVE_PULSE_MAX_NS // 10),
    messages.MICROWAVE_DUTY_MAX_PERMILLE,
    messages.TICK_HZ,
)
NAMES = {c.name.lower().replace("_", "-"): c for c in BurstCode if c is not BurstCode.UPLOADED}
native = pytest.mark.skipif(not _LIBRARY.is_file(), reason="native firmware not built")


class Controller:
    """The real core, armed."""

    def __init__(self) -> None:
        self.board = NativeBoard()
        self.board.power_on()
        self.board.input(1, PIN_INTERLOCK, 0)
        self.decoder = Decoder()
        self.sequence = 0
        self.ask(Identify(messages.PROTOCOL_VERSION, messages.SCHEMA_HASH))
        self.arm()

    def arm(self) -> None:
        self.ask(Arm(ArmFlag(0)))
        assert self.ask(Arm(ArmFlag.MICROWAVE)).status is StatusCode.OK

    def ask(self, command: messages.Command) -> messages.Reply:
        self.sequence = (self.sequence + 1) % 256
        self.board.serial_write(encode(Frame(command, self.sequence)))
        for _ in range(40):
            self.board.run_until(self.board.tick + 50_000)
            for item in self.decoder.feed(self.board.serial_read()):
                if isinstance(item, Frame) and isinstance(item.message, command.REPLY):
                    return item.message
        raise AssertionError(f"no answer to {command}")

    def fire(self, code: BurstCode, train: Train) -> BurstReply:
        self.board.pins()
        command = Burst(code, train.chip_ticks, train.repeat, train.period_ticks, train.trigger_offset_ticks)
        reply = self.ask(command)
        assert isinstance(reply, BurstReply)
        return reply

    def upload(self, chips: np.ndarray) -> None:
        packed = np.packbits(chips, bitorder="little").tobytes().ljust(32, b"\0")
        assert self.ask(Pattern(len(chips), packed)).status is StatusCode.OK


@native
@pytest.mark.parametrize("code", list(CODES))
def test_the_controllers_pin_shows_the_pattern_edge_by_edge(code: str) -> None:
    controller = Controller()
    train = Train(pattern(code), 50, repeat=2, period_ticks=40_000, trigger_offset_ticks=-30)
    reply = controller.fire(NAMES[code], train)
    assert (reply.status, reply.length) == (StatusCode.OK, len(train.chips))
    controller.board.run_until(controller.board.tick + 300_000)
    pins = controller.board.pins()
    gate = [(int(p["tick"]), int(p["level"])) for p in pins if p["pin"] == PIN_MICROWAVE]
    chip0 = reply.start + controller.board.boot_tick
    assert gate == [(chip0 + n * 40_000 + at, level) for n in range(2) for at, level in train.edges_ticks()]
    trigger = [int(p["tick"]) for p in pins if p["pin"] == PIN_TRIGGER and p["level"]]
    assert trigger == [chip0 - 30, chip0 + 40_000 - 30]


def test_every_code_the_wire_knows_has_its_pattern() -> None:
    assert set(NAMES) == set(CODES)


@pytest.mark.parametrize(
    "code, chips, ones",
    [
        ("single", 1, 1),
        ("mpsl25", 25, 11),
        ("mpsl25-stuffed", 50, 11),
        ("barker13", 13, 9),
        ("manchester1", 52, 26),
        ("manchester2", 52, 26),
    ],
)
def test_lengths_and_ones_are_the_sources(code: str, chips: int, ones: int) -> None:
    assert (len(pattern(code)), int(pattern(code).sum())) == (chips, ones)


def test_mpsl25_against_its_bipolar_template_has_the_peak_of_eleven() -> None:
    sent = pattern("mpsl25").astype(int)
    correlation = np.correlate(sent, 2 * sent - 1, "full")
    assert correlation[24] == 11
    assert np.delete(correlation, 24).max() < 11


def test_the_complementary_pair_adds_up_to_one_peak() -> None:
    total = sum(
        np.correlate(pattern(code).astype(int), 2 * pattern(code).astype(int) - 1, "full")
        for code in ("manchester1", "manchester2")
    )
    assert total[51] == 52
    assert sorted((int(total[50]), int(total[52]))) == [-26, -25]
    assert np.abs(np.delete(total, [50, 51, 52])).max() <= 1


def test_stuffing_makes_every_pulse_one_chip_and_manchester_keeps_half_of_them_on() -> None:
    assert set(Train(pattern("mpsl25-stuffed"), 50).pulses_ticks[:, 1]) == {50}
    assert manchester("01") == "0110" and stuffed("10") == "1000"


@given(st.text("01", min_size=1, max_size=256))
def test_any_text_of_0_and_1_is_a_pattern(bits: str) -> None:
    chips = pattern(bits)
    assert text(chips) == bits
    train = Train(chips, 7)
    drawn = np.zeros(len(bits) * 7, np.uint8)
    for start, size in train.pulses_ticks:
        drawn[start : start + size] = 1
    assert (drawn == np.repeat(chips, 7)).all()
    assert train.duty * train.period_ticks == pytest.approx(7 * bits.count("1"))


@pytest.mark.parametrize("code", ["", "mpsl", "102", "0" * 257, "1 0"])
def test_anything_else_is_refused(code: str) -> None:
    with pytest.raises(AnnulusError):
        pattern(code)


def expected(train: Train) -> StatusCode:
    """What the findings say the controller answers: it looks at them in order."""
    bad = [f.name for f in train.findings(LIMITS) if not f.ok]
    if not bad:
        return StatusCode.OK
    if bad[0] in ("chip", "period", "trigger offset"):
        return StatusCode.OUT_OF_RANGE
    return StatusCode.PULSE_WIDTH if "pulse" in bad[0] else StatusCode.DUTY


@native
def test_the_controller_refuses_what_the_findings_refuse_and_nothing_else() -> None:
    controller = Controller()
    seen: set[StatusCode] = set()

    def near(*edges: int) -> st.SearchStrategy[int]:
        return st.sampled_from(edges).flatmap(lambda edge: st.integers(max(edge - 2, 0), edge + 2))

    @settings(max_examples=120, deadline=None)
    @given(
        bits=st.text("01", min_size=1, max_size=40),
        chip=near(10, 15, 30, 1500, 3000) | st.integers(8, 400),
        slack=st.integers(-1, 3) | st.integers(0, 100_000),
        duty_edge=st.booleans(),
        offset=st.integers(-3, 3) | st.integers(-100_000, 100_000),
        at_end=st.sampled_from(["start", "gap", "end"]),
    )
    def check(bits: str, chip: int, slack: int, duty_edge: bool, offset: int, at_end: str) -> None:
        chips = pattern(bits)
        period = max(20 * int(chips.sum()) * chip if duty_edge else 0, (len(chips) + 1) * chip) + slack
        origin = {"start": 0, "gap": -(period - len(chips) * chip), "end": period - 100}[at_end]
        train = Train(chips, chip, 1, period, origin + offset)
        controller.upload(chips)
        status = controller.fire(BurstCode.UPLOADED, train).status
        assert status is expected(train), train
        seen.add(status)
        if status is StatusCode.OK:
            controller.board.run_until(controller.board.tick + 3 * period + 100_000)
            controller.arm()

    check()
    assert seen == {StatusCode.OK, StatusCode.OUT_OF_RANGE, StatusCode.PULSE_WIDTH, StatusCode.DUTY}
