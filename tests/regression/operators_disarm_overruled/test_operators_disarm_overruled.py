"""An operator's `annulus head disarm` was overruled within 0.6 s: a host that had armed the lamps armed them again,
whoever had switched them off.
"""

import ctypes

import pytest

from annulus_pipe.controller import PIN_INTERLOCK, PIN_LED, PIN_PROJECTOR, PIN_SYNC
from annulus_pipe.link.head import HeadControl
from annulus_pipe.link.messages import Arm, ArmFlag, Stage
from annulus_pipe.link.phase import Phase
from annulus_pipe.link.session import Answer, LinkSession, identify
from annulus_pipe.twin.native import NativeBoard
from annulus_pipe.vocabulary import AnnulusError

MS = 100_000  # ticks
STAGE = Stage(1, 4, 4_000_000, 3_800_000, 2_800_000, 50, 0, 450_000, 500_000, 575_000, 250_000)


class Rig:
    """The firmware, 25 frames a second, a head in service on the UART; somebody else at the USB plug."""

    def __init__(self) -> None:
        try:
            self.board = NativeBoard()
        except AnnulusError as error:
            pytest.skip(str(error))
        self.board.power_on(5)
        self.board.input(0, PIN_INTERLOCK, 0)
        self.head = HeadControl(STAGE)
        self._c = self.board._live()
        self._usb = ctypes.create_string_buffer(4096)

    def run(self, milliseconds: int, other: LinkSession | None = None, *, over_usb: bool = True) -> list[object]:
        """What `other` heard. Over the UART it has the line, and the head is not there."""
        heard: list[object] = []
        for _ in range(milliseconds):
            now = self.board.tick
            if now // MS % 40 in (20, 39):
                self.board.input(now + 10, PIN_SYNC, int(now // MS % 40 == 20))
            sent = other.pending(now * 10) if other is not None else b""
            if other is not None and over_usb:
                self._c.native_usb_write(sent, ctypes.c_size_t(len(sent)))
            elif other is not None:
                self.board.serial_write(sent)
            if other is None or over_usb:
                self.board.serial_write(self.head.pending(now * 10))
            self.board.run_until(now + MS)
            size = self._c.native_usb_read(self._usb, ctypes.c_size_t(4096))
            said = self.board.serial_read()
            if other is not None:
                heard += other.receive(self._usb.raw[:size] if over_usb else said, self.board.tick * 10)
            if other is None or over_usb:
                self.head.receive(said, self.board.tick * 10)
        return heard

    def flashes(self) -> int:
        """Since the last look."""
        return sum(1 for t in self.board.pins() if t["level"] and t["pin"] in (PIN_PROJECTOR, PIN_LED))

    def disarm(self, *, over_usb: bool) -> None:
        """As `annulus head disarm`."""
        other = LinkSession()
        other.send(identify())
        ticket = other.send(Arm(ArmFlag(0)))
        heard = self.run(20, other, over_usb=over_usb)
        assert any(isinstance(one, Answer) and one.ticket == ticket for one in heard)


def test_a_disarm_over_the_other_line_stays() -> None:
    rig = Rig()
    rig.run(1000)
    assert rig.head.phase is Phase.RUNNING and rig.flashes() > 15
    rig._c.native_usb_connect(ctypes.c_bool(True))
    rig.disarm(over_usb=True)
    rig.flashes()
    rig.run(5000)
    assert rig.flashes() == 0 and rig.head.phase is Phase.STOPPED
    rig.head.arm()
    rig.run(1000)
    assert rig.flashes() > 15 and rig.head.phase is Phase.RUNNING


def test_a_disarm_over_the_same_line_while_the_head_had_closed_it_stays() -> None:
    rig = Rig()
    rig.run(1000)
    rig.disarm(over_usb=False)
    rig.head.reopened()
    rig.flashes()
    rig.run(5000)
    assert rig.flashes() == 0 and rig.head.phase is Phase.STOPPED


def test_a_host_timeout_and_a_reset_are_nobodys_stop() -> None:
    rig = Rig()
    rig.run(1000)
    rig.board.run_until(rig.board.tick + 1000 * MS)
    rig.run(1000)
    assert rig.head.phase is Phase.RUNNING
    rig.board.power_on(6, cause=1)
    rig.board.input(rig.board.tick, PIN_INTERLOCK, 0)
    rig.run(1000)
    rig.flashes()
    rig.run(1000)
    assert rig.head.phase is Phase.RUNNING and rig.flashes() > 15
