"""The rig's host side: what it makes of words, and of a line that says anything."""

import itertools
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.link.messages import Edge
from annulus_pipe.selftest.rig import wire
from annulus_pipe.selftest.rig.board import Played
from annulus_pipe.selftest.rig.on_rig import origin_of
from annulus_pipe.selftest.rig.recording import merged, play_list, samples, track
from annulus_pipe.vocabulary import AnnulusError, EdgeFlag, Lamp
from tools.pictures import rig as picture

HEADER = Path(__file__).resolve().parents[3] / "firmware/rig/wire.h"


def test_both_ends_have_the_same_numbers() -> None:
    text = HEADER.read_text()
    defined = {name: int(value, 0) for name, value in re.findall(r"#define RIG_(\w+) (\w+)", text)}
    listed = {name: int(value) for name, value in re.findall(r"^    RIG_(\w+) = (\d+),", text, re.MULTILINE)}
    ours = {name: getattr(wire, name) for name in defined if hasattr(wire, name)}
    assert ours == {name: defined[name] for name in ours}
    assert len(ours) == len(defined)
    assert {o.name: o.value for o in wire.Operation} | {s.name: s.value for s in wire.RigStatus} == {
        name: value for name, value in listed.items() if not name.startswith("AREA_")
    }
    assert {f"AREA_{a.name}": a.value for a in wire.Area} == {n: v for n, v in listed.items() if n.startswith("AREA_")}


@given(st.binary(max_size=wire.PAYLOAD_MAX), st.integers(0, 255))
def test_a_frame_comes_out_as_it_went_in(payload: bytes, sequence: int) -> None:
    made = wire.frame(wire.Operation.LIST, sequence, payload)
    assert made.count(b"\0") == 1
    assert wire.unframe(made[:-1]) == (wire.Operation.LIST, sequence, payload)


@given(st.binary(max_size=400))
def test_a_damaged_frame_is_none(data: bytes) -> None:
    found = wire.unframe(data.replace(b"\0", b""))
    assert found is None or len(found[2]) <= len(data)


def looks(changes: list[int], odd: bool) -> list[int]:
    """What the machine of firmware/rig/bench.c pushes for a pin that is low and changes at these ticks."""
    words, y, tick, level = [], 0xFFFFFFFF, wire.TRACK_AT - 1 + odd, 0
    while tick < changes[-1] + 20:
        y -= 1
        seen = sum(change <= tick + 1 for change in changes) % 2  # the look is the loop's second cycle
        tick += 2
        if seen != level:
            words.append(y)
            level = seen
            tick += wire.RISE_DEAD if level else wire.FALL_DEAD
    return words


@given(st.lists(st.integers(8, 500), min_size=1, max_size=20), st.integers(6, 100))
def test_two_tracks_know_every_change_to_the_tick(gaps: list[int], first: int) -> None:
    changes = list(itertools.accumulate([first, *gaps]))
    both = [track(looks(changes, odd), odd) for odd in (False, True)]
    assert merged(*both) == [(tick, (i + 1) % 2) for i, tick in enumerate(changes)]


def test_a_pin_that_is_high_from_the_start_has_no_rise() -> None:
    both = [track(looks([0, 50], odd), odd) for odd in (False, True)]
    assert merged(*both) == [(50, 0)]


@given(
    st.lists(
        st.tuples(st.integers(20, 3_000_000), st.sampled_from([2, 7, 14]), st.integers(0, 1)), min_size=1, max_size=30
    )
)
def test_a_list_plays_every_edge_at_its_tick_or_as_soon_as_it_can(edges: list[tuple[int, int, int]]) -> None:
    words, ticks = play_list(edges, 0, wire.PLAYED_AT)
    at, levels, seen = wire.PLAYED_AT, 0, []
    for word in words:
        now = (word & 0x3FFF) << wire.LIST_FIRST_PIN
        seen += [(at, pin, (now >> pin) & 1) for pin in range(16) if ((now ^ levels) >> pin) & 1]
        levels = now
        at += (word >> 14) + wire.GAP_MIN
    wanted = 0
    expected: dict[tuple[int, int], int] = {}
    for tick, (_, pin, level) in zip(ticks, sorted(edges), strict=True):
        expected[tick, pin] = level
    for (tick, pin), level in sorted(expected.items()):
        if (wanted >> pin) & 1 != level:
            assert (tick, pin, level) in seen
        wanted = (wanted & ~(1 << pin)) | (level << pin)
    for tick, (asked, _, _) in zip(ticks, sorted(edges), strict=True):
        assert 0 <= tick - asked <= wire.GAP_MIN * len(edges)


def test_the_picture_in_the_manual_is_of_these_jumpers() -> None:
    assert picture.OUT.read_text(encoding="utf-8") == picture.drawn()
    assert picture.drawn().count("<line") == 16


class Silence:
    """A port behind which nobody is, or whose noise is no rig's, in a time of its own."""

    def __init__(self, noise: bytes) -> None:
        self.now, self.bytes_read, self.noise = 0, 0, noise

    def now_ns(self) -> int:
        return self.now

    def read(self, timeout_s: float) -> bytes:
        self.now += round(timeout_s * 1e9)
        self.bytes_read += len(self.noise)
        return self.noise

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_port_from_which_nothing_comes_is_given_up_after_three_seconds() -> None:
    silent = Silence(b"")
    with pytest.raises(AnnulusError, match="nothing came, expected a second Pico"):
        wire.RigLine("/dev/ttyACM9", silent)  # type: ignore[arg-type]
    assert silent.now <= 3.1e9
    with pytest.raises(AnnulusError, match="bytes came and none was a rig's"):
        wire.RigLine("/dev/ttyACM9", Silence(b"\x07\0"))  # type: ignore[arg-type]


def test_samples_are_changes_of_four_pins() -> None:
    assert samples([0x00011331], 3, 98) == [(103, 3, 1), (105, 4, 1), (107, 4, 0)]


def test_the_controllers_count_is_found_whichever_edges_it_refused() -> None:
    falls = [1_000, 3_000, 401_000, 403_500, 801_000]
    told = [(2**32 - 500_000 + tick) % 2**32 for tick in (1_000, 401_000, 801_000)]
    edges = [Edge(i, tick, 0, Lamp.DARK, 0, 0, 0, 0, EdgeFlag(0)) for i, tick in enumerate(told)]
    played = Played([(tick, 2, 0) for tick in falls], events=list(edges))
    origin = origin_of(played)
    assert origin is not None
    played.origin = origin
    assert [played.tick_of(tick) for tick in told] == [1_000, 401_000, 801_000]
