"""The patterns are the controller's, to the chip: what it drives its pin to, and what it refuses."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.controller import (
    BURST_PERIOD_MAX_TICKS,
    BURST_PERIOD_MIN_TICKS,
    BURST_REPEAT_MAX,
    CHIP_MAX_TICKS,
    CHIP_MIN_TICKS,
    CODES,
    MICROWAVE_DUTY_MAX_PERMILLE,
    MICROWAVE_PULSE_MAX_TICKS,
    MICROWAVE_PULSE_MIN_TICKS,
    PIN_INTERLOCK,
    PIN_MICROWAVE,
    PIN_TRIGGER,
    TRIGGER_TICKS,
)
from annulus_pipe.link import messages
from annulus_pipe.link.codec import Decoder, Frame, encode
from annulus_pipe.link.codes import Train, pattern, text
from annulus_pipe.link.messages import Arm, ArmFlag, Burst, BurstCode, BurstReply, Identify, Pattern, StatusCode
from annulus_pipe.twin.native import NativeBoard
from annulus_pipe.vocabulary import AnnulusError

NAMES = {c.name.lower().replace("_", "-"): c for c in BurstCode if c is not BurstCode.UPLOADED}


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


def test_stuffing_makes_every_pulse_one_chip_and_the_pair_is_sent_by_manchester() -> None:
    assert CODES["mpsl25-stuffed"] == "".join(chip + "0" for chip in CODES["mpsl25"])
    assert set(Train(pattern("mpsl25-stuffed"), 50).pulses_ticks[:, 1]) == {50}
    pair = ("00011000101101010110010000", "00001001101000001011100111")  # SC1, SC2
    for code, bits in zip(("manchester1", "manchester2"), pair, strict=True):
        assert CODES[code] == "".join("10" if bit == "1" else "01" for bit in bits)


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
    bad = [f.name for f in train.findings() if not f.ok]
    if not bad:
        return StatusCode.OK
    if bad[0] in ("repeat", "chip", "period", "trigger offset"):
        return StatusCode.OUT_OF_RANGE
    return StatusCode.PULSE_WIDTH if "pulse" in bad[0] else StatusCode.DUTY


def test_the_controller_refuses_what_the_findings_refuse_and_nothing_else() -> None:
    controller = Controller()
    seen: set[StatusCode] = set()

    def near(*edges: int) -> st.SearchStrategy[int]:
        return st.sampled_from(edges).flatmap(lambda edge: st.integers(max(edge - 2, 0), edge + 2))

    @settings(max_examples=120, deadline=None)
    @example(bits="1", chip=30, slack=0, duty_edge=True, offset=0, at_end="start")  # each answer, whatever is drawn
    @example(bits="1" * 40, chip=400, slack=0, duty_edge=True, offset=0, at_end="start")
    @example(bits="10" * 20, chip=30, slack=0, duty_edge=False, offset=0, at_end="start")
    @example(bits="1", chip=30, slack=-1, duty_edge=True, offset=-100_000, at_end="start")
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


LONG = "1" + 254 * "0"  # a pulse of one chip and a duty that no period breaks
PULSE, LONGEST = MICROWAVE_PULSE_MIN_TICKS, MICROWAVE_PULSE_MAX_TICKS
DUTIFUL = 50_000 // MICROWAVE_DUTY_MAX_PERMILLE  # the shortest period of one chip of 50 ticks
LIMITS = [  # what is refused first, the chips; chip, repeat, period, offset just allowed; and one step further
    ("chip", "1111", (CHIP_MIN_TICKS, 1, 100_000, 0), (CHIP_MIN_TICKS - 1, 1, 100_000, 0)),
    ("chip", "1", (CHIP_MAX_TICKS, 1, 100_000, 0), (CHIP_MAX_TICKS + 1, 1, 100_000, 0)),
    ("shortest pulse", "1", (PULSE, 1, 100_000, 0), (PULSE - 1, 1, 100_000, 0)),
    ("longest pulse", "1101", (LONGEST // 2, 1, 100_000, 0), (LONGEST // 2 + 1, 1, 100_000, 0)),
    ("period", LONG, (30, 1, 256 * 30, 0), (30, 1, 256 * 30 - 1, 0)),
    ("period", "1", (50, 1, BURST_PERIOD_MAX_TICKS, 0), (50, 1, BURST_PERIOD_MAX_TICKS + 1, 0)),
    ("period", "0", (50, 1, BURST_PERIOD_MIN_TICKS, 0), (50, 1, BURST_PERIOD_MIN_TICKS - 1, 0)),
    ("trigger offset", "1", (50, 1, 10_000, 10_000 - TRIGGER_TICKS), (50, 1, 10_000, 10_001 - TRIGGER_TICKS)),
    ("trigger offset", "1", (50, 1, 10_000, -9_950), (50, 1, 10_000, -9_951)),
    ("duty", "1", (50, 1, DUTIFUL, 0), (50, 1, DUTIFUL - 1, 0)),
    ("repeat", "1", (50, 1, 10_000, 0), (50, 0, 10_000, 0)),
    ("repeat", "1", (50, BURST_REPEAT_MAX, 10_000, 0), (50, BURST_REPEAT_MAX + 1, 10_000, 0)),
]


@pytest.mark.parametrize(("what", "bits", "allowed", "beyond"), LIMITS)
def test_command_line_host_and_controller_have_one_limit(
    what: str, bits: str, allowed: tuple[int, ...], beyond: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """At every limit, and one step past it: `annulus head burst`, the findings and the real core say the same."""
    controller = Controller()
    controller.upload(pattern(bits))
    sent: list[Burst] = []
    monkeypatch.setattr("annulus_pipe.link.operate.fire_burst", lambda port, own, burst: sent.append(burst) or {})
    for (chip, repeat, period, offset), ok in ((allowed, True), (beyond, False)):
        train = Train(pattern(bits), chip, repeat, period, offset)
        assert [f.name for f in train.findings() if not f.ok][:1] == ([] if ok else [what])
        options = {"chip": chip, "period": period, "trigger-offset": offset}
        line = [f"--{name}-us={ticks / 100!r}" for name, ticks in options.items()]
        said = CliRunner().invoke(app, ["head", "burst", "--port", "x", "--code", bits, f"--repeat={repeat}", *line])
        assert isinstance(said.exception, AnnulusError) is not ok and len(sent) == 1
        if repeat > BURST_REPEAT_MAX:
            with pytest.raises(AnnulusError, match="burst"):
                controller.fire(BurstCode.UPLOADED, train)
        else:
            assert (controller.fire(BurstCode.UPLOADED, train).status is StatusCode.OK) is ok
        controller.arm()
    assert sent == [Burst(BurstCode.UPLOADED, *allowed)]
