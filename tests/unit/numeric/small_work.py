"""A little real work of every room that has loops in C, recorded; and the same calls with tables that hold anything."""

import functools
from collections.abc import Callable

import drawn_head
import hostile_frames
import line_heads
import numpy as np
import synthetic_pipe
from recorded import Call, given, recording, with_other

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.stereo import StereoReconstructor
from annulus_pipe.twin.worlds import WORLDS
from annulus_pipe.wall.survey import survey
from tests import kept


def profiles() -> None:
    """Of what each kind of head sees, of the same as a mosaic, and of a frame that no pipe shows."""
    for head, calibration in hostile_frames.heads().items():
        reconstructor = Reconstructor(calibration, hostile_frames.DIRECTIONS)
        image = hostile_frames.seen(head)
        other = hostile_frames.frame("rings", 5, *image.shape[:2])
        for picture in (image, hostile_frames.mosaic_of(image, "rggb"), other):
            reconstructor.profile(picture, frame=0, z_mm=5.0)


def slits_by_order() -> None:
    """As colours are learnt."""
    reconstructor = Reconstructor(hostile_frames.heads()["slits"], hostile_frames.DIRECTIONS)
    assert len(reconstructor.slits_by_order(hostile_frames.seen("slits"))[0].position)


def stereo_profile() -> None:
    head, pose = drawn_head.head(0.4), Pose(0.02, -0.03, -6.9, -9.1)
    images = {
        one.id: kept.picture(lambda one=one: drawn_head.draw(head, one, pose), head, one, pose) for one in head.cameras
    }
    assert len(StereoReconstructor(head, 90).profile(images, frame=0, z_mm=0.0).ring)


def whole_survey() -> None:
    pocket = synthetic_pipe.pocket(synthetic_pipe.round_pipe, 90.0, 20.0, 40.0, 60.0, 2.0)
    scan = synthetic_pipe.scan(pocket, z_mm=np.arange(0.0, 100.0, 5.0).tolist(), directions=240)
    assert survey(scan, synthetic_pipe.CALIBRATION).timing_ms


def drawn_frame() -> None:
    for name in ("lines", "mirror"):
        line_heads.picture(hostile_frames.worlds()[name].scaled(80), 40.0)


def drawn_course() -> None:
    """Of a pipe of several pieces. Its maps are large: where seconds count it is left out."""
    line_heads.picture(WORLDS["butt"](1).scaled(80), 40.0)


WORK: list[Callable[[], None]] = [profiles, slits_by_order, stereo_profile, whole_survey, drawn_frame]


@functools.cache
def real_calls() -> list[Call]:
    with recording() as calls:
        for work in WORK:
            work()
    return calls


# What no data is in: laid out once by a calibration (tests/unit/rings/test_hostile.py holds it to its plane), or by the
# code, or by the door before.
SURE = {"address", "limits", "black", "gain"}


def hostile_calls(seed: int, part: float) -> list[Call]:
    """Of every table of every door one call with that part of the table replaced by anything."""
    rng, calls = np.random.default_rng(seed), {}
    for call in real_calls():
        if call.name.startswith("twin_"):
            continue  # what it draws are worlds
        for name in set(given(call)) - SURE - {name for of, name in calls if of == call.name}:
            spoil = functools.partial(spoilt, rng, part, name == "samples")
            calls[call.name, name] = with_other(call, name, spoil)
    return list(calls.values())


def spoilt(rng: np.random.Generator, part: float, near: bool, values: np.ndarray) -> np.ndarray:
    """near : runs of samples, which are gone through one by one: far out of the image, but no more of them."""
    odd = rng.integers(-3000, 3000, len(values)) if near else anything(rng, values)
    return np.where(rng.random(values.shape) < part, odd, values)


def anything(rng: np.random.Generator, values: np.ndarray) -> np.ndarray:
    """The least, the greatest, next to nothing; of floats what is no number as well."""
    kind, bits = values.dtype.kind, 8 * values.dtype.itemsize
    if kind == "b":
        return rng.random(values.shape) < 0.5
    if kind == "f":
        odd = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e-30, 1e30, -1e30, -1.0], values.dtype)
    else:
        whole = 0, 1, 3, -1, 2 ** (bits - 1), 2 ** (bits - 1) - 1, len(values) - 1, len(values)
        odd = np.array([one % 2**bits for one in whole], f"u{bits // 8}").view(values.dtype)
    return rng.choice(odd, values.shape)
