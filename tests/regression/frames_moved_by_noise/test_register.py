"""Registration moved frames that agreed with their neighbours by what its own fit's noise said (8e3ef25). Fails
without WORTH_MM."""

from synthetic_pipe import oval, pocket, round_pipe, scan

from annulus_pipe.wall.registration import register


def test_frames_that_agree_are_left_as_they_are() -> None:
    profiles = scan(oval(pocket(round_pipe, 90, 12, 130, 165, 5.0), 30, 0.02))
    assert all(one is other for one, other in zip(profiles, register(profiles), strict=True))
