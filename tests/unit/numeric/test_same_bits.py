"""A result has the same bits on every kind of processor: calls of doors as they come in real work, and with tables that
hold anything, made again by every library that this machine can run, and on aarch64 (under QEMU) by those that ship."""

import ctypes
import functools
import importlib
import os
import pickle
import subprocess
import sys
from pathlib import Path

import hostile_frames
import pytest
from recorded import NATIVE, RECORD, Call, differing, differing_on, fresh_doors, recording
from small_work import drawn_course, hostile_calls, real_calls
from test_native import declaring

from annulus_pipe.numeric.native import CHOSEN, DOORS, LEVELS, library
from annulus_pipe.rings.polar import unroll
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.rings.slits import find_slits
from annulus_pipe.shipped import LOOPS, shipped

ROOT = Path(__file__).resolve().parents[3]
BEST = library().processor_level()
HERE = [name for level, name in LEVELS.items() if level <= BEST and (level == 0) == (BEST == 0)]
AARCH64 = "MACHINE=aarch64", "CC=aarch64-linux-gnu-gcc", "BUILD=build/aarch64"


@functools.cache
def calls() -> list[Call]:
    return [*real_calls(), *hostile_calls(0, 0.1)]


def loaded(level: str) -> ctypes.CDLL:
    return ctypes.CDLL(str(shipped(f"{LOOPS}{level}.so")))


def on_aarch64(some: list[Call], folder: Path) -> list[str]:
    """By a program that the library's own objects are linked into, all of it static: no Python, no other C library."""
    subprocess.run(["make", "--silent", "-C", str(NATIVE), *AARCH64], check=True)
    objects = sorted(str(path) for path in (NATIVE / "build/aarch64/armv8-a").glob("*.o"))
    return differing_on(some, folder, ["aarch64-linux-gnu-gcc", "-static", *objects], ["qemu-aarch64-static"])


@pytest.mark.parametrize("level", HERE)
def test_every_library_writes_the_same_bits(level: str) -> None:
    assert differing(calls(), loaded(level)) == []


def test_aarch64_writes_the_same_bits(tmp_path: Path) -> None:
    assert on_aarch64(calls(), tmp_path) == []


def test_a_bit_that_differs_is_found(tmp_path: Path) -> None:
    at = next(n for n, call in enumerate(calls()) if call.name == "rings_keep" and call.result)
    call = calls()[at]
    written = [n for n, block in enumerate(call.blocks) if block.before != block.after]
    other = []
    for block in written:
        blocks = list(call.blocks)
        after = bytearray(blocks[block].after)
        after[0] ^= 1
        blocks[block] = blocks[block]._replace(after=bytes(after))
        other.append(call._replace(blocks=blocks))
    other.append(call._replace(result=call.result + 1))
    found = differing(other, library())
    assert len(found) == len(other) == 8 and found[-1].startswith("rings_keep: gives ")
    on_it = on_aarch64(other, tmp_path)
    assert [line.partition(" is ")[0] for line in on_it[:-1]] == [line.partition(" is ")[0] for line in found[:-1]]
    assert on_it[-1].startswith("rings_keep: gives ")


@pytest.mark.parametrize("head", ["slits", "mirror", "lines"])
def test_a_frame_has_the_same_slits_and_points_with_every_library(head: str, monkeypatch: pytest.MonkeyPatch) -> None:
    images = [hostile_frames.seen(head)] + [hostile_frames.spoilt(head, seed) for seed in range(3)]
    bits = {}
    for level in HERE:
        monkeypatch.setenv(CHOSEN, level)
        with fresh_doors():
            reconstructor = Reconstructor(hostile_frames.heads()[head], hostile_frames.DIRECTIONS)
            slits = [find_slits(unroll(image, reconstructor._grid), reconstructor._grid) for image in images]
            profiles = [reconstructor.profile(image, frame=0, z_mm=0.0, clock=lambda: 0.0) for image in images]
        assert any(len(profile.ring) > 30 for profile in profiles)
        bits[level] = pickle.dumps((slits, profiles))
    assert len(set(bits.values())) == 1


@pytest.mark.timeout(1500)  # the gate's tests of six rooms, and some of it again under QEMU
@pytest.mark.deep(gate="tests/unit/numeric/test_same_bits.py::test_aarch64_writes_the_same_bits")
def test_whatever_the_tests_call_has_the_same_bits(tmp_path: Path) -> None:
    """Every door that there is: each has a test of its own somewhere."""
    for name in declaring():
        importlib.import_module(name)
    record, rooms = tmp_path / "calls", ("unit/rings", "unit/wall", "unit/stereo", "unit/twin", "unit/archive", "wings")
    tests = [f"tests/{room}" for room in rooms]
    running = [sys.executable, "-m", "pytest", "-q", "-p", "recorded", "-p", "no:cacheprovider", "-m", "not deep"]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent), RECORD: str(record)}
    subprocess.run([*running, *tests], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, check=True)
    made: list[Call] = pickle.loads(record.read_bytes())
    with recording() as course:
        drawn_course()
    made += [*real_calls(), *course]  # what those rooms' tests leave to larger ones
    assert {door.name for door in DOORS} - {call.name for call in made} == set()
    for level in HERE:
        assert differing(made, loaded(level)) == [], level
    assert on_aarch64(made, tmp_path) == []
