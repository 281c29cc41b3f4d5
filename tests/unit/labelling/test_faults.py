"""Labels and places under every fault of camera, driver and host: none wrong, and soon there again."""

import random
from collections.abc import Callable
from typing import Any

import pytest
from bench_of_faults import PERIOD, Bench, Faults, Score

from annulus_pipe.capture.proof import ProofState, Witness
from annulus_pipe.vocabulary import Lamp

NOBODY_COUNTS: Callable[[int], int | None] = lambda k: None  # noqa: E731
COUNTS = pytest.mark.parametrize("count", [lambda k: 1000 + k, NOBODY_COUNTS], ids=["counted", "uncounted"])
AT = 150  # the frame at which a thing happens that happens once
FRAMES = 300
FRAME_MS = PERIOD / 1e6


def run(faults: Faults, frames: int = FRAMES, **options: object) -> Score:
    score = Bench(faults, **options).run(frames)  # type: ignore[arg-type]
    assert score.wrong == []
    return score


def sequence_of(length: int) -> list[int]:
    """A maximal-length sequence of period 31, over and over."""
    register, bits = 1, []
    for _ in range(length):
        bit = (register >> 4 ^ register >> 2) & 1
        register = (register << 1 | bit) & 31
        bits.append(bit)
    return bits


def with_preamble(ratio: int, every: int = 200, length: int = 15) -> dict[str, Any]:
    bits = sequence_of(20_000)

    def lamp(k: int) -> Lamp:
        if k % every < length:
            return Lamp.LED if bits[k] else Lamp.PROJECTOR
        return Lamp.LED if k % (ratio + 1) == ratio else Lamp.PROJECTOR

    return {"lamp": lamp, "preamble": lambda k: k % every < length}


@COUNTS
def test_without_a_fault_every_frame_but_the_first_is_known(count: Callable[[int], int | None]) -> None:
    assert run(Faults(count=count)).unknown == [0]


@pytest.mark.deep(but=1)
@COUNTS
@pytest.mark.parametrize(
    "frames", [1, -1, 2, -2, 3, -3, 5, -5, 10, -10, 12, -12, 0.25, -0.3, 0.5, -0.5, 0.75, -0.75, 1.5]
)
def test_stamps_that_step_are_seen_at_once_and_followed(count: Callable[[int], int | None], frames: float) -> None:
    score = run(Faults(count=count, stamp_ms=lambda k: frames * FRAME_MS * (k >= AT)))
    assert score.relock(AT) <= 8 and score.share(AT + 8) == 0
    if abs(frames) >= 0.5:
        assert any("now doubted" in text for text in score.told) and "labels were doubted, now proved" in score.told[-1]


@COUNTS
@pytest.mark.parametrize("frames", [3, -3, 5, 8])
def test_a_driver_that_always_stamps_whole_frames_off_is_right_from_the_start(
    count: Callable[[int], int | None], frames: int
) -> None:
    unknown = run(Faults(count=count), offset_ms=-28.0 + frames * FRAME_MS).unknown
    assert unknown == [0] or (frames == 8 and unknown[-1] <= 4), "flashes of before the first edge say nothing"


@pytest.mark.deep(but=1)
@COUNTS
@pytest.mark.parametrize("frames", [1, 3, 5, -1, -5, 0.5])
def test_one_stamp_in_37_that_is_off_costs_two_frames(count: Callable[[int], int | None], frames: float) -> None:
    score = run(Faults(count=count, stamp_ms=lambda k: frames * FRAME_MS * (k % 37 == 20)))
    assert score.share(AT) <= 2.2 / 37


@pytest.mark.deep(but=1)
@COUNTS
@pytest.mark.parametrize(("ppm", "minutes"), [(200, 3), (-200, 3)])
def test_stamps_may_drift_for_ever(count: Callable[[int], int | None], ppm: int, minutes: int) -> None:
    bench = Bench(Faults(count=count, stamp_ms=lambda k: k * FRAME_MS * ppm * 1e-6))
    score = bench.run(minutes * 60 * 25)
    assert score.wrong == [] and score.unknown == [0]
    assert bench.labelling.numbers()["offset_rate_ppb"] == pytest.approx(1000 * ppm, abs=30_000)


@COUNTS
def test_a_drift_is_known_well_enough_for_a_camera_that_pauses(count: Callable[[int], int | None]) -> None:
    """A minute of silence at 200 ppm is 12 ms: more than the window."""
    score = run(Faults(count=count, stamp_ms=lambda k: k * FRAME_MS * 2e-4, dropped=lambda k: 1500 <= k < 3000), 3100)
    assert score.relock(3000) <= (2 if count(0) is not None else 5), "without a count pictures have to agree"


@COUNTS
def test_a_picture_of_two_exposures_costs_itself_and_one_shown_again_a_cycle(
    count: Callable[[int], int | None],
) -> None:
    assert run(Faults(count=count, torn=lambda k: k % 9 == 4)).unknown == [0, *range(4, FRAMES, 9)]
    again = run(Faults(count=count, pictured=lambda k: k - (k % 50 == 4)))
    assert again.share(AT) <= 5 / 50, "after one that was shown before a cycle has to agree"
    frozen = run(Faults(count=count, pictured=lambda k: min(k, AT) if k < AT + 40 else k))
    assert frozen.share(AT + 44) == 0


@pytest.mark.parametrize("seconds", [0.1, 0.5, 2.0, 5.0])
def test_a_host_that_stalls_loses_no_label_where_the_driver_counts(seconds: float) -> None:
    stalled = round(seconds * 25)
    score = run(Faults(stall_until=lambda k: (AT + stalled) * (AT <= k < AT + stalled)))
    assert score.unknown == [0]


@pytest.mark.parametrize("seconds", [0.1, 0.5, 2.0, 5.0])
def test_where_it_does_not_count_only_the_frames_that_waited_are_unknown(seconds: float) -> None:
    stalled = round(seconds * 25)
    score = run(Faults(count=NOBODY_COUNTS, stall_until=lambda k: (AT + stalled) * (AT <= k < AT + stalled)))
    assert set(score.unknown) <= {0, *range(AT, AT + stalled + 4 + stalled // 15)}


@pytest.mark.parametrize("seconds", [0.1, 2.0])
def test_where_nothing_but_arrivals_is_known_a_stall_and_a_loss_cost_labels_and_make_none_wrong(seconds: float) -> None:
    """As through OpenCV, where the driver's stamps do not pass: no count, and stamp and arrival are one."""
    stalled = round(seconds * 25)
    faults = Faults(count=NOBODY_COUNTS, on_arrival=True, **with_preamble(4))
    faults.stall_until = lambda k: (AT + stalled) * (AT <= k < AT + stalled)
    faults.dropped = lambda k: k % 83 == 50 or AT + 4 <= k < AT + stalled - 2
    faults.kept = lambda k: (k >= 300) + (k >= 400)
    score = run(faults, 700, offset_ms=6.0)
    assert score.share() <= 0.5, "a camera that is known by its arrivals labels less, but it labels"


def test_one_odd_stamp_after_a_stall_costs_two_frames() -> None:
    """Those that had waited came sooner one after the other, and the count missed none of them."""
    faults = Faults(**with_preamble(4), stamp_ms=lambda k: 3 * FRAME_MS * (k == AT + 15))
    faults.stall_until = lambda k: (AT + 6) * (AT <= k < AT + 6)
    score = run(faults)
    assert score.unknown == [0, AT + 15, AT + 16]


def test_edges_lost_with_a_stall_say_nothing_against_the_count() -> None:
    """The board keeps fewer edges than come in 3.6 s: frames of the stall have none, and no label."""
    faults = Faults(**with_preamble(4), edge_lost=lambda k: AT - 1 <= k < AT + 80)
    faults.stall_until = lambda k: (AT + 90) * (AT <= k < AT + 90)
    faults.dropped = lambda k: AT + 8 <= k < AT + 90
    score = run(faults)
    assert score.relock(AT + 90) <= 2 and score.share(AT + 92) == 0


@COUNTS
@pytest.mark.parametrize("frames", [5, -5, 1, -1])
def test_stamps_that_step_while_the_host_stalls_are_caught(count: Callable[[int], int | None], frames: int) -> None:
    faults = Faults(count=count)
    faults.stamp_ms = lambda k: frames * FRAME_MS * (k >= AT)
    faults.stall_until = lambda k: (AT + 20) * (AT - 5 <= k < AT + 20)
    score = run(faults)
    assert score.relock(AT + 20) <= 16 and score.share(AT + 40) == 0


def test_a_count_that_begins_anew_is_believed_when_it_is_proved() -> None:
    score = run(Faults(count=lambda k: k if k < AT else k - AT))
    assert 3 < score.relock(AT) <= 8 and score.share(AT + 8) == 0


def test_a_stamp_that_is_off_by_itself_does_not_hold_up_those_that_have_moved() -> None:
    score = run(Faults(stamp_ms=lambda k: FRAME_MS * (7 * (k >= AT) + 2 * (k == AT))))
    assert score.relock(AT + 1) <= 8 and score.share(AT + 9) == 0


def test_a_count_that_stands_still_is_no_count() -> None:
    assert run(Faults(count=lambda k: 7)).unknown == [0]


def test_a_frame_with_the_stamp_and_count_of_the_one_before_has_no_edge_left() -> None:
    faults = Faults(count=lambda k: 1000 + k - (k % 50 == 7), stamp_ms=lambda k: -FRAME_MS * (k % 50 == 7))
    assert len(run(faults).unknown) <= 2 + 2 * FRAMES // 50  # and says nothing for the next frame either


@COUNTS
def test_lost_and_late_edges_cost_their_frames_only(count: Callable[[int], int | None]) -> None:
    assert run(Faults(count=count, edge_late=lambda k: k % 20 == 7)).unknown == [0]
    assert len(run(Faults(count=count, edge_lost=lambda k: k % 50 == 7)).unknown) <= 2 + 2 * FRAMES // 50


@COUNTS
def test_over_a_restart_of_the_controller_frames_keep_their_numbers(count: Callable[[int], int | None]) -> None:
    score = run(Faults(count=count, reset=lambda k: k in (AT, AT + 100)))
    assert len(score.unknown) == 9


@pytest.mark.deep(but=1)
@COUNTS
@pytest.mark.parametrize("ratio", [0, 1, 4])
@pytest.mark.parametrize("frames", [1, -1, 5, -5, 0.5])
def test_any_ratio_comes_back_after_a_doubt(count: Callable[[int], int | None], ratio: int, frames: float) -> None:
    """At ratio 0 and 1 a preamble has to say which frame is which at first; then the count can. Arrival alone overrules
    no stamp where there are preambles: all is searched anew."""
    faults = Faults(count=count, **with_preamble(ratio), stamp_ms=lambda k: frames * FRAME_MS * (k >= AT))
    score = run(faults, ratio=ratio)
    soon = 50 if count is NOBODY_COUNTS else 8
    assert score.relock(AT) <= soon and score.share(AT + soon) == 0


@pytest.mark.parametrize("ratio", [0, 1])
def test_without_a_preamble_pictures_that_are_all_alike_prove_nothing(ratio: int) -> None:
    assert run(Faults(), 200, ratio=ratio).share() == 1.0


@COUNTS
@pytest.mark.parametrize("periods", [2.2, 4.7, 5.6, 12.1])
def test_a_preamble_proves_which_frame_is_which_however_long_the_driver_keeps_it(
    count: Callable[[int], int | None], periods: float
) -> None:
    unknown = run(Faults(count=count, **with_preamble(4)), lag_ms=periods * FRAME_MS).unknown
    assert unknown[-1] <= (0 if periods < 4.9 else 60), "the preamble has to speak against a lag that is usual"


def test_the_operator_is_told_every_change_and_the_numbers_say_why() -> None:
    bench = Bench(Faults(stamp_ms=lambda k: 3 * FRAME_MS * (k >= AT)))
    score = bench.run(FRAMES)
    assert [told.rpartition("labels were ")[2] for told in score.told[2:]] == [
        "proved, now doubted: in hand before its edge",
        "doubted, now proved: timestamps have moved",
    ]
    numbers = bench.labelling.numbers()
    assert numbers["labels"] == ProofState.PROVED and numbers["contradictions"] == {"in hand before its edge": 4}
    assert numbers["offset_ns"] == pytest.approx(92e6, abs=1e6) and numbers["lag_ns"] == pytest.approx(6e6, abs=1e6)


def at_random(seed: int, frames: int, counted: bool) -> Faults:
    """All of them, one about every 60 frames."""
    dice = random.Random(seed)
    moved, ahead, late = [0.0] * frames, [0] * frames, dict[int, float]()
    hit: dict[str, set[int]] = {what: set() for what in ("dropped", "torn", "lost", "late", "reset", "frozen")}
    pictured, stalled = dict[int, int](), dict[int, int]()
    drift = dice.choice([0.0, 50e-6, -2e-4, 2e-4])
    k, by, jumped = 60, 0.0, 0
    while k < frames - 80:
        match dice.choice(["step", "part", "drop", "drops", "stamp", "again", "stall", "count", *hit]):
            case "step":
                by += dice.randint(-12, 12)
            case "part":
                by += dice.uniform(-3, 3)
            case "drops":
                hit["dropped"] |= set(range(k, k + dice.randint(1, 15)))
            case "stamp":
                late[k] = dice.choice([1, 2, 3, 5, -1, -2, -5, dice.uniform(-6, 6)])
            case "again":
                pictured[k] = k - dice.choice([1, 1, 2, 5])
            case "stall":
                many = dice.choice([3, 6, 12, 25, 60])
                stalled |= {n: k + many for n in range(k, k + many)}
            case "count":
                jumped += dice.choice([1, -1, 5, -1000])
            case "drop":
                hit["dropped"].add(k)
            case what:
                hit[what].add(k)
        pause = min(frames - k, 1 + int(dice.expovariate(1 / 60)))
        moved[k : k + pause], ahead[k : k + pause] = [by] * pause, [jumped] * pause
        k += pause
    moved[k:] = [by] * (frames - k)
    return Faults(
        stamp_ms=lambda k: FRAME_MS * (moved[k] + late.get(k, 0) + k * drift - (k in hit["frozen"])),
        count=(lambda k: 10_000 + k + ahead[k] - (k in hit["frozen"])) if counted else NOBODY_COUNTS,
        dropped=lambda k: k in hit["dropped"],
        edge_lost=lambda k: k in hit["lost"],
        edge_late=lambda k: k in hit["late"],
        stall_until=lambda k: stalled.get(k, 0),
        pictured=lambda k: pictured.get(k, k),
        torn=lambda k: k in hit["torn"],
        reset=lambda k: k in hit["reset"],
    )


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("counted", [True, False])
def test_no_mixture_of_faults_makes_a_wrong_label(seed: int, counted: bool) -> None:
    score = run(at_random(seed, 2500, counted), 2500, seed=seed)
    assert score.share() < (0.06 if counted else 0.12)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("witness", "faults"),
    [
        (Witness.TORN, Faults(torn=lambda k: k % 9 == 4)),
        (Witness.REPEATED, Faults(pictured=lambda k: k - (k % 9 == 4))),
        (Witness.LAMP, Faults(pictured=lambda k: k - (k >= AT), dropped=lambda k: k == AT - 1)),
        (Witness.ORDER, Faults(count=lambda k: 1000 + k - (k % 50 == 7), stamp_ms=lambda k: -FRAME_MS * (k % 50 == 7))),
        (
            Witness.ARRIVAL,
            Faults(count=lambda k: 1000 + k + 5 * (k >= AT), stamp_ms=lambda k: 5 * FRAME_MS * (k >= AT)),
        ),
        (Witness.COUNT, Faults(stall_until=lambda k: (k + 9) * (k % 50 == 7))),
    ],
)
def test_every_witness_is_needed(witness: Witness, faults: Faults) -> None:
    """Without it labels are wrong, or most of them gone."""
    asked, unasked = run(faults), Bench(faults, without=frozenset({witness})).run(FRAMES)
    assert unasked.wrong or unasked.share() > 5 * asked.share()


def test_without_the_preambles_witness_a_long_lag_is_a_wrong_place() -> None:
    faults = Faults(**with_preamble(4))
    run(faults, lag_ms=5.6 * FRAME_MS)
    assert Bench(faults, lag_ms=5.6 * FRAME_MS, without=frozenset({Witness.PREAMBLE})).run(FRAMES).wrong


def test_a_lamp_whose_pictures_are_always_torn_costs_its_own_frames_only() -> None:
    """Its flash lies in two frames, as while a flash is tuned: the projector's frames keep their labels."""
    faults = Faults(**with_preamble(4), torn=lambda k: k > AT and k % 5 == 0)
    score = run(faults, 400)
    assert all(k % 5 == 0 for k in score.unknown if k > AT + 20)
