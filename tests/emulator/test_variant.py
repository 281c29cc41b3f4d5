"""Which board carries the chip, and what VBUS tells where it is sensed, on the image a user flashes."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from emulated import BOOTED, MS, OUTPUTS, EmulatedBoard, arm

from annulus_pipe.controller import PIN_LED, PIN_STATUS, TICKS_PER_US
from annulus_pipe.link.messages import (
    ArmFlag,
    BoardKind,
    Burst,
    BurstCode,
    FaultCode,
    Hardware,
    HardwareReply,
    Presence,
    Status,
    StatusCode,
    StatusReply,
)

Boards = Callable[[str], EmulatedBoard]
SEEN = {"pico": 150 * TICKS_PER_US, "pico-w": 4 * MS, "other": 4 * MS}  # an idle bus shows after 3 ms


@pytest.fixture
def boards(image: Path) -> Iterator[Boards]:
    made: list[EmulatedBoard] = []

    def make(kind: str) -> EmulatedBoard:
        made.append(EmulatedBoard(image, kind=kind))
        made[-1].run(BOOTED + MS)  # the second proof of a Pico W takes half a millisecond
        return made[-1]

    yield make
    for board in made:
        board.close()


def hardware(board: EmulatedBoard) -> HardwareReply:
    reply = board.request(Hardware())
    assert isinstance(reply, HardwareReply)
    return reply


@pytest.mark.parametrize(
    "kind, found, absent, present",
    [
        ("pico", BoardKind.PICO, Presence.ABSENT, Presence.PRESENT),
        ("pico-w", BoardKind.PICO_W, Presence.UNKNOWN, Presence.UNKNOWN),
        ("other", BoardKind.UNKNOWN, Presence.UNKNOWN, Presence.UNKNOWN),
    ],
)
def test_the_board_is_found_and_vbus_told_where_it_is_sensed(
    boards: Boards, kind: str, found: BoardKind, absent: Presence, present: Presence
) -> None:
    board = boards(kind)
    board.identify()
    assert (hardware(board).board, hardware(board).vbus) == (found, absent)
    assert board.pulled_up == (found is not BoardKind.PICO)  # without VBUS a device must not pull D+ up
    board.usb_do("attach")
    board.run(board.now + MS)
    assert board.pulled_up and hardware(board).vbus == present
    lights = [tick for tick, pin, level in board.transitions if pin == PIN_STATUS and level]
    assert lights == [] or kind == "pico-w"  # there the pin is the radio's select line, asked for its proof


@pytest.mark.parametrize(
    "kind", ["pico", *(pytest.param(kind, marks=pytest.mark.deep) for kind in ("pico-w", "other"))]
)
def test_an_unplugged_head_is_dark_as_soon_as_anything_can_tell(boards: Boards, kind: str) -> None:
    board = boards(kind)
    board.plug_in()
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=0, period=1_000_000, delay=100_000, width=400_000, readout=0)
    burst = Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=10_000, trigger_offset=0)
    assert board.request(burst).status == StatusCode.OK
    edge = board.now + MS
    board.pulse(edge)
    board.run(edge + 150_000)
    assert board.rises(PIN_LED) and not board.falls(PIN_LED)
    unplugged = board.now
    board.usb_do("detach")
    board.run(unplugged + 10 * TICKS_PER_US)
    assert board.pulled_up == (kind != "pico")
    board.run(unplugged + 10 * MS)
    dark = max(tick for tick, pin, _ in board.transitions if pin in OUTPUTS) - unplugged
    print(f"{kind}: dark {dark / TICKS_PER_US:.1f} us after the plug was pulled")
    assert 0 < dark <= SEEN[kind]


def test_vbus_that_is_gone_for_a_microsecond_was_unplugged(boards: Boards) -> None:
    board = boards("pico")
    board.plug_in()
    arm(board, ratio=0, period=1_000_000, delay=100_000, width=400_000, readout=0)
    board.usb_do("detach")
    board.run(board.now + TICKS_PER_US)
    board.over_usb = False
    board.usb_do("attach")
    board.run(board.now + MS)
    status = board.request(Status())  # over the other line
    assert isinstance(status, StatusReply)
    assert status.fault == FaultCode.HOST_TIMEOUT
    board.plug_in()
    assert board.identify().status == StatusCode.OK
    assert board.resets == []


def test_a_plug_is_found_however_long_it_was_out(boards: Boards) -> None:
    """Half a turn of the timer's 32 bits and more: two of its counts are compared by the sign of their difference."""
    board = boards("pico")
    for _ in range(3):
        board.age(1_000_000_000)
        board.run(board.now + MS)
    board.plug_in()
    assert board.identify().status == StatusCode.OK


def test_a_pico_w_arms_without_a_light_and_a_pico_with_one(boards: Boards) -> None:
    for kind, lights in (("pico-w", 0), ("pico", 1)):
        board = boards(kind)
        board.identify()
        board.transitions.clear()
        arm(board)
        board.run(board.now + MS)
        assert len(board.rises(PIN_STATUS)) == lights
