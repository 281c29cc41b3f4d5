"""The picture alone tells projector from LED from darkness, on white and on yellow walls, in any encoding."""

import numpy as np
import pytest
from numpy.typing import NDArray

from annulus_pipe.capture.photometry import Light, measure
from annulus_pipe.capture.proof import Witness
from annulus_pipe.capture.witnesses import UNLIT_MIN, RecentPictures

H, W = 308, 416
WALLS = {"white": (1.0, 1.0, 1.0), "yellow": (0.15, 0.8, 1.0), "brown": (0.45, 0.6, 0.75)}  # blue, green, red


def picture(wall: str, projector: float, led: float, *, level: float = 180.0, seed: int = 0) -> NDArray[np.uint8]:
    """Five stripes R R G B G with crosstalk around a dark middle, white light all over, noise of 3 grey."""
    y, x = np.mgrid[0:H, 0:W].astype(float)
    radius = np.hypot(x - W / 2 + 0.5, y - H / 2 + 0.5) / (H / 2)
    stripe = np.floor((radius - 0.35) / 0.1).astype(int)
    colours = np.array([(0.05, 0.05, 1.0), (0.05, 0.05, 1.0), (0.06, 1.0, 0.06), (0.8, 0.1, 0.04), (0.06, 1.0, 0.06)])
    light = np.zeros((H, W, 3))
    lit = (stripe >= 0) & (stripe < 5) & (np.mod(radius - 0.35, 0.1) > 0.012)
    light[lit] = colours[stripe[lit]] * projector
    light += (led * 0.6 * np.clip(radius, 0.15, 1.0))[..., None]
    grey = light * np.array(WALLS[wall]) * level + 2.0
    noise = np.random.default_rng(seed).normal(0, 3, grey.shape)
    return np.clip(grey + noise, 0, 255).astype(np.uint8)


def mosaic(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    raw = bgr[..., 1].copy()
    raw[0::2, 0::2] = bgr[0::2, 0::2, 2]
    raw[1::2, 1::2] = bgr[1::2, 1::2, 0]
    return raw


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize("level", [60.0, 180.0, 255.0])
@pytest.mark.parametrize("raw", ["no", "red first", "green first"])
def test_each_light_is_told_from_the_other(wall: str, level: float, raw: str) -> None:
    for (projector, led), expected in {(1.0, 0.0): Light.PROJECTOR, (0.0, 1.0): Light.LED}.items():
        image = picture(wall, projector, led, level=level)
        if raw == "no":
            found = measure(image)
        elif raw == "red first":
            found = measure(mosaic(image))
        else:  # each row's pixels change places two by two
            found = measure(mosaic(image).reshape(H, -1, 2)[..., ::-1].reshape(H, -1), green_first=True)
        assert found.light is expected, found


def test_darkness_is_dark_even_with_noise_and_a_pedestal() -> None:
    assert measure(picture("white", 0.0, 0.0)).light is Light.DARK
    assert measure(np.zeros((H, W), np.uint8)).light is Light.DARK


def test_both_lamps_are_never_taken_for_one() -> None:
    for wall in WALLS:
        assert measure(picture(wall, 1.0, 0.8)).light in (Light.BOTH, Light.UNCLEAR)


@pytest.mark.parametrize("shape", [(78, 104), (77, 103), (4, 4), (1232, 1664)])
def test_any_size_is_measured(shape: tuple[int, int]) -> None:
    grey = np.random.default_rng(5).integers(88, 93, shape).astype(np.uint8)
    assert measure(grey).light is measure(np.repeat(grey[..., None], 3, axis=2)).light is Light.LED


@pytest.mark.parametrize("colour", [(0, 0, 0), (0, 135, 0), (90, 90, 90), (255, 255, 255)])
def test_a_picture_without_any_noise_is_no_lamps(colour: tuple[int, int, int]) -> None:
    """A buffer that nothing was written into; of zeros, YUV makes it green."""
    assert measure(np.full((78, 104, 3), colour, np.uint8)).light is Light.DARK


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("share", [0.05, 0.2, 0.5])
def test_a_picture_of_two_exposures_is_torn_wherever_the_tear_is(wall: str, raw: bool, share: float) -> None:
    whole = [picture(wall, 1.0, 0.0, seed=1), picture(wall, 0.0, 1.0, seed=2)]
    for upper, lower in (whole, whole[::-1]):
        for above in (round(share * H), H - round(share * H)):
            image = np.vstack([upper[:above], lower[above:]])
            found = measure(mosaic(image) if raw else image)
            torn = found.torn or any(found.unlit) or found.light not in (Light.PROJECTOR, Light.LED)
            assert torn, found
    for image in whole:
        found = measure(mosaic(image) if raw else image)
        assert not found.torn and not any(found.unlit)


@pytest.mark.parametrize("raw", [False, True])
def test_a_mask_before_the_lens_is_no_tear_once_it_is_known(raw: bool) -> None:
    pictures, masked = RecentPictures(), []
    for seed in range(12):
        image = picture("white", 0.0, 1.0, seed=seed)
        image[: H // 10] = image[-H // 15 :] = 0
        image[H // 2 - 20 : H // 2 + 20, 50:-50] = 0  # and nothing is lit deep in the pipe
        found = measure(mosaic(image) if raw else image)
        assert found.light is Light.LED and not found.torn, found
        masked.append(pictures.met(found))
    assert masked == [Witness.TORN] * UNLIT_MIN + [None] * (12 - UNLIT_MIN)


@pytest.mark.parametrize("raw", [False, True])
def test_only_the_same_picture_has_the_same_fingerprint(raw: bool) -> None:
    images = [picture("white", 1.0, 0.0, seed=seed) for seed in range(20)]
    prints = [measure(mosaic(image) if raw else image).fingerprint for image in images]
    assert len(set(prints)) == 20 and all(0 <= found < 2**64 for found in prints if found is not None)
    assert measure(mosaic(images[3]) if raw else images[3].copy()).fingerprint == prints[3]


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("share", [0.02, 0.2])
def test_a_tear_between_two_pictures_of_one_lamp_leaves_a_row_that_was_shown_before(raw: bool, share: float) -> None:
    pictures = RecentPictures()
    before, after = (picture("white", 1.0, 0.0, seed=seed) for seed in (1, 2))
    assert pictures.met(measure(mosaic(before) if raw else before)) is None
    for above in (round(share * H), H - round(share * H)):
        for upper, lower in ((before, after), (after, before)):
            image = np.vstack([upper[:above], lower[above:]])
            assert pictures.met(measure(mosaic(image) if raw else image)) is Witness.TORN
    assert RecentPictures().met(measure(mosaic(after) if raw else after)) is None


def test_a_dark_strip_that_was_shown_is_a_tear_and_darkness_shown_twice_is_not() -> None:
    pictures = RecentPictures()
    dark, bright = picture("white", 0.0, 0.0, seed=1), picture("white", 1.0, 0.0, seed=2)
    assert pictures.met(measure(dark)) is None and pictures.met(measure(dark)) is None
    assert pictures.met(measure(np.vstack([bright[: H // 2], dark[H // 2 :]]))) is Witness.TORN


def fringes(wide_px: float, along: bool, *, mean: float = 90.0, modulation: float = 0.8) -> NDArray[np.uint8]:
    """A sinusoid in white light over a dark surround, noise of 3 grey."""
    y, x = np.mgrid[0:H, 0:W].astype(float)
    inside = np.hypot((x - W / 2) / (W / 2), (y - H / 2) / (H / 2)) < 0.9
    wave = 1 + modulation * np.cos(2 * np.pi * (x if along else y) / wide_px)
    grey = np.where(inside, mean * wave, 2.0)[..., None] * np.array(WALLS["brown"]) / 0.6
    noise = np.random.default_rng(1).normal(0, 3, grey.shape)
    return np.clip(grey + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("along", [False, True])
@pytest.mark.parametrize("wide_px", [9.0, 20.0, 33.0])
def test_fringes_of_one_hue_are_the_projectors(wide_px: float, along: bool) -> None:
    image = fringes(wide_px, along)
    for seen in (image, mosaic(image)):
        found = measure(seen)
        assert found.light is Light.PROJECTOR and not found.torn, found


@pytest.mark.parametrize("rows", [slice(0, 90), slice(220, H)])
def test_a_strip_of_the_leds_light_in_a_picture_of_fringes_is_torn(rows: slice) -> None:
    image = fringes(20.0, along=False)
    image[rows] = picture("brown", 0.0, 1.0)[rows]
    found = measure(image)
    assert found.light is not Light.LED and found.torn, found
