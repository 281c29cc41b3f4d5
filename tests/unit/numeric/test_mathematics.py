"""How far the loops' own exp, cos, sin and atan2 are off, of which numbers: as host/native/mathematics.h says.

A program of three loops is built from the header as the libraries are. What it gives is held against long doubles: 64
bits of x86, more elsewhere.
"""

import ctypes
import math
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

NATIVE = Path(__file__).resolve().parents[3] / "host/native"
LOOPS = """
#include "mathematics.h"
DOOR void e(const double* const x, const double* const y, double* const out, double* const other, const int64_t n)
{
    for (int64_t i = 0; i < n; i++) out[i] = exponential(x[i]);
}
DOOR void turn(const double* const x, const double* const y, double* const out, double* const other, const int64_t n)
{
    for (int64_t i = 0; i < n; i++) cosine_sine(x[i], out + i, other + i);
}
DOOR void angle(const double* const x, const double* const y, double* const out, double* const other, const int64_t n)
{
    for (int64_t i = 0; i < n; i++) out[i] = arc_tangent(y[i], x[i]);
}
"""
N = 200_000
EXP_UNITS, ATAN_UNITS = 1.6, 3.5  # of the last place
TURN_OFF, OF_ANGLE = 5e-16, 2.0**-53
Doubles = NDArray[np.float64]
Loop = Callable[..., tuple[Doubles, Doubles]]


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Loop:
    folder = tmp_path_factory.mktemp("mathematics")
    (folder / "loops.c").write_text(LOOPS)
    usual = ["-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared"]
    subprocess.run(["gcc", *usual, f"-I{NATIVE}", "-o", folder / "loops.so", folder / "loops.c", "-lm"], check=True)
    loops = ctypes.CDLL(str(folder / "loops.so"))

    def call(name: str, x: object, y: object = 0.0) -> tuple[Doubles, Doubles]:
        given = [np.ascontiguousarray(one) for one in np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))]
        out = np.empty((2, given[0].size))
        addresses = [ctypes.c_void_p(one.ctypes.data) for one in (*given, out[0], out[1])]
        getattr(loops, name)(*addresses, ctypes.c_int64(given[0].size))
        return out[0], out[1]

    return call


def exactly(function: Callable[..., NDArray[np.longdouble]], *values: Doubles) -> NDArray[np.longdouble]:
    return function(*(value.astype(np.longdouble) for value in values))


def units_off(found: Doubles, exact: NDArray[np.longdouble]) -> float:
    """The most, in units of the last place."""
    return float(np.max(np.abs(found - exact) / np.spacing(np.abs(exact.astype(float)))))


@pytest.mark.parametrize("most", [1e-6, 1.0, 20.0, 708.0])
def test_exponential(loop: Loop, most: float) -> None:
    x = np.append(np.random.default_rng(1).uniform(-most, most, N), [-most, most, 0.0, -0.0, 5e-324])
    assert units_off(loop("e", x)[0], exactly(np.exp, x)) < EXP_UNITS


def test_the_exponentials_ends(loop: Loop) -> None:
    least, beyond = np.nextafter(-708.0, -math.inf), [709.0, 709.5, 1e308, math.inf]
    assert loop("e", [least, -745.0, -1e308, -math.inf])[0].tolist() == [0.0] * 4
    assert np.allclose(loop("e", beyond)[0], math.exp(709.0), rtol=1e-15)
    assert np.isnan(loop("e", math.nan)[0]).all()


@pytest.mark.parametrize("most", [0.1, math.pi, 100.0, 1e6])
def test_cosine_and_sine(loop: Loop, most: float) -> None:
    near = np.arange(-math.floor(most / math.pi * 2), math.floor(most / math.pi * 2) + 1)[-5000:] * (math.pi / 2)
    x = np.concatenate([np.random.default_rng(2).uniform(-most, most, N), near, np.nextafter(near, math.inf)])
    cosine, sine = loop("turn", x)
    allowed = TURN_OFF + OF_ANGLE * np.abs(x)
    assert (np.abs(cosine - exactly(np.cos, x)) < allowed).all()
    assert (np.abs(sine - exactly(np.sin, x)) < allowed).all()


def test_cosine_and_sine_of_what_is_no_angle(loop: Loop) -> None:
    tiny = np.array([0.0, -0.0, 5e-324, -1e-310])
    cosine, sine = loop("turn", tiny)
    assert cosine.tolist() == [1.0] * 4 and sine.tobytes() == tiny.tobytes()
    assert np.isnan(loop("turn", [math.nan, math.inf, -math.inf])).all()


@pytest.mark.parametrize("size", [1e-289, 1.0, 7e307])
def test_arc_tangent(loop: Loop, size: float) -> None:
    rng = np.random.default_rng(3)
    turn, tall = rng.uniform(-math.pi, math.pi, N), 10.0 ** rng.uniform(-12, 0, N)
    eighths = np.arange(-15, 16) * (math.pi / 16)
    round_it = [np.sin(turn), np.sin(eighths), tall], [np.cos(turn), np.cos(eighths), rng.choice([-1.0, 1.0], N)]
    y, x = (np.concatenate(one) * size for one in round_it)
    for rise, run in ((y, x), (x, y), (-y, x)):
        assert units_off(loop("angle", run, rise)[0], exactly(np.arctan2, rise, run)) < ATAN_UNITS


def test_arc_tangent_of_axes_and_of_what_has_none(loop: Loop) -> None:
    y, x = np.array([0.0, 0.0, 0.0, 1.0, -1.0, -0.0, 5e-324]), np.array([0.0, 2.0, -2.0, 0.0, 0.0, -2.0, 1.0])
    expected = [0.0, 0.0, math.pi, math.pi / 2, -math.pi / 2, math.pi, 5e-324]  # the last but one: -0 is 0
    assert loop("angle", x, y)[0].tolist() == expected
    nothing = [(math.nan, 1.0), (1.0, math.nan), (math.inf, 1.0), (1.0, -math.inf), (math.inf, math.inf)]
    assert np.isnan(loop("angle", *np.transpose(nothing))[0]).all()
