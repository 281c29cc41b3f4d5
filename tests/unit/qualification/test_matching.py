"""Which dug place is which listed one."""

from collections.abc import Sequence

import numpy as np
import pytest

from annulus_pipe.qualification.digs import Dig, DugKind
from annulus_pipe.qualification.matching import SurveyPlace, match

RADIUS_MM = 50.0


def place(z: float, clock: float, name: str = "D1", kind: str = "loss", arc: float = 30.0) -> SurveyPlace:
    return SurveyPlace(name, kind, z, clock, 20.0, arc, 1.0, 0.1)


def dig(z: float, clock: float, name: str = "", kind: DugKind = DugKind.LOSS) -> Dig:
    return Dig(2, name, kind, z, clock % 360.0, 1.0, 0.1, 20.0, 20.0)


def listed(count: int, seed: int) -> list[SurveyPlace]:
    """Some 400 mm apart, unevenly, as defects lie."""
    chance = np.random.default_rng(seed)
    z = np.cumsum(chance.uniform(150.0, 650.0, count))
    return [place(z[i], chance.uniform(0.0, 360.0), f"D{i + 1}") for i in range(count)]


def dug(places: Sequence[SurveyPlace], which: Sequence[int], shift: float, seed: int) -> list[Dig]:
    chance = np.random.default_rng(seed)
    return [
        dig(places[i].z_mm - shift + chance.normal(0.0, 5.0), places[i].clock_deg + chance.normal(0.0, 5.0))
        for i in which
    ]


@pytest.mark.parametrize(
    ("seed", "shift"),
    [
        (1, 180.0),
        *(pytest.param(s, shift, marks=pytest.mark.deep) for s in range(2, 12) for shift in (0.0, -260.0, 90.0)),
    ],
)
def test_a_shift_of_the_chainage_is_found_and_everything_with_it(seed: int, shift: float) -> None:
    places = listed(20, seed)
    which = [2, 5, 9, 13, 17]
    found = match(dug(places, which, shift, seed), places, RADIUS_MM, 300.0)
    assert [found.by_dig[i] for i in range(5)] == which
    assert found.shift_mm == pytest.approx(shift, abs=15.0) and found.basis == "places"


def test_one_dig_is_no_ground_for_a_shift() -> None:
    found = match([dig(1000.0, 90.0)], [place(1200.0, 90.0)], RADIUS_MM, 300.0)
    assert (found.shift_mm, found.basis, dict(found.by_dig)) == (0.0, "none", {})


def test_a_name_is_ground_enough() -> None:
    found = match([dig(1000.0, 90.0, "D1")], [place(1200.0, 90.0)], RADIUS_MM, 300.0)
    assert (found.shift_mm, found.basis, dict(found.by_dig)) == (200.0, "names", {0: 0})


def test_a_digs_own_number_is_no_name_of_the_survey() -> None:
    """What was dug second is called D2, and lies on the third of the survey's list."""
    places = [place(900.0, 90.0, "D2", "bump"), place(1000.0, 90.0, "D3"), place(1150.0, 200.0, "D4")]
    found = match([dig(1000.0, 90.0, "D2"), dig(1150.0, 200.0, "D3")], places, RADIUS_MM, 300.0)
    assert dict(found.by_dig) == {0: 1, 1: 2} and found.shift_mm == 0.0
    assert found.remarks == (
        "names of digs are not followed: by them 0 digs lie on a listed place of their kind, without them 2",
    )


def test_a_name_against_a_place_is_remarked() -> None:
    places = [place(1000.0, 90.0, "D1"), place(1200.0, 90.0, "D2")]
    found = match([dig(1000.0, 90.0, "D2")], places, RADIUS_MM, 300.0)
    assert dict(found.by_dig) == {0: 1}
    assert found.remarks == ("a shift of +0 mm fits as many digs as +200 mm, by names",)


def test_a_name_beyond_the_bound_is_remarked_and_not_followed() -> None:
    found = match([dig(1000.0, 90.0, "D1")], [place(1800.0, 90.0)], RADIUS_MM, 300.0)
    assert not found.by_dig and found.remarks == ("dig D1 lies 800 mm from the survey's D1",)


def test_a_shift_of_which_there_are_two_is_remarked() -> None:
    """Two defects 100 mm apart, and two pairs of places like that."""
    places = [place(z, 90.0, f"D{i}") for i, z in enumerate((800.0, 900.0, 1200.0, 1300.0), 1)]
    found = match([dig(1000.0, 90.0), dig(1100.0, 90.0)], places, RADIUS_MM, 300.0)
    assert len(found.by_dig) == 2 and "fits as many digs" in found.remarks[0]


def test_places_are_matched_one_to_one_and_the_nearer_ones() -> None:
    places = [place(100.0, 90.0, "D1"), place(118.0, 90.0, "D2")]
    found = match([dig(116.0, 90.0), dig(98.0, 90.0)], places, RADIUS_MM, 0.0)
    assert dict(found.by_dig) == {0: 1, 1: 0}


def test_the_dial_has_no_seam() -> None:
    assert match([dig(100.0, 355.0)], [place(100.0, 4.0)], RADIUS_MM, 0.0).by_dig == {0: 0}


def test_the_other_side_of_the_pipe_is_another_place() -> None:
    assert not match([dig(100.0, 180.0)], [place(100.0, 0.0)], RADIUS_MM, 0.0).by_dig
    assert match([dig(100.0, 180.0)], [place(100.0, 0.0, arc=360.0)], RADIUS_MM, 0.0).by_dig


def test_a_place_of_the_right_kind_comes_first() -> None:
    places = [place(100.0, 90.0, "D1", "bump"), place(108.0, 90.0, "D2", "loss")]
    assert match([dig(102.0, 90.0)], places, RADIUS_MM, 0.0).by_dig == {0: 1}


def test_sound_wall_is_no_ground_for_a_shift() -> None:
    places = listed(20, 3)
    digs = [dig(one.z_mm - 200.0, one.clock_deg, kind=DugKind.SOUND) for one in places[3:9]]
    assert match(digs, places, RADIUS_MM, 300.0).shift_mm == 0.0


def test_no_place_is_no_match() -> None:
    assert match([dig(100.0, 0.0)], [], RADIUS_MM, 300.0).by_dig == {}
