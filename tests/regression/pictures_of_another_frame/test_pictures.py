"""A picture was looked at as a whole and alone: one that was torn passed for the larger part's lamp, one that the
driver handed over twice for the later frame. Fails without bands, fingerprint, or first and last row."""

from bench_of_faults import Bench, Faults


def test_a_torn_picture_has_no_label() -> None:
    assert Bench(Faults(torn=lambda k: k % 9 == 4)).run(300).wrong == []


def test_a_picture_with_a_new_stamp_is_still_the_old_picture() -> None:
    score = Bench(Faults(pictured=lambda k: k - (k % 9 == 4))).run(600)
    assert score.wrong == [] and len(score.unknown) <= 1 + 67 * 5
