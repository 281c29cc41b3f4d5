"""What the stripes look like, learnt from light whose mixture is known."""

import json

import numpy as np
import pytest

from annulus_pipe.rings.colour import ColourProfile, Stripes, differs, learn
from annulus_pipe.rings.decode import classify

# what red, green, blue pixels see of a red, green, blue stripe: filters leak, the pipe swallows blue
LEAKY = np.array([[1.0, 0.10, 0.04], [0.12, 1.0, 0.15], [0.05, 0.22, 0.8]])
YELLOW = np.diag([0.72, 0.47, 0.06])
WHITE = np.diag([0.75, 0.77, 0.78])


def light(paint: np.ndarray, noise: float = 0.6, seed: int = 1) -> Stripes:
    rng = np.random.default_rng(seed)
    colour = rng.integers(0, 3, 3000)
    bright = rng.uniform(120, 280, 3000)
    mixed = bright[:, None] * (paint @ LEAKY)[:, colour].T + rng.normal(0, noise, (3000, 3))
    return Stripes(mixed.clip(0), colour, mixed.max(axis=1) > 235)


def test_crosstalk_and_paint_are_told_apart():
    white, yellow = learn([light(WHITE)]), learn([light(YELLOW)])
    wanted = LEAKY / np.diag(LEAKY)[:, None]
    assert np.abs(np.array(white.crosstalk) - wanted).max() < 0.007
    assert np.abs(np.array(yellow.crosstalk) - wanted).max() < 0.011
    ratio = np.array(yellow.level) / np.array(white.level)
    assert ratio / ratio[0] == pytest.approx(np.array([1.0, 0.636, 0.080]), rel=0.006)


def test_a_profile_separates_what_a_yellow_pipe_has_mixed_up():
    seen = light(YELLOW)
    profile = learn([seen])
    assert profile.separation[0] < 45 < 60 < profile.separation[1]
    named = classify(seen.light[:, ::-1], "RGB", profile.seen())
    assert (named == seen.colour).mean() > 0.999 and profile.named[1] > 0.999


def test_the_weak_channel_is_the_one_to_raise():
    assert learn([light(YELLOW)], (1.0, 2.0)).gains == (1.0, 4.0)  # as far as is worth it
    red, blue = learn([light(WHITE)]).gains
    assert 1.0 <= red < 1.1 and 1.1 < blue < 1.4


def test_a_profile_survives_its_file_and_a_damaged_one_is_named():
    profile = learn([light(YELLOW)])
    data = json.loads(json.dumps(profile.to_dict()))
    assert ColourProfile.from_dict(data) == profile
    for key, value in (("crosstalk", [[1, 0], [0, 1]]), ("level", [0, 0, 0]), ("gains", 3), ("format", "other")):
        with pytest.raises(ValueError, match=key):
            ColourProfile.from_dict({**data, key: value})


def test_another_paint_than_the_profiles_is_said():
    profile = learn([light(YELLOW)])
    assert differs(profile, [light(YELLOW, seed=2)]) is None
    assert "blue brings" in str(differs(profile, [light(WHITE)]))


def test_a_colour_that_never_came_back_is_refused():
    with pytest.raises(ValueError, match="blue channel sees nothing"):
        learn([light(np.diag([0.7, 0.5, 0.004]), noise=0.1)])
