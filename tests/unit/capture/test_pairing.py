"""A label is right or unknown, whatever the camera, the line and the controller do."""

import random
from typing import Any

import pytest

from annulus_pipe.capture.history import EdgeHistory
from annulus_pipe.capture.offset import calibrate_offset
from annulus_pipe.capture.pairing import Pairing
from annulus_pipe.capture.photometry import Light, Photometry
from annulus_pipe.capture.proof import ProofState, Reason, Witness
from annulus_pipe.capture.seen import FrameSeen
from annulus_pipe.vocabulary import AnnulusError, CameraSequence, EdgeFlag, EdgeIndex, Flash, Label, Lamp, Slot, Tick

MS = 1_000_000
PERIOD = 40 * MS
FINE = EdgeFlag(0)
LIGHT = {Lamp.PROJECTOR: Light.PROJECTOR, Lamp.LED: Light.LED, Lamp.DARK: Light.DARK}
LABEL = {Lamp.PROJECTOR: Label.PROJECTOR, Lamp.LED: Label.LED}


def lamp_of(edge: int) -> Lamp:
    return Lamp.LED if edge % 5 == 4 else Lamp.PROJECTOR


def flash(edge: int, flags: EdgeFlag = FINE, *, boot: int = 1, lamp: Lamp | None = None) -> Flash:
    lit = lamp_of(edge) if lamp is None else lamp
    return Flash(EdgeIndex(edge), Tick(edge * 4_000_000), Slot(edge % 5), lit, 3, 5, edge, 1, boot, flags)


def picture(light: Light) -> Photometry:
    spread = {Light.PROJECTOR: 0.38, Light.LED: 0.001, Light.BOTH: 0.1, Light.UNCLEAR: 0.1}.get(light, 0.0)
    return Photometry(5.0 if light is Light.DARK else 200.0, 0.8 if light is Light.BOTH else 0.4, spread)


def seen(stamp: int, light: Light, sequence: int | None = None, arrived: int | None = None) -> FrameSeen:
    count, arrived = (
        None if sequence is None else CameraSequence(sequence),
        stamp + 34 * MS if arrived is None else arrived,
    )
    return FrameSeen(count, stamp, arrived, picture(light), {})


BLIND = frozenset({Witness.LAMP})


def at(edge: int) -> int:
    return 10**12 + edge * PERIOD


def pairing_with(edges: range, **options: Any) -> Pairing:
    pairing = Pairing(PERIOD, **options)
    pairing.recalibrate(PERIOD, -28 * MS)
    for edge in edges:
        pairing.edge(flash(edge), at(edge), 1)
    return pairing


def frame(pairing: Pairing, number: int, *, light: Light | None = None, jitter: int = 0, sequence: int | None = None):
    """Frame `number` ends at edge `number`; the flash after edge number-1 lit it."""
    shown = light or LIGHT[lamp_of(number - 1)]
    count = number if sequence is None else sequence
    arrived = at(number) + 6 * MS + 7 * number % 5 * MS // 3  # it has a way of its own, which the stamp does not know
    return pairing.label(seen(at(number) - 28 * MS + jitter, shown, count, arrived))


def test_the_flash_after_edge_k_labels_the_frame_that_ends_at_edge_k_plus_1() -> None:
    pairing = pairing_with(range(20))
    for number in range(1, 20):
        labelled = frame(pairing, number)
        assert labelled.flash is not None and labelled.flash.edge == number - 1
        assert labelled.label is LABEL[lamp_of(number - 1)]
    assert pairing.counters == {Reason.AGREED: 19}


def test_a_dropped_frame_never_shifts_labels() -> None:
    pairing = pairing_with(range(60))
    for number in [n for n in range(1, 60) if n % 7]:
        assert frame(pairing, number).label is LABEL[lamp_of(number - 1)]


@pytest.mark.parametrize("seed", range(3))
def test_jitter_and_late_edges_never_make_a_wrong_label(seed: int) -> None:
    random_ = random.Random(seed)
    pairing = Pairing(PERIOD, without=BLIND)
    pairing.recalibrate(PERIOD, -28 * MS)
    late: list[int] = []
    agreed = 0
    for number in range(1, 400):
        if random_.random() < 0.1:
            late.append(number)
        else:
            pairing.edge(flash(number), at(number), 1)
        if late and random_.random() < 0.5:
            edge = late.pop(0)
            pairing.edge(flash(edge), at(edge), 1)
        labelled = frame(pairing, number, jitter=round(random_.gauss(0, 2 * MS)))
        assert labelled.label in (Label.UNKNOWN, LABEL[lamp_of(number - 1)])
        agreed += labelled.label is not Label.UNKNOWN
    assert agreed > 250


def test_a_frame_waits_for_its_edges_but_not_for_ever() -> None:
    pairing = pairing_with(range(5))
    this, after = (seen(at(n) - 28 * MS, Light.PROJECTOR) for n in (5, 6))
    assert not pairing.settled(this, at(5))
    pairing.edge(flash(5), at(5), 1)
    assert pairing.settled(this, at(5))
    assert not pairing.settled(after, at(7))
    assert pairing.settled(after, at(10))


def test_a_frame_stamped_in_the_future_is_not_waited_for() -> None:
    pairing = pairing_with(range(5))
    assert pairing.settled(seen(at(500), Light.PROJECTOR, arrived=at(5)), at(9))


@pytest.mark.parametrize(
    ("flags_opening", "flags_closing", "reason"),
    [
        (EdgeFlag.IRREGULAR, EdgeFlag(0), Reason.IRREGULAR),
        (EdgeFlag(0), EdgeFlag.IRREGULAR, Reason.IRREGULAR),
        (EdgeFlag.LATE_LOAD, EdgeFlag(0), Reason.LATE),
        (EdgeFlag.DISARMED, EdgeFlag(0), Reason.DISARMED),
        (EdgeFlag(0), EdgeFlag.DISARMED, Reason.DISARMED),
    ],
)
def test_an_edge_that_is_not_to_be_trusted_labels_nothing(
    flags_opening: EdgeFlag, flags_closing: EdgeFlag, reason: Reason
) -> None:
    pairing = Pairing(PERIOD, without=BLIND)
    pairing.recalibrate(PERIOD, -28 * MS)
    pairing.edge(flash(1, flags_opening), at(1), 1)
    pairing.edge(flash(2, flags_closing), at(2), 1)
    labelled = frame(pairing, 2)
    assert (labelled.label, labelled.reason) == (Label.UNKNOWN, reason)


def test_a_frame_across_a_reset_is_unknown_though_its_flash_was_announced() -> None:
    pairing = pairing_with(range(5))
    pairing.edge(flash(0, boot=2), at(5), 2)  # the controller restarted between edges 4 and 5
    assert frame(pairing, 5).reason is Reason.OPENING_LOST
    pairing.edge(flash(5, boot=2), at(6), 2)
    assert frame(pairing, 6).label is Label.UNKNOWN


def test_an_index_that_continues_by_accident_in_another_life_is_another_edges() -> None:
    pairing = pairing_with(range(5))
    pairing.edge(flash(5, boot=2), at(5), 2)
    assert frame(pairing, 5).reason is Reason.OPENING_LOST


def test_a_fault_inside_the_frame_makes_it_unknown_and_only_it() -> None:
    pairing = pairing_with(range(10))
    pairing.invalidate(at(5) + 3 * MS, at(5) + 3 * MS)
    labels = {number: frame(pairing, number) for number in range(1, 10)}
    assert [n for n, labelled in labels.items() if labelled.label is Label.UNKNOWN] == [6]
    assert labels[6].reason is Reason.CUT


def test_the_drivers_count_must_agree_with_the_controllers() -> None:
    pairing = pairing_with(range(32))
    assert all(frame(pairing, number).reason is Reason.AGREED for number in range(1, 10))
    assert frame(pairing, 10, sequence=11).reason is Reason.SEQUENCE  # a frame is missing that has no edge
    assert frame(pairing, 11, sequence=12).label is Label.UNKNOWN, "what is wrong once is not the truth from then on"
    assert pairing.state is ProofState.DOUBTED


def test_a_count_that_was_wrong_once_is_forgiven_when_all_agree_again() -> None:
    pairing = pairing_with(range(32))
    for number in range(1, 20):
        frame(pairing, number)
    assert frame(pairing, 20, sequence=999).label is Label.UNKNOWN
    labels = [frame(pairing, number).label for number in range(21, 30)]
    assert labels[0] is Label.UNKNOWN and Label.UNKNOWN not in labels[1:]


def test_two_edges_near_one_frame_label_nothing() -> None:
    pairing = pairing_with(range(6))
    pairing.edge(flash(77, boot=2), at(5) + MS, 2)
    assert frame(pairing, 5).reason is Reason.TWO_EDGES


@pytest.mark.parametrize("shown", [Light.DARK, Light.LED, Light.BOTH, Light.UNCLEAR])
def test_a_picture_of_anything_else_makes_the_frame_unknown(shown: Light) -> None:
    pairing = pairing_with(range(6))
    assert frame(pairing, 2, light=shown).label is Label.UNKNOWN


def test_a_right_offset_from_another_day_is_believed_from_the_first_led_frame_on() -> None:
    pairing = pairing_with(range(20))
    pairing.recalibrate(PERIOD, -28 * MS, proved=False)
    labels = [frame(pairing, number).label for number in range(1, 20)]
    assert labels[:4] == [Label.UNKNOWN] * 4 and labels[4:] == [LABEL[lamp_of(n - 1)] for n in range(5, 20)]


def history_of(count: int, **options: Any) -> EdgeHistory:
    history = EdgeHistory()
    for n in range(count):
        history.edge(flash(n, **options), at(n), 1)
    return history


@pytest.mark.parametrize("offset_ms", [-66.0, -28.0, -20.5, 0.0, 3.0, 19.0, 31.0])
def test_the_offset_is_found_wherever_the_driver_stamps(offset_ms: float) -> None:
    random_ = random.Random(1)
    frames = [
        seen(at(n) + round(offset_ms * MS + random_.gauss(0, 2 * MS)), LIGHT[lamp_of(n - 1)])
        for n in range(5, 55)
        if n % 9
    ]
    found = calibrate_offset(frames, history_of(60), PERIOD, arrivals=False)
    assert abs(found.offset_ns - offset_ms * MS) < 0.9 * MS
    assert 1.2 * MS < found.jitter_ns < 3 * MS and found.mismatches == 0


def test_no_offset_is_made_up_from_frames_that_do_not_tell() -> None:
    stamps = [at(n) - 28 * MS for n in range(5, 55)]
    with pytest.raises(AnnulusError, match="may fit as well"):
        calibrate_offset(
            [seen(stamp, Light.PROJECTOR) for stamp in stamps], history_of(60, lamp=Lamp.PROJECTOR), PERIOD
        )
    with pytest.raises(AnnulusError, match="agree under no offset"):
        calibrate_offset([seen(stamp, Light.DARK) for stamp in stamps], history_of(60), PERIOD)
    with pytest.raises(AnnulusError, match="0 frames with a clear picture"):
        calibrate_offset([seen(stamp, Light.UNCLEAR) for stamp in stamps], history_of(60), PERIOD)
    with pytest.raises(AnnulusError, match="same rate"):
        slow = [seen(at(5) + n * 47 * MS, LIGHT[lamp_of(n)]) for n in range(40)]
        calibrate_offset(slow, history_of(60), PERIOD)


@pytest.mark.parametrize("late", [0, 1, 2, 3, 4, 7, -3])
def test_whole_periods_are_those_that_are_possible_for_frames_that_came_when_they_came(late: int) -> None:
    offset = -28 * MS + late * PERIOD
    frames = [seen(at(n) + offset, LIGHT[lamp_of(n - 1)], 7 * n, at(n) + 6 * MS) for n in range(5, 55)]
    found = calibrate_offset(frames, history_of(60), PERIOD)
    assert abs(found.offset_ns - offset) < MS
    assert found.count is None, "a count that does not count frames is none"


def test_nothing_is_concluded_from_frames_that_all_had_waited() -> None:
    frames = [seen(at(n) - 28 * MS, LIGHT[lamp_of(n - 1)], n, at(60) + n * MS) for n in range(5, 55)]
    with pytest.raises(AnnulusError, match="frames come in bursts"):
        calibrate_offset(frames, history_of(60), PERIOD)


@pytest.mark.parametrize("lag_ms", [6, 22])
def test_stamps_that_step_by_a_frame_are_followed_however_long_a_frame_is_under_way(lag_ms: int) -> None:
    """Only the arrival and the pictures know: the camera does not count."""
    pairing = pairing_with(range(300))
    right = 0
    for number in range(1, 290):
        stamp = at(number) - 28 * MS + (PERIOD if number >= 100 else 0)
        shown = LIGHT[lamp_of(number - 1)]
        label = pairing.label(seen(stamp, shown, arrived=at(number) + lag_ms * MS)).label
        assert label in (LABEL[lamp_of(number - 1)], Label.UNKNOWN)
        right += number >= 190 and label is not Label.UNKNOWN
    assert right == 100


def test_history_is_bounded() -> None:
    history = EdgeHistory()
    pairing = pairing_with(range(5000), history=history)
    assert len(history.edges) <= 256
    for n in range(1000):
        pairing.invalidate(n, n)
    assert len(history.invalid) <= 64


def test_edges_are_numbered_by_time_over_restarts_lost_and_doubled_edges() -> None:
    """The controller's own count stands still where a pulse is missed, leaps where one is doubled, begins anew."""
    history = EdgeHistory()
    moments = [(n, 0.0) for n in range(1000) if n not in (200, 201) and not 300 <= n < 310]
    moments = sorted([*moments, (100, 0.125), (150, 0.55)], key=sum)
    index, life = 0, 1
    for n, after in moments:
        if n == 310:
            index, life = 0, 2
        history.edge(flash(index, boot=life), at(n) + round(after * PERIOD), life)
        index += 1
        if not after:
            assert history.edges[-1].ordinal == n
    assert history.lit(990) is not None


def test_after_too_long_a_silence_no_number_fits() -> None:
    history = history_of(4)
    history.edge(flash(0, boot=2), at(4000), 2)
    assert history.edges[-1].ordinal > 10**6


def test_an_edge_in_the_middle_of_a_frame_does_not_shift_those_after_it() -> None:
    """A controller that restarts may take the sync line's level for an edge: half a period off, and a period and a half
    before the next.
    """
    history = history_of(30)
    history.edge(flash(0, EdgeFlag.FIRST | EdgeFlag.IRREGULAR, boot=2), at(29) + round(0.5006 * PERIOD), 2)
    history.edge(flash(1, EdgeFlag.IRREGULAR, boot=2), at(31), 2)
    history.edge(flash(2, boot=2), at(32), 2)
    assert [edge.ordinal for edge in history.edges][-2:] == [31, 32]
