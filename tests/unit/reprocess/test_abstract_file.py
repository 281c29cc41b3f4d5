"""Promises of what is kept of a window: the same to the bit, and nothing that was altered, torn or made up is read."""

import io
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_pipe import CALIBRATION, RADIUS_MM, bump, oval, pocket, round_pipe, scan

from annulus_pipe.reprocess.abstract_file import _digest, packed, unpacked
from annulus_pipe.wall.joined import Abstract, abstract
from annulus_pipe.wall.survey import survey
from annulus_pipe.wall.windows import Reach, Window, plan

ABOUT = {"made_from": "0123", "files": {"windows/0001/cloud.ply": "ab"}}


@pytest.fixture(scope="module")
def one() -> Abstract:
    wall = pocket(bump(round_pipe, 60, 300, 14, 3.0), 90, 20, 110, 140, 2.0)
    profiles = scan(oval(wall, 30, 0.03, 0, 500), z_mm=[3.5 * i for i in range(60)], directions=360)
    step = plan([Reach.of(each) for each in profiles], RADIUS_MM, 50_000).z_step_mm
    whole = survey(profiles, CALIBRATION, z_step_mm=step)
    assert whole.defects
    return abstract(whole, Window(-math.inf, math.inf, tuple(range(60)), 3), 2 * step)


@pytest.fixture(scope="module")
def data(one: Abstract) -> bytes:
    return packed(one, ABOUT)


def parts(data: bytes) -> tuple[str, list[Any]]:
    with np.load(io.BytesIO(data)) as archive:
        return str(archive["told"]), [archive[str(i)] for i in range(len(archive.files) - 2)]


def test_what_is_kept_comes_back_to_the_bit(one: Abstract, data: bytes) -> None:
    there, about = unpacked(data)
    assert about == ABOUT and there.window == one.window
    (told, arrays), (again, arrays_again) = parts(data), parts(packed(there, ABOUT))
    assert told == again and _digest(told, arrays) == _digest(again, arrays_again)


@settings(max_examples=200, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), cut=st.booleans())
def test_what_was_altered_is_not_read_or_says_the_same(data: bytes, where: float, bit: int, cut: bool) -> None:
    at = int(where * len(data))
    other = data[:at] if cut else data[:at] + bytes([data[at] ^ (1 << bit)]) + data[at + 1 :]
    try:
        there, about = unpacked(other)
    except ValueError as error:
        assert str(error).startswith("not what was written of a window: ") and "\n" not in str(error)
        return
    assert about == ABOUT and parts(packed(there, ABOUT))[0] == parts(data)[0]  # a bit that says nothing: of a date


@pytest.mark.parametrize(
    "tree",
    [
        {"of": "os:system", "fields": ["true"]},
        {"of": "annulus_pipe.wall.joined:abstract", "fields": []},
        {"of": "annulus_pipe.cli:app", "fields": []},
        {"of": "annulus_pipe.wall.joined:Abstract", "fields": []},
        {"of": "annulus_pipe.wall.windows:Window", "fields": [0.0, 1.0, {"row": []}, 0]},
        {"array": 7},
        {"enum": "annulus_pipe.wall.defects:Kind", "is": "no such"},
        {"row": "ab"},
        7,
        json.loads('{"row": [' * 60 + "1" + "]}" * 60),
    ],
)
def test_what_is_made_up_is_refused_in_one_line(tree: Any) -> None:
    told = json.dumps({"format": 1, "about": ABOUT, "tree": tree})
    out = io.BytesIO()
    np.savez(out, told=np.array(told), sha256=np.array(_digest(told, [])))
    with pytest.raises(ValueError, match=r"^not what was written of a window: .*$"):
        unpacked(out.getvalue())
