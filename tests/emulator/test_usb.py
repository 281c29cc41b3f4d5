"""Promises of the image's USB port, seen from a host that enumerates it as Linux does."""

import random
import struct
from pathlib import Path

import pytest
from emulated import BOOTED, MS, EmulatedBoard, configuration

from annulus_pipe.controller import PIN_LED, PIN_MICROWAVE, PIN_PROJECTOR, PIN_SYNC, TICK_S
from annulus_pipe.link.codec import Frame, encode
from annulus_pipe.link.messages import (
    SCHEMA_HASH,
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstReply,
    Clear,
    Commit,
    Edge,
    Fault,
    FaultCode,
    Identify,
    Pattern,
    PatternReply,
    Ping,
    PingReply,
    Reread,
    Reset,
    Status,
    StatusCode,
    StatusReply,
)

LATENCY = 9
OUTPUTS = (PIN_PROJECTOR, PIN_LED, PIN_MICROWAVE)
RATE_TO, RATE_FROM = 130_000, 200_000  # bytes a second; 156 000 and 232 000 are measured


def arm(board: EmulatedBoard, outputs: ArmFlag = ArmFlag.LAMPS, **changes: int) -> None:
    board.identify()
    for command in (configuration(**changes), Commit(generation=changes.get("generation", 1)), Arm(outputs=outputs)):
        assert board.request(command).status == StatusCode.OK


def setup(kind: int, request: int, value: int = 0, index: int = 0, length: int = 0) -> bytes:
    return struct.pack("<BBHHH", kind, request, value, index, length)


# ---- descriptors ----


def test_it_enumerates_and_its_descriptors_are_those_of_a_cdc_acm_port(board: EmulatedBoard) -> None:
    board.plug_in()
    found = board.usb["found"]
    fields = "length kind usb cls subcls protocol packet vendor product release maker name serial configurations"
    device = dict(zip(fields.split(), struct.unpack("<BBHBBBBHHHBBBB", bytes(found["device"])), strict=True))
    assert (device["length"], device["kind"], device["usb"]) == (18, 1, 0x0200)
    assert (device["cls"], device["subcls"], device["protocol"]) == (0xEF, 2, 1)  # as an association asks for
    assert device["packet"] == 64
    assert (device["vendor"], device["product"]) == (0x2E8A, 0x000A)
    assert device["configurations"] == 1
    texts = [bytes(text) for text in found["strings"]]
    assert all(text[0] == len(text) and text[1] == 3 for text in texts)
    assert texts[0] == bytes((4, 3, 0x09, 0x04))
    strings = [""] + [text[2:].decode("utf-16-le") for text in texts[1:]]
    assert strings[device["maker"]] == "annulus"
    assert strings[device["name"]] == "annulus controller"
    assert len(strings[device["serial"]]) == 16
    assert int(strings[device["serial"]], 16) > 0

    whole = bytes(found["configuration"])
    parts, at = [], 0
    while at < len(whole):
        assert whole[at] >= 2
        parts.append(whole[at : at + whole[at]])
        assert len(parts[-1]) == whole[at]
        at += whole[at]
    head, association, control, *functional, notice, data, out_end, in_end = parts
    length, kind, total, interfaces, value, name, attributes, power = [*struct.unpack("<BBHBBBBB", head)]
    assert (length, kind, total, interfaces, value, name) == (9, 2, len(whole), 2, 1, 0)
    assert attributes & 0x9F == 0x80
    assert power * 2 <= 500
    assert association == bytes((8, 11, 0, 2, 2, 2, 0, 0))  # interfaces 0 and 1, communications, abstract control
    assert control == bytes((9, 4, 0, 0, 1, 2, 2, 0, 0))
    assert data == bytes((9, 4, 1, 0, 2, 10, 0, 0, 0))
    assert [part[:3] for part in functional] == [b"\x05\x24\x00", b"\x05\x24\x01", b"\x04\x24\x02", b"\x05\x24\x06"]
    assert struct.unpack("<H", functional[0][3:]) == (0x0120,)
    assert functional[1][3:] == bytes((0, 1))  # call management: none, data are interface 1's
    assert functional[2][3] == 2  # line coding and line state, neither break nor comm feature
    assert functional[3][3:] == bytes((0, 1))
    ends = [struct.unpack("<BBBBHB", end) for end in (notice, out_end, in_end)]
    assert [end[:4] for end in ends] == [(7, 5, 0x81, 3), (7, 5, 0x02, 2), (7, 5, 0x82, 2)]
    assert [end[4] for end in ends] == [8, 64, 64]
    assert ends[0][5] >= 1


@pytest.mark.deep(gate="tests/emulator/test_usb.py::test_it_enumerates_and_its_descriptors_are_those_of_a_cdc_acm_port")
def test_every_board_has_a_serial_number_of_its_own(board: EmulatedBoard, image: Path) -> None:
    board.plug_in()
    another = EmulatedBoard(image, flash_id="e660583883265b21")
    another.run(BOOTED)
    another.plug_in()
    one, two = (bytes(each.usb["found"]["strings"][3])[2:].decode("utf-16-le") for each in (board, another))
    another.close()
    assert two == "E660583883265B21"
    assert one != two


@pytest.mark.deep(
    gate="tests/emulator/test_usbip.py::test_requests_and_bytes_go_both_ways_and_what_is_not_wanted_any_more_is_taken_back"
)
def test_malformed_control_requests_are_stalled_and_harm_nothing(board: EmulatedBoard) -> None:
    board.plug_in()
    for request in (
        setup(0x80, 6, 0x0600, 0, 10),  # device qualifier: there is no high speed
        setup(0x80, 6, 0x0304, 0x409, 255),
        setup(0x80, 6, 0x0101, 0, 18),
        setup(0x80, 6, 0x0201, 0, 9),
        setup(0x80, 6, 0x0F00, 0, 5),
        setup(0x00, 9, 2),
        setup(0x00, 3, 1),  # remote wake-up
        setup(0x02, 3, 0, 0x83),
        setup(0x02, 1, 1, 0x82),
        setup(0x01, 11, 1, 1),
        setup(0x21, 0x20, 0, 0, 0),
        setup(0x21, 0x23, 0xFFFF),
        setup(0x21, 0x22, 1, 0, 4),
        setup(0x40, 1),
        setup(0xC0, 1, 0, 0, 64),
        setup(0xFF, 0xFF, 0xFFFF, 0xFFFF, 0xFFFF),
    ):
        data = bytes(struct.unpack("<H", request[6:])[0]) if not request[0] & 0x80 else b""
        assert board.control(request, data)[0] == "stall", request.hex()
    assert board.control(setup(0x21, 0x20, 0, 0, 7), bytes(5))[0] == "stall"  # shorter than announced
    rng = random.Random(5)
    for _ in range(150):
        kind = rng.choice((rng.randrange(256), 0x80, 0, 0x21, 0xA1, 2, 0x82))
        asked = setup(kind, rng.randrange(12), rng.randrange(1 << 16), rng.randrange(4), rng.choice((0, 1, 2, 64, 255)))
        if asked[:2] in (b"\x00\x05", b"\x00\x09"):
            continue  # addresses and configurations that work
        status, _ = board.control(asked, bytes(asked[6]) if not kind & 0x80 else b"")
        assert status in ("ok", "stall")
    assert board.control(setup(0x80, 6, 0x0100, 0, 8)) == ("ok", bytes(board.usb["found"]["device"][:8]))
    assert board.control(setup(0x80, 6, 0x0200, 0, 0xFFFF)) == ("ok", bytes(board.usb["found"]["configuration"]))
    assert board.control(setup(0x21, 0x22, 3))[0] == "ok"
    assert board.identify().status == StatusCode.OK


@pytest.mark.deep(
    gate="tests/emulator/test_usbip.py::test_requests_and_bytes_go_both_ways_and_what_is_not_wanted_any_more_is_taken_back"
)
def test_standard_and_class_requests_are_answered(board: EmulatedBoard) -> None:
    board.plug_in()
    assert board.control(setup(0x80, 8, 0, 0, 1)) == ("ok", b"\x01")
    assert board.control(setup(0x80, 0, 0, 0, 2)) == ("ok", bytes(2))
    assert board.control(setup(0x81, 10, 0, 1, 1)) == ("ok", b"\0")
    assert board.control(setup(0xA1, 0x21, 0, 0, 7)) == ("ok", struct.pack("<IBBB", 115200, 0, 0, 8))
    coding = struct.pack("<IBBB", 1_000_000, 0, 0, 8)
    assert board.control(setup(0x21, 0x20, 0, 0, 7), coding)[0] == "ok"
    assert board.control(setup(0xA1, 0x21, 0, 0, 7)) == ("ok", coding)
    for end in (0x81, 0x82, 0x02):  # halt, and clear again; the toggles begin anew on both sides
        assert board.control(setup(0x82, 0, 0, end, 2)) == ("ok", bytes(2))
    assert board.control(setup(0x02, 3, 0, 0x81))[0] == "ok"
    assert board.control(setup(0x82, 0, 0, 0x81, 2)) == ("ok", b"\x01\0")
    assert board.control(setup(0x02, 1, 0, 0x81))[0] == "ok"
    assert board.control(setup(0x82, 0, 0, 0x81, 2)) == ("ok", bytes(2))
    assert board.identify().status == StatusCode.OK


# What a host loses interest in after its setup packet, and what it asks next: macOS does so whenever it closes a port.
LINE_CODING, DEVICE = setup(0xA1, 0x21, 0, 0, 7), setup(0x80, 6, 0x0100, 0, 18)


@pytest.mark.parametrize("times", [12, pytest.param(300, marks=pytest.mark.deep)])
def test_a_request_after_an_abandoned_one_gets_its_own_answer(board: EmulatedBoard, times: int) -> None:
    board.plug_in()
    own = board.control(DEVICE)
    assert own[0] == "ok" and len(own[1]) == 18
    for number in range(times):
        board.run(board.now + 137 * number)
        board.usb_controls.clear()
        board.usb_do("abandon", setup=LINE_CODING.hex())
        while not board.usb_controls:
            board.run(board.now + MS // 2)
        assert board.control(DEVICE) == own, number
    assert board.identify().status == StatusCode.OK


@pytest.mark.deep(gate="tests/emulator/test_usb.py::test_a_request_after_an_abandoned_one_gets_its_own_answer")
def test_a_request_gets_its_own_answer_though_the_last_is_just_being_answered(board: EmulatedBoard) -> None:
    """The old answer was handed over for 30 ticks before the new request was noticed: 7 of 1000 got it."""
    board.plug_in()
    own = board.control(DEVICE)
    rng = random.Random(5)
    for wait in range(600, 2600, 4):
        board.run(board.now + rng.randrange(20_000))
        board.usb_controls.clear()
        board.usb_do("abandon", setup=setup(0x80, 0, 0, 0, 2).hex(), wait=str(wait), then=DEVICE.hex())
        while not board.usb_controls:
            board.run(board.now + MS // 2)
        assert board.usb_controls[0] == {"setup": DEVICE.hex(), "status": "ok", "data": own[1].hex()}, wait


@pytest.mark.parametrize("phase", [0, *(pytest.param(k, marks=pytest.mark.deep) for k in range(1, 10))])
def test_a_port_that_is_closed_after_an_abandoned_request_is_heard_to_be(board: EmulatedBoard, phase: int) -> None:
    """Its closing was acknowledged by what was left, and overwritten by the next request: 75 flashes went on."""
    board.plug_in()
    arm(board, ratio=0, period=400_000, delay=50_000, width=20_000, host_timeout=5000)
    begins = board.now + MS
    for number in range(100):
        board.pulse(begins + number * 400_000, low=3_000)
    board.run(begins + 5 * MS + phase * 1033)
    board.usb_do("abandon", setup=setup(0x21, 0x22, 3).hex())
    board.run(board.now + 2 * MS)
    board.usb_controls.clear()
    board.usb_do("controls", setups=[setup(0x21, 0x22, 0).hex(), LINE_CODING.hex()])
    board.run(board.now + 3 * MS)
    assert [one["status"] for one in board.usb_controls] == ["ok", "ok"]
    board.transitions.clear()
    board.run(board.now + 300 * MS)
    assert board.rises(PIN_LED) == []


# ---- data ----


@pytest.mark.parametrize("size", [10_000, pytest.param(1_000_000, marks=pytest.mark.deep)])
def test_many_bytes_to_the_controller_arrive_whole(board: EmulatedBoard, size: int) -> None:
    board.plug_in()
    board.identify()
    rng = random.Random(1)
    board.replies.clear()
    begun = board.now
    written = sent = 0
    while written < size:
        frames = []
        for _ in range(250):
            chips = rng.getrandbits(256) | 1
            frames.append(encode(Frame(Pattern(length=256, chips=chips.to_bytes(32, "little")), sent & 0xFF)))
            sent += 1
        board.write(b"".join(frames))
        written += sum(map(len, frames))
        while board.usb["waiting"]:
            board.run(board.now + 10 * MS)
    rate = written / ((board.now - begun) * TICK_S)
    print(f"{rate / 1000:.0f} kB/s to the controller")
    assert rate > RATE_TO
    board.run(board.now + 5 * MS)
    answers = [reply for reply in board.replies if isinstance(reply, PatternReply)]
    assert len(answers) == len(board.replies) == sent  # one answer to each, and nothing was garbled
    assert {reply.status for reply in answers} == {StatusCode.OK}
    status = board.request(Status())
    assert isinstance(status, StatusReply)
    assert status.bad_frames == board.bad == 0


@pytest.mark.parametrize("size", [10_000, pytest.param(1_000_000, marks=pytest.mark.deep)])
def test_many_bytes_from_the_controller_arrive_whole(board: EmulatedBoard, size: int) -> None:
    board.plug_in()
    board.identify()
    for i in range(70):
        board.pulse(board.now + MS + 210_000 * i)
    board.run(board.now + 150 * MS)
    last = list(board.events[-64:])
    first = board.event_sequences[-64]
    board.events.clear()
    board.event_sequences.clear()
    begun, began = board.usb_bytes, board.now
    rounds = 0
    while board.usb_bytes - begun < size:
        board.send(Reread(first=first, count=64))
        rounds += 1
        while len(board.events) < 64 * rounds:
            board.run(board.now + MS)
    rate = (board.usb_bytes - begun) / ((board.now - began) * TICK_S)
    print(f"{rate / 1000:.0f} kB/s from the controller")
    assert rate > RATE_FROM
    assert board.events == last * rounds
    assert board.event_sequences == [first + i for i in range(64)] * rounds
    assert board.bad == 0


@pytest.mark.deep(gate="tests/emulator/test_usb.py::test_many_bytes_from_the_controller_arrive_whole")
def test_what_fills_its_last_packet_is_not_kept_waiting_for_more(board: EmulatedBoard) -> None:
    """The host's driver waits for two packets or a short one: an empty one has to follow a whole one if it is last."""
    board.plug_in()
    board.over_usb = True
    board.identify()
    board.pulse(board.now + MS)
    for generation in range(1, 7):
        board.request(configuration(generation=generation))
        board.request(Commit(generation=generation))
    for i in range(4):  # irregular, so that nothing but edges is told
        board.pulse(board.now + 2 * MS + 6_000_000 * i)
    board.run(board.now + 200 * MS)
    sizes = [
        len(encode(Frame(event, sequence, boot=1)))
        for event, sequence in zip(board.events, board.event_sequences, strict=True)
    ]
    answer = 11  # bytes of the reply on the wire
    whole = [
        (first, count)
        for first in range(len(sizes))
        for count in range(1, len(sizes) - first + 1)
        if (answer + sum(sizes[first : first + count])) % 128 == 64
    ]
    assert whole
    for first, count in whole[:10]:
        board.events.clear()
        board.request(Reread(first=board.event_sequences[first], count=count))
        board.run(board.now + 20 * MS)
        assert len(board.events) == count


@pytest.mark.deep(gate="tests/emulator/test_image.py::test_no_jitter_under_a_flood_and_a_burst_train")
def test_no_jitter_while_usb_is_busy_both_ways_and_a_train_runs(board: EmulatedBoard) -> None:
    board.plug_in()
    period, delay, width = 200_000, 30_000, 20_000
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=4, period=period, delay=delay, width=width)
    burst = Burst(code=BurstCode.MPSL25, chip=50, repeat=60_000, period=70_000, trigger_offset=-25)
    assert board.request(burst).status == StatusCode.OK
    rng = random.Random(9)
    first = board.now + MS
    edges = [first + i * period + rng.randrange(-50, 50) for i in range(1500)]
    begun = board.usb_bytes
    for begin in range(0, len(edges), 50):
        some = edges[begin : begin + 50]
        board.input(*[item for edge in some for item in ((edge, PIN_SYNC, 0), (edge + 3_000, PIN_SYNC, 1))])
        for edge in some[::10]:
            board.write(b"".join(encode(Frame(Status(), rng.randrange(256))) for _ in range(150)))
            board.run(edge + 9 * period)
    board.run(edges[-1] + period)
    rises = sorted(board.rises(PIN_PROJECTOR) + board.rises(PIN_LED))
    assert {rise - edge for rise, edge in zip(rises, edges, strict=True)} == {delay + LATENCY}
    falls = sorted(board.falls(PIN_PROJECTOR) + board.falls(PIN_LED))
    assert {fall - rise for fall, rise in zip(falls, rises, strict=True)} == {width}
    chip0 = board.rises(PIN_MICROWAVE)[0]
    assert {(tick - chip0) % 70_000 % 50 for tick in board.rises(PIN_MICROWAVE) + board.falls(PIN_MICROWAVE)} == {0}
    seconds = (edges[-1] - first) * TICK_S
    print(f"{(board.usb_bytes - begun) / seconds / 1000:.0f} kB/s from the controller meanwhile")
    assert board.usb_bytes - begun > 100_000 * seconds
    assert board.resets == []
    board.run(board.now + 100 * MS)
    status = board.request(Status())
    assert isinstance(status, StatusReply)
    assert (status.edges, status.late, status.bad_frames) == (len(edges), 0, 0)


@pytest.mark.deep(gate="tests/emulator/test_image_microwave.py::test_a_code_is_played_as_it_is_written")
def test_a_train_begins_when_its_reply_says_however_busy_the_lines_are(board: EmulatedBoard) -> None:
    board.identify()
    board.plug_in()
    arm(board, ArmFlag.MICROWAVE)
    rng = random.Random(3)
    for _ in range(60):
        board.transitions.clear()
        board.over_usb = False
        board.write(rng.randbytes(80))  # bytes that interrupt at every moment
        board.over_usb = True
        board.run(board.now + rng.randrange(20_000))
        for edge in range(board.now + rng.randrange(1, 200), board.now + 60_000, 211):  # and edges, while it begins
            board.pulse(edge, low=100)
        burst = Burst(code=BurstCode.SINGLE, chip=100, repeat=1, period=10_000, trigger_offset=0)
        reply = board.request(burst)
        assert isinstance(reply, BurstReply)
        assert reply.status == StatusCode.OK
        board.run(board.now + MS)
        assert [tick - board.origin for tick in board.rises(PIN_MICROWAVE)] == [reply.start]


# ---- plug, bus, and the other line ----


def test_unplugged_while_armed_it_goes_dark_and_is_back_in_under_a_second(board: EmulatedBoard) -> None:
    board.plug_in()
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=0, period=1_000_000, delay=100_000, width=400_000, readout=0)
    burst = Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=10_000, trigger_offset=0)
    assert board.request(burst).status == StatusCode.OK
    edges = [board.now + MS + i * 1_000_000 for i in range(100)]
    for edge in edges:
        board.pulse(edge)
    board.run(edges[2] + 150_000)  # amid a flash
    unplugged = board.now
    board.usb_do("detach")
    board.run(unplugged + 40 * MS)
    dark = max(tick for tick, pin, _ in board.transitions if pin in OUTPUTS)
    print(f"dark {(dark - unplugged) / MS:.2f} ms after the plug was pulled")
    assert unplugged < dark < unplugged + MS // 5  # VBUS tells; where it is not sensed: test_variant.py
    replugged = board.now
    board.over_usb = False
    board.plug_in()
    who = board.identify()
    assert who.cause == 0  # it never went away
    assert [fault.fault for fault in board.heard(Fault)] == []  # was said while nobody was there
    status = board.request(Status())
    assert isinstance(status, StatusReply)
    assert status.fault == FaultCode.HOST_TIMEOUT
    assert board.request(Clear()).status == StatusCode.OK
    assert board.request(Arm(outputs=ArmFlag.LAMPS)).status == StatusCode.OK
    board.run_alive(board.now + 30 * MS)
    again = min(tick for tick in board.rises(PIN_LED) if tick > replugged)
    print(f"lamp {(again - replugged) / MS:.0f} ms after the plug went in")
    assert again < replugged + 1000 * MS
    assert board.bad == 0


@pytest.mark.deep(
    gate="tests/emulator/test_usb.py::test_unplugged_while_armed_it_goes_dark_and_is_back_in_under_a_second"
)
def test_a_closed_port_is_a_gone_host(board: EmulatedBoard) -> None:
    board.plug_in()
    arm(board, ratio=0, period=1_000_000, delay=100_000, width=100_000)
    board.usb_do("close")
    board.run(board.now + 2 * MS)
    board.usb_do("open")
    board.run(board.now + 2 * MS)
    board.identify()
    status = board.request(Status())
    assert isinstance(status, StatusReply)
    assert status.fault == FaultCode.HOST_TIMEOUT


@pytest.mark.deep(
    gate="tests/emulator/test_usb.py::test_unplugged_while_armed_it_goes_dark_and_is_back_in_under_a_second"
)
@pytest.mark.parametrize("how", ["reset", "suspend"])
def test_the_bus_may_be_reset_or_suspended_amid_a_transfer(board: EmulatedBoard, how: str) -> None:
    board.plug_in()
    rng = random.Random(4)
    for _ in range(4):
        arm(board, ratio=0)
        board.write(b"".join(encode(Frame(Status(), i & 0xFF)) for i in range(400)))
        board.run(board.now + rng.randrange(30_000, 200_000))
        board.usb_do(how)
        board.run(board.now + 10 * MS)
        if how == "suspend":
            board.usb_do("resume")
        while not board.usb["open"] or board.usb["waiting"]:
            board.run(board.now + 5 * MS)
        board.run(board.now + 5 * MS)
        who = board.identify()
        assert who.status == StatusCode.OK
        status = board.request(Status())
        assert isinstance(status, StatusReply)
        assert status.fault == FaultCode.HOST_TIMEOUT  # it was armed, and its host went away
        assert board.request(Clear()).status == StatusCode.OK
    assert board.resets == []


def test_both_lines_work_at_once_and_one_of_them_commands(board: EmulatedBoard) -> None:
    board.identify()
    board.plug_in()
    assert isinstance(board.request(Ping()), PingReply)  # anybody may look
    assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.SCHEMA
    assert board.aside == []  # and is answered where he asked
    board.pulse(board.now + MS)
    board.run(board.now + 3 * MS)
    assert len(board.heard(Edge)) == 0
    assert len(board.aside) == 1  # the event, for the line that identified
    arm(board)  # takes over
    board.pulse(board.now + MS)
    board.run(board.now + 3 * MS)
    assert len(board.heard(Edge)) == 1
    assert len(board.aside) == 1
    board.over_usb = False
    identify = Identify(protocol=1, schema=SCHEMA_HASH)
    assert board.request(identify).status == StatusCode.BAD_STATE  # not while the other one has armed
    assert board.request(Arm(outputs=ArmFlag(0))).status == StatusCode.OK  # but anybody may darken it
    assert board.request(identify).status == StatusCode.OK


@pytest.mark.deep(
    gate="tests/emulator/test_usb_frames.py::test_when_the_usb_block_hangs_all_goes_dark_and_the_port_comes_back"
)
def test_a_reset_over_usb_is_acknowledged_and_the_port_comes_back(board: EmulatedBoard) -> None:
    board.plug_in()
    before = board.identify().boot
    assert board.request(Reset(magic=0x7E5E7B00)).status == StatusCode.OK
    board.run(board.now + 20 * MS)
    while not board.usb["open"]:
        board.run(board.now + 10 * MS)
    assert board.identify().boot == (before + 1) % 256
