"""Power that came back with the boot byte of before made z begin at 0 again, and no restart bounded or marked it."""

import pytest

from annulus_pipe.controller import PIN_INTERLOCK, PIN_ODOMETER_A, PIN_ODOMETER_B, PIN_SYNC
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.link.head import EdgeSeen, HeadControl
from annulus_pipe.link.messages import Stage
from annulus_pipe.link.phase import Phase
from annulus_pipe.link.session import Rebooted
from annulus_pipe.sensors.odometer import FlashPosition
from annulus_pipe.twin.native import NativeBoard

MS = 100_000  # ticks
STAGE = Stage(1, 4, 4_000_000, 3_800_000, 2_800_000, 50, 0, 450_000, 500_000, 575_000, 250_000)
MM = 0.05  # a count
WRAP_MS = (1 << 32) / MS
NOTICED_MS = 2000
BYTE = 42


class Rig:
    """A head on the native board behind a UART, 25 frames a second, pulled at one count a millisecond. The host's
    clock goes on while the controller has no power.
    """

    def __init__(self) -> None:
        self.board = NativeBoard()
        self.board.power_on(BYTE)
        self.board.input(0, PIN_INTERLOCK, 0)
        self.head, self.navigation = HeadControl(STAGE), Navigation(MM, max_speed_mm_s=200.0)
        self.off_ms = 0  # so long there was no power
        self.pulled = 0  # counts, really
        self.boots: list[Rebooted] = []
        self.seen: list[tuple[EdgeSeen, FlashPosition]] = []
        self.falls: list[dict[int, tuple[int, int]]] = [{}]  # by boot: edge -> host ns, counts pulled by then
        self.deaf_until = 0

    @property
    def now_ns(self) -> int:
        return self.board.tick * 10 + self.off_ms * 1_000_000

    def off(self, milliseconds: int, pulled: bool, stopped: bool) -> None:
        """`stopped`: so is the host."""
        step = milliseconds if stopped else 10
        for _ in range(0, milliseconds, step or 1):
            self.off_ms += step
            self.head.pending(self.now_ns)  # to nobody
            self._heard(b"")
        self.pulled += milliseconds if pulled else 0
        self._turn_encoder(self.board.tick)
        self.board.run_until(self.board.tick + 10)
        self.board.power_on(BYTE)
        self.falls.append({})

    def run(self, milliseconds: int, pull: bool = True) -> None:
        for _ in range(milliseconds):
            now = self.board.tick
            if pull:
                self.pulled += 1
                self._turn_encoder(now + 50)
            if now // MS % 40 == 20:
                self.board.input(now + 10, PIN_SYNC, 1)
            if now // MS % 40 == 39:
                self.board.input(now + 90_000, PIN_SYNC, 0)
                falls = self.falls[-1]
                falls[len(falls)] = self.now_ns + 900_000, self.pulled
            self.board.serial_write(self.head.pending(self.now_ns))
            self.board.run_until(now + MS)
            said = self.board.serial_read()
            self._heard(said if self.board.tick >= self.deaf_until else b"")

    def _turn_encoder(self, tick: int) -> None:
        phase = (self.pulled + 2) % 4  # both lines are pulled up
        self.board.input(tick, PIN_ODOMETER_A, phase in (1, 2))
        self.board.input(tick, PIN_ODOMETER_B, phase in (2, 3))

    def _heard(self, data: bytes) -> None:
        for news in self.head.receive(data, self.now_ns):
            self.navigation.heard(news)
            if isinstance(news, EdgeSeen):
                place = self.navigation.odometer.place(self.navigation.edges.edges[-1].flash)
                assert place is not None
                self.seen.append((news, place))
            elif isinstance(news, Rebooted):
                self.boots.append(news)


@pytest.mark.parametrize(
    "deaf_ms, pulled, stopped",
    [(0, False, False), (60, True, False), (60, False, True), (1500, True, False)],
    ids=["booted-heard", "booted-lost", "host-stopped", "cable-out"],
)
@pytest.mark.parametrize("off_ms", [0, 1000, 21_500, 43_000, "wrap", 1_200_000])
def test_power_back_with_the_same_byte_is_noticed_and_no_place_is_silently_wrong(
    off_ms: int | str, deaf_ms: int, pulled: bool, stopped: bool
) -> None:
    """`wrap`: the tick goes on as if nothing had been. Seen red with all of the 24: no place was marked as assumed, and
    where the odometer knew a boot by its byte z began at 0 again.
    """
    rig = Rig()
    rig.run(2010)
    assert rig.head.phase is Phase.RUNNING
    rig.run(300, pull=pulled)
    off = round(WRAP_MS - (rig.board.tick - rig.board.boot_tick) / MS) if isinstance(off_ms, str) else off_ms
    rig.off(off, pulled, stopped)
    back = rig.board.tick
    rig.deaf_until = back + deaf_ms * MS
    while len(rig.boots) < 2:
        rig.run(1, pull=pulled)
        assert rig.board.tick - max(back, rig.deaf_until) < NOTICED_MS * MS
    rig.run(2500, pull=pulled)
    assert rig.head.phase is Phase.RUNNING and rig.head.boot_epoch == 2
    placed = [one for one in rig.seen if one[0].boot_epoch == 2]
    assert len(placed) > 50
    for edge, place in rig.seen:
        true_ns, true_counts = rig.falls[edge.boot_epoch - 1][edge.flash.edge]
        assert abs(edge.host_ns - true_ns) <= edge.error_ns + 20_000
        assert abs(place.z_mm - MM * true_counts) <= place.bound_mm + MM
        assert (place.assumed, place.segment) == (edge.boot_epoch == 2, edge.boot_epoch - 1)
    told = rig.navigation.odometer.gap
    assert told is not None and told.place == placed[0][1]
    if not pulled:
        assert told.place.z_mm == pytest.approx(rig.pulled * MM, abs=MM)
    rig.navigation.odometer.zero()
    rig.run(100)
    assert not rig.seen[-1][1].assumed and rig.seen[-1][1].segment == 2
