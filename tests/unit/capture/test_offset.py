"""The search for a camera's offset: what it proves is true, however many stamps are off and however long frames are
kept; what it cannot prove it does not say."""

import random

import pytest

from annulus_pipe.capture.history import EdgeHistory
from annulus_pipe.capture.offset import CHANCE, Offset, calibrate_offset
from annulus_pipe.capture.photometry import Light, Photometry
from annulus_pipe.capture.seen import FrameSeen
from annulus_pipe.vocabulary import AnnulusError, EdgeFlag, EdgeIndex, Flash, Lamp, Slot, Tick

MS, PERIOD = 1_000_000, 40_000_000
LIGHTS = {Lamp.PROJECTOR: Light.PROJECTOR, Lamp.LED: Light.LED, Lamp.DARK: Light.DARK}


def search(
    seed: int, odd: float = 0.0, kept: int = 0, frames: int = 40, first: int = 0, every: int = 150, **options: bool
) -> Offset:
    """Of `frames` frames from edge `first` + `kept` on, of a driver that keeps each `kept` periods and stamps it then;
    this share of stamps is off by a frame. A preamble of 15 at edge 0 and `every` so many, none at 0.
    """
    dice = random.Random(seed)
    history, lamps = EdgeHistory(), []
    for k in range(first + frames + kept + 2):
        preamble = every > 0 and k % every < 15
        lamps.append(
            dice.choices(list(LIGHTS), (2, 1, 1))[0] if preamble else Lamp.LED if k % 5 == 4 else Lamp.PROJECTOR
        )
        flags = EdgeFlag.PREAMBLE if preamble else EdgeFlag(0)
        width = 0 if lamps[k] is Lamp.DARK else 5
        flash = Flash(EdgeIndex(k), Tick(0), Slot(k % 5), lamps[k], 3, width, 0, 1, 1, flags)
        history.edge(flash, k * PERIOD + round(dice.gauss(0, 0.1 * MS)), 1)
    seen = []
    for k in range(first + 1, first + frames):
        at = (k + kept) * PERIOD
        off = dice.choice([-1, 1]) * (dice.random() < odd)
        picture = Photometry(
            200.0, 0.4, {Light.PROJECTOR: 0.38, Light.LED: 0.001, Light.DARK: 0.0}[LIGHTS[lamps[k - 1]]]
        )
        if LIGHTS[lamps[k - 1]] is Light.DARK:
            picture = Photometry(5.0, 0.4, 0.0)
        stamp = at - 28 * MS + off * PERIOD + round(dice.gauss(0, 0.3 * MS))
        seen.append(FrameSeen(None, stamp, at + 6 * MS + round(dice.expovariate(1 / MS)), picture, {}))
    return calibrate_offset(seen, history, PERIOD, **options)


def proved(seeds: range, **case: object) -> int:
    """How many searches prove the true offset; that none proves another."""
    found = 0
    for seed in seeds:
        try:
            offset = search(seed, **case)  # type: ignore[arg-type]
        except AnnulusError:
            continue
        assert offset.chance <= CHANCE
        assert abs(offset.offset_ns + 28 * MS - PERIOD * int(case.get("kept", 0))) < 10 * MS, (seed, offset)  # type: ignore[call-overload]
        found += 1
    return found


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("many", [30, 1000])
def test_none_of_many_searches_proves_a_wrong_offset(many: int) -> None:
    for odd in (0.0, 0.05, 0.12, 0.25):
        for kept in (0, 2, 5, 8):
            proved(range(many // 10 if many < 100 else many // 4), odd=odd, kept=kept, frames=60)
    assert proved(range(many)) >= 0.995 * many, "forty frames with a preamble among them are nearly always enough"


def test_a_cycle_more_in_the_drivers_queue_is_told_by_the_preamble_only() -> None:
    assert proved(range(8), kept=5, frames=80, every=30) == 8
    assert proved(range(8), kept=5, frames=60, first=20) == 0, "nothing but the cycle in view, and preambles to come"
    with pytest.raises(AnnulusError, match="may fit as well"):
        search(1, frames=60, first=20, every=0, adrift=True)


def test_where_there_are_no_preambles_a_driver_is_taken_to_keep_less_than_a_cycle() -> None:
    assert proved(range(8), kept=3, frames=60, every=0) == 8


def test_an_idle_controller_says_nothing_of_the_lamp_cycle() -> None:
    """It stays at slot 0: taken for a cycle of one frame, any hole was half of one, and a search never ended."""
    history = EdgeHistory()
    for k in range(20):
        flash = Flash(EdgeIndex(k), Tick(0), Slot(0), Lamp.DARK, 3, 0, 0, 1, 1, EdgeFlag.DISARMED)
        history.edge(flash, k * PERIOD, 1)
    assert history.cycle == 5
    for k in range(20, 30):
        history.edge(Flash(EdgeIndex(k), Tick(0), Slot(k % 3), Lamp.LED, 3, 5, 0, 1, 1, EdgeFlag(0)), k * PERIOD, 1)
    assert history.cycle == 3
